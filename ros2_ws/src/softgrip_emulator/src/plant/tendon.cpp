// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/tendon.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace softgrip::plant {

namespace {

constexpr double kTensionFloor_N = 0.05;
// Below this wrap angle a cable is not bent round the edge but lies beside it.
constexpr double kBentFrom_rad = 0.05;
constexpr double kSpeedFilter = 0.1;
// A braid takes so long to bed in under a tension that it has not felt before.
constexpr double kBedding_s = 1.0;
// Up to this tension and back counts as one loading of a knot.
constexpr double kLoading_N = 10.0;
// The cable comes out of the base parallel to the straight finger, from this far behind the first hole.
constexpr double kBaseRun_m = 0.035;
constexpr int kSettleSweeps = 50;
constexpr double kShortestSpan_m = 1e-5;

double sign(double value) {
  return static_cast<double>((value > 0.0) - (value < 0.0));
}

Eigen::Vector2d turned(const Eigen::Vector2d& point, double cos, double sin) {
  return {cos * point.x() - sin * point.y(), sin * point.x() + cos * point.y()};
}

// Where the straight line from one point to another crosses the line middle + t flank.
double crossing(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const Eigen::Vector2d& middle,
                const Eigen::Vector2d& flank) {
  const Eigen::Vector2d way = to - from, off = from - middle;
  const double across = way.x() * flank.y() - way.y() * flank.x();
  if (std::abs(across) < 1e-9) return 0.0;
  return (way.x() * off.y() - way.y() * off.x()) / across;
}

}  // namespace

Tendon::Tendon(TendonMake make, const std::vector<Strip>& strips) : make_(std::move(make)) {
  const std::size_t n = make_.joints();
  for (const double opening : make_.opening_rad) {
    entry_flank_.emplace_back(-std::sin(opening / 2.0), std::cos(opening / 2.0));
    exit_flank_.emplace_back(std::sin(opening / 2.0), std::cos(opening / 2.0));
  }
  for (auto* row : {&offset_m_, &bristle_, &slid_from_m_, &speed_m_s_, &wrap_rad_, &ratio_, &beyond_m_, &wear_}) {
    row->assign(2 * n, 0.0);
  }
  span_m_.assign(n, 0.0);
  link_span_m_.assign(n + 1, 0.0);
  growth_.assign(n, Eigen::Vector3d::Zero());
  has_room_ = *std::max_element(make_.clearance_m.begin(), make_.clearance_m.end()) > 0.0;
  for (int sweep = 0; has_room_ && sweep < kSettleSweeps; ++sweep) settle(strips);
  follow(strips);
  straight_m_ = way_m();
  measure_beyond(std::vector<double>(2 * n, 0.0).data(), slid_from_m_);
}

Eigen::Vector2d Tendon::entry(std::size_t joint) const {
  return (make_.entry_radius_m[joint] + offset_m_[2 * joint]) * entry_flank_[joint];
}

Eigen::Vector2d Tendon::exit(std::size_t joint) const {
  return (make_.exit_radius_m[joint] + offset_m_[2 * joint + 1]) * exit_flank_[joint];
}

// Each hole in turn: the cable goes straight from the hole before to the hole behind, as far as the rim lets it.
void Tendon::settle(const std::vector<Strip>& strips) {
  const std::size_t n = make_.joints();
  const auto place = [&](std::size_t contact, const Eigen::Vector2d& from, const Eigen::Vector2d& to, double radius_m,
                         const Eigen::Vector2d& flank) {
    const double room_m = make_.clearance_m[contact];
    offset_m_[contact] = std::clamp(crossing(from, to, radius_m * flank, flank), -room_m, room_m);
  };
  for (std::size_t j = 0; j < n; ++j) {
    const Pose& pose = strips[j].pose();
    const double cos = std::cos(pose.z()), sin = std::sin(pose.z());
    const double ra = make_.entry_radius_m[j], rb = make_.exit_radius_m[j];
    const Eigen::Vector2d before = j == 0 ? Eigen::Vector2d(-kBaseRun_m, ra * entry_flank_[0].y())
                                          : Eigen::Vector2d(exit(j - 1) - Eigen::Vector2d(make_.link_m[j - 1], 0.0));
    place(2 * j, before, pose.head<2>() + turned(exit(j), cos, sin), ra, entry_flank_[j]);
    const Eigen::Vector2d behind = j + 1 == n ? Eigen::Vector2d(make_.link_m[j], rb * exit_flank_[j].y())
                                              : Eigen::Vector2d(entry(j + 1) + Eigen::Vector2d(make_.link_m[j], 0.0));
    place(2 * j + 1, turned(entry(j) - pose.head<2>(), cos, -sin), behind, rb, exit_flank_[j]);
  }
}

