// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/finger.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace softgrip::plant {

namespace {

constexpr double kStopStiffness_NmPerRad = 3.0;
// The flanks of a groove meet this much before it is geometrically closed (print flash).
constexpr double kStopBeforeClosed_rad = 0.05;
constexpr double kTensionReference_N = 5.0;
constexpr double kTensionFloor_N = 0.05;
constexpr double kBiteAngle_rad = 0.05;
constexpr double kLeastStiffnessShare = 0.2;
constexpr double kLargestTurn_rad = 0.05;
constexpr double kSpeedFilter = 0.1;

double sign(double value) {
  return static_cast<double>((value > 0.0) - (value < 0.0));
}

}  // namespace

Finger::Finger(FingerMake make, FingerView view) : make_(std::move(make)), view_(view) {
  const std::size_t n = make_.joints();
  for (auto* per_joint : {&half_, &entry_along_, &entry_inward_, &radii_squared_, &radii_product_, &stop_, &link_span_,
                          &relaxed_nm_, &span_m_, &arm_m_, &elastic_}) {
    per_joint->assign(n, 0.0);
  }
  for (auto* per_contact : {&bristle_, &slid_from_m_, &speed_m_s_, &ratio_, &beyond_m_}) {
    per_contact->assign(2 * n, 0.0);
  }
  link_slope_.assign(n + 1, 0.0);
  torque_.resize(n);
  change_.resize(n);
  matrix_.resize(n, n);
  shape();
  measure_spans();
  for (const double span_m : span_m_) straight_m_ += span_m;
  measure_beyond(slid_from_m_);
}

void Finger::adopt(const Finger& before) {
  const std::size_t n = make_.joints();
  if (before.make_.joints() != n) return;
  std::copy_n(before.view_.q, n, view_.q);
  std::copy_n(before.view_.joint_speed, n, view_.joint_speed);
  std::copy_n(before.view_.span_tension_n, 2 * n, view_.span_tension_n);
  *view_.tension_n = *before.view_.tension_n;
  relaxed_nm_ = before.relaxed_nm_;
  bristle_ = before.bristle_;
  slid_from_m_ = before.slid_from_m_;
  speed_m_s_ = before.speed_m_s_;
  measure_spans();
}

// -- geometry -------------------------------------------------------------------------------------------------------

void Finger::shape() {
  const std::size_t n = make_.joints();
  const auto& ra = make_.entry_radius_m;
  const auto& rb = make_.exit_radius_m;
  for (std::size_t j = 0; j < n; ++j) {
    half_[j] = make_.opening_rad[j] / 2.0;
    entry_along_[j] = ra[j] * std::sin(half_[j]);
    entry_inward_[j] = ra[j] * std::cos(half_[j]);
    radii_squared_[j] = ra[j] * ra[j] + rb[j] * rb[j];
    radii_product_[j] = ra[j] * rb[j];
    stop_[j] = make_.opening_rad[j] - kStopBeforeClosed_rad;
  }
  // The cable is parallel to the link before the first and after the last joint.
  for (std::size_t j = 0; j < n; ++j) {
    const double ends_m = rb[j] * std::sin(half_[j]);
    const bool last = j + 1 == n;
    const double run_m = make_.link_m[j] - ends_m - (last ? 0.0 : entry_along_[j + 1]);
    link_span_[j] = std::max(run_m, 0.0);
    if (last || run_m <= 0.0) continue;
    link_slope_[j + 1] = std::atan2(rb[j] * std::cos(half_[j]) - entry_inward_[j + 1], std::max(run_m, 1e-6));
  }
}

void Finger::measure_spans() {
  for (std::size_t j = 0; j < span_m_.size(); ++j) {
    const double gap = make_.opening_rad[j] - view_.q[j];
    span_m_[j] = std::sqrt(std::max(radii_squared_[j] - 2.0 * radii_product_[j] * std::cos(gap), 1e-10));
    arm_m_[j] = radii_product_[j] * std::sin(gap) / span_m_[j];
  }
}

// Unstretched cable beyond each contact [m], (2 n): less of it means that cable came out past the contact.
void Finger::measure_beyond(std::vector<double>& beyond_m) const {
  double total_m = 0.0;
  for (std::size_t k = 2 * span_m_.size(); k-- > 0;) {
    const double path_m = k % 2 == 0 ? span_m_[k / 2] : link_span_[k / 2];
    total_m += path_m * (1.0 - view_.span_tension_n[k] / make_.cable_stiffness_n);
    beyond_m[k] = total_m;
  }
}

double Finger::pulled_length_m() const {
  double open_m = 0.0;
  for (const double span_m : span_m_) open_m += span_m;
  return straight_m_ - open_m;
}

void Finger::chain(const double* q, double* points, double* heading) const {
  double angle = 0.0, x = 0.0, y = 0.0;
  points[0] = points[1] = 0.0;
  for (std::size_t j = 0; j < make_.joints(); ++j) {
    angle += q[j];
    x += make_.link_m[j] * std::cos(angle);
    y -= make_.link_m[j] * std::sin(angle);
    heading[j] = angle;
    points[2 * j + 2] = x;
    points[2 * j + 3] = y;
  }
}

// -- motion ---------------------------------------------------------------------------------------------------------