void Tendon::follow(const std::vector<Strip>& strips) {
  const std::size_t n = make_.joints();
  if (has_room_) settle(strips);
  // Slope of the cable on the link before, in that link's axes.
  double slope = 0.0;
  for (std::size_t j = 0; j < n; ++j) {
    const Pose& pose = strips[j].pose();
    const double cos = std::cos(pose.z()), sin = std::sin(pose.z());
    const Eigen::Vector2d in = entry(j), out = turned(exit(j), cos, sin);
    const Eigen::Vector2d on_link =
        j == 0 ? Eigen::Vector2d(in.x() + kBaseRun_m, in.y() - make_.entry_radius_m[0] * entry_flank_[0].y())
               : Eigen::Vector2d(in + Eigen::Vector2d(make_.link_m[j - 1], 0.0) - exit(j - 1));
    link_span_m_[j] = on_link.norm();
    slope = std::atan2(on_link.y(), on_link.x());
    const Eigen::Vector2d span = pose.head<2>() + out - in;
    span_m_[j] = std::max(span.norm(), kShortestSpan_m);
    const Eigen::Vector2d along = span / span_m_[j];
    growth_[j] = {along.x(), along.y(), along.y() * out.x() - along.x() * out.y()};
    const double direction = std::atan2(span.y(), span.x());
    wrap_rad_[2 * j] = std::abs(direction - slope);
    // Beyond the joint, in the axes of the link there.
    const Eigen::Vector2d from = exit(j);
    const Eigen::Vector2d to = j + 1 == n
                                   ? Eigen::Vector2d(make_.link_m[j], make_.exit_radius_m[j] * exit_flank_[j].y())
                                   : Eigen::Vector2d(entry(j + 1) + Eigen::Vector2d(make_.link_m[j], 0.0));
    const Eigen::Vector2d next = to - from;
    wrap_rad_[2 * j + 1] = std::abs(direction - pose.z() - std::atan2(next.y(), next.x()));
    if (j + 1 == n) link_span_m_[n] = next.norm();
  }
}

double Tendon::way_m() const {
  double total_m = 0.0;
  for (const double span_m : span_m_) total_m += span_m;
  for (const double span_m : link_span_m_) total_m += span_m;
  return total_m;
}

// -- tension --------------------------------------------------------------------------------------------------------

// ln(T before / T after) at a contact when fully sliding (rig/truth.py has the law and its sources).
double Tendon::log_ratio(std::size_t contact, double tension_n) const {
  const double wrap = wrap_rad_[contact];
  const double tension = std::max(tension_n, kTensionFloor_N);
  const double slow = std::exp(-std::abs(speed_m_s_[contact]) / make_.friction_stribeck_speed_m_s);
  const double mu = (make_.friction_pressure[contact] + make_.friction_adhesion[contact] / std::sqrt(tension)) *
                    (1.0 + make_.friction_stribeck_share * slow);
  const double bent = 1.0 - std::exp(-wrap / kBentFrom_rad);
  return mu * wrap + bent * (std::log1p(2.0 * make_.bending_n / tension) + 2.0 * make_.bending_share);
}