void Finger::step(double wound_m, double slack_m, bool broken, double friction_scale, double dt_s,
                  const FingerLoad& load) {
  find_ratios(friction_scale);
  const Pull pull = pull_of(wound_m, slack_m, broken);
  solve(pull, dt_s, load);
  double given_m = 0.0;
  for (std::size_t j = 0; j < make_.joints(); ++j) {
    const double change = std::clamp(change_[j], -kLargestTurn_rad, kLargestTurn_rad);
    given_m += arm_m_[j] * change;
    view_.q[j] += change;
    view_.joint_speed[j] = change / dt_s;
    relaxed_nm_[j] += (make_.creep_share * elastic_[j] - relaxed_nm_[j]) * (1.0 / make_.creep_time_s * dt_s);
  }
  // The tension at the end of the step: what the joints gave way has left the cable.
  *view_.tension_n = std::max(pull.tension_n - pull.rate_n_per_m * given_m, 0.0);
  for (std::size_t k = 0; k < ratio_.size(); ++k) view_.span_tension_n[k] = *view_.tension_n * ratio_[k];
  measure_spans();
  slide(dt_s);
}

// ln(T before / T after) at a contact when fully sliding.
double Finger::log_ratio(std::size_t contact, double wrap_rad) const {
  const double level = std::max(view_.span_tension_n[contact], kTensionFloor_N) / kTensionReference_N;
  const double slow = std::exp(-std::abs(speed_m_s_[contact]) / make_.friction_stribeck_speed_m_s);
  const double mu = make_.friction_coefficient[contact] * std::pow(level, -make_.friction_tension_exponent) *
                    (1.0 + make_.friction_stribeck_share * slow);
  return mu * wrap_rad + make_.friction_bite[contact] * (1.0 - std::exp(-wrap_rad / kBiteAngle_rad));
}

// Tension after each contact over the tension at the spool.
void Finger::find_ratios(double friction_scale) {
  double drop = 0.0;
  for (std::size_t j = 0; j < span_m_.size(); ++j) {
    // The cable in the groove: exit point turned by -q about the joint, minus entry point.
    const double turned = half_[j] - view_.q[j];
    const double along_m = make_.exit_radius_m[j] * std::sin(turned) + entry_along_[j];
    const double inward_m = entry_inward_[j] - make_.exit_radius_m[j] * std::cos(turned);
    const double slope = std::atan2(inward_m, along_m);
    const double wraps[] = {std::abs(link_slope_[j] - slope), std::abs(slope - link_slope_[j + 1] + view_.q[j])};
    for (std::size_t side = 0; side < 2; ++side) {
      const std::size_t contact = 2 * j + side;
      drop += bristle_[contact] * (friction_scale * log_ratio(contact, wraps[side]));
      ratio_[contact] = std::exp(-drop);
    }
  }
}

Finger::Pull Finger::pull_of(double wound_m, double slack_m, bool broken) const {
  double in_grooves_m = 0.0, on_links_m = 0.0;
  for (std::size_t j = 0; j < span_m_.size(); ++j) {
    in_grooves_m += ratio_[2 * j] * span_m_[j];
    on_links_m += ratio_[2 * j + 1] * link_span_[j];
  }
  const double compliance = (make_.lead_length_m + in_grooves_m + on_links_m) / make_.cable_stiffness_n;
  const double excess_m = wound_m - pulled_length_m() - slack_m;
  if (broken || excess_m <= 0.0) return {0.0, 0.0};
  return {excess_m / compliance, 1.0 / compliance};
}

// Linearly implicit step: (damping / dt + stiffness) change = torque.
void Finger::solve(const Pull& pull, double dt_s, const FingerLoad& load) {
  const std::size_t n = make_.joints();
  for (std::size_t j = 0; j < n; ++j) {
    const double q = view_.q[j], size = std::abs(q);
    const double m1 = make_.moment_linear[j], m2 = make_.moment_quadratic[j], m3 = make_.moment_cubic[j];
    const double over = q - stop_[j];
    const double by_cable_m = ratio_[2 * j] * arm_m_[j];
    elastic_[j] = q * (m1 + m2 * size + m3 * q * q);
    torque_[j] = pull.tension_n * by_cable_m - elastic_[j] + relaxed_nm_[j];
    double diagonal = m1 * make_.damping_s / dt_s;
    diagonal += std::max(m1 + 2.0 * m2 * size + 3.0 * m3 * q * q, kLeastStiffnessShare * m1);
    if (over > 0.0) {
      torque_[j] -= kStopStiffness_NmPerRad * over;
      diagonal += kStopStiffness_NmPerRad;
    }
    for (std::size_t k = 0; k < n; ++k) matrix_(j, k) = by_cable_m * pull.rate_n_per_m * arm_m_[k];
    if (load.torque_nm != nullptr) {
      torque_[j] += load.torque_nm[j];
      for (std::size_t k = 0; k < n; ++k) matrix_(j, k) += load.stiffness[j * load.stride + k];
    }
    matrix_(j, j) += diagonal;
  }
  factors_.compute(matrix_);
  change_ = factors_.solve(torque_);
}

// Turn the bristles by what the cable has travelled over each contact.
void Finger::slide(double dt_s) {
  measure_beyond(beyond_m_);
  for (std::size_t k = 0; k < beyond_m_.size(); ++k) {
    const double travel_m = slid_from_m_[k] - beyond_m_[k];
    slid_from_m_[k] = beyond_m_[k];
    // The bristle heads for the sign of the motion and gets there within a few presliding lengths.
    const double keep = std::exp(-std::abs(travel_m) / make_.presliding_m);
    bristle_[k] = sign(travel_m) * (1.0 - keep) + bristle_[k] * keep;
    speed_m_s_[k] += kSpeedFilter * (travel_m / dt_s - speed_m_s_[k]);
  }
}

}  // namespace softgrip::plant