void Tendon::find_ratios(const double* span_tension_n, double friction_scale) {
  double drop = 0.0;
  for (std::size_t k = 0; k < ratio_.size(); ++k) {
    drop += bristle_[k] * (friction_scale * (1.0 + wear_[k]) * log_ratio(k, span_tension_n[k]));
    ratio_[k] = std::exp(-drop);
  }
}

Tendon::Pull Tendon::pull(double wound_m, double slack_m, bool broken) const {
  double stretching_m = make_.lead_length_m;
  for (std::size_t j = 0; j < span_m_.size(); ++j) {
    stretching_m += ratio_[2 * j] * span_m_[j] + ratio_[2 * j + 1] * link_span_m_[j + 1];
  }
  const double stretch_m = wound_m - pulled_length_m() - slack_m - lengthened_m();
  if (broken || stretch_m <= 0.0) return {0.0, 0.0};
  const double rate_n_per_m = make_.cable_stiffness_n / stretching_m;
  return {stretch_m * rate_n_per_m, rate_n_per_m};
}

// Unstretched cable beyond each contact [m], (2 n): less of it means that cable came out past the contact.
void Tendon::measure_beyond(const double* span_tension_n, std::vector<double>& beyond_m) const {
  double total_m = 0.0;
  for (std::size_t k = 2 * span_m_.size(); k-- > 0;) {
    const double path_m = k % 2 == 0 ? span_m_[k / 2] : link_span_m_[k / 2 + 1];
    total_m += path_m * (1.0 - span_tension_n[k] / make_.cable_stiffness_n);
    beyond_m[k] = total_m;
  }
}

void Tendon::slide(const double* span_tension_n, double dt_s) {
  measure_beyond(span_tension_n, beyond_m_);
  for (std::size_t k = 0; k < beyond_m_.size(); ++k) {
    const double travel_m = slid_from_m_[k] - beyond_m_[k];
    slid_from_m_[k] = beyond_m_[k];
    // The bristle heads for the sign of the motion and gets there within a few presliding lengths.
    const double keep = std::exp(-std::abs(travel_m) / make_.presliding_m);
    bristle_[k] = sign(travel_m) * (1.0 - keep) + bristle_[k] * keep;
    speed_m_s_[k] += kSpeedFilter * (travel_m / dt_s - speed_m_s_[k]);
    // Archard: what is rubbed off grows with the force times the way.
    wear_[k] += make_.wear_per_j[k] * span_tension_n[k] * wrap_rad_[k] * std::abs(travel_m);
  }
}

// -- what time and use do to the cable --------------------------------------------------------------------------------

void Tendon::age(double tension_n, double dt_s) {
  largest_n_ = std::max(largest_n_, tension_n);
  const double due = make_.bedding_strain * (1.0 - std::exp(-largest_n_ / make_.bedding_n));
  bedded_ += std::max(due - bedded_, 0.0) * std::min(1.0, dt_s / kBedding_s);
  const double elastic = tension_n / make_.cable_stiffness_n;
  crept_ += (make_.creep_share * elastic - crept_) * std::min(1.0, dt_s / make_.creep_time_s);
  loadings_ += std::abs(tension_n - tension_before_n_) / (2.0 * kLoading_N);
  tension_before_n_ = tension_n;
}

double Tendon::lengthened_m() const {
  const double length_m = make_.lead_length_m + straight_m_;
  return length_m * (bedded_ + crept_) + make_.knot_slip_m * std::log1p(loadings_) - longer_when_mounted_m_;
}

void Tendon::restore(const double* memory) {
  bedded_ = memory[0];
  largest_n_ = memory[1];
  loadings_ = memory[2];
  std::copy_n(memory + 3, wear_.size(), wear_.begin());
  // The slack of a mounted finger is what the cable is too long by then.
  longer_when_mounted_m_ = 0.0;
  longer_when_mounted_m_ = lengthened_m();
}

void Tendon::recall(double* memory) const {
  memory[0] = bedded_;
  memory[1] = largest_n_;
  memory[2] = loadings_;
  std::copy_n(wear_.begin(), wear_.size(), memory + 3);
}

}  // namespace softgrip::plant
