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
constexpr double kLargestTurn_rad = 0.05;

std::vector<Strip> strips_of(const FingerMake& make) {
  std::vector<Strip> strips;
  strips.reserve(make.strips.size());
  for (const StripMake& strip : make.strips) strips.emplace_back(strip);
  return strips;
}

// In the finger's base frame, where y points to the side that the finger opens to.
Eigen::Vector2d turned(const Eigen::Vector2d& point, double heading) {
  const double cos = std::cos(heading), sin = std::sin(heading);
  return {cos * point.x() - sin * point.y(), -sin * point.x() - cos * point.y()};
}

}  // namespace

Finger::Finger(FingerMake make, FingerView view)
    : make_(std::move(make)), view_(view), strips_(strips_of(make_)), tendon_(make_.tendon, strips_) {
  const std::size_t n = make_.joints();
  for (const double opening : make_.tendon.opening_rad) stop_rad_.push_back(opening - kStopBeforeClosed_rad);
  speed_.assign(n, Pose::Zero());
  middle_speed_m_s_.assign(n, Eigen::Vector2d::Zero());
  force_.resize(kFreedoms * n);
  change_.resize(kFreedoms * n);
  matrix_.resize(kFreedoms * n, kFreedoms * n);
}

void Finger::adopt(const Finger& before) {
  const std::size_t n = make_.joints();
  if (before.make_.joints() != n) return;
  std::copy_n(before.view_.q, n, view_.q);
  std::copy_n(before.view_.joint_speed, n, view_.joint_speed);
  std::copy_n(before.view_.span_tension_n, 2 * n, view_.span_tension_n);
  *view_.tension_n = *before.view_.tension_n;
  strips_ = before.strips_;
  tendon_ = before.tendon_;
  speed_ = before.speed_;
  middle_speed_m_s_ = before.middle_speed_m_s_;
}

std::vector<double> Finger::recall() const {
  std::vector<double> memory(Strip::kMemory * strips_.size() + tendon_.memory());
  for (std::size_t j = 0; j < strips_.size(); ++j) strips_[j].recall(&memory[Strip::kMemory * j]);
  tendon_.recall(&memory[Strip::kMemory * strips_.size()]);
  return memory;
}

void Finger::restore(const std::vector<double>& memory) {
  if (memory.size() != Strip::kMemory * strips_.size() + tendon_.memory()) return;
  for (std::size_t j = 0; j < strips_.size(); ++j) strips_[j].restore(&memory[Strip::kMemory * j]);
  tendon_.restore(&memory[Strip::kMemory * strips_.size()]);
}

void Finger::shape(FingerShape& shape, double ago_s) const {
  const std::size_t n = make_.joints();
  shape.joints.resize(n + 1);
  shape.origins.resize(n);
  shape.heading_rad.resize(n);
  Eigen::Vector2d joint(0.0, 0.0);
  double heading = 0.0;
  for (std::size_t j = 0; j < n; ++j) {
    const Pose pose = strips_[j].pose() - ago_s * speed_[j];
    shape.joints[j] = joint + turned(strips_[j].middle_m() - ago_s * middle_speed_m_s_[j], heading);
    shape.origins[j] = joint + turned(pose.head<2>(), heading);
    heading += pose.z();
    shape.heading_rad[j] = heading;
    joint = shape.origins[j] + turned({make_.link_m()[j], 0.0}, heading);
  }
  shape.joints[n] = joint;
}

// -- motion ---------------------------------------------------------------------------------------------------------

void Finger::step(double wound_m, double slack_m, bool broken, const Conditions& conditions, double dt_s,
                  const FingerLoad& load) {
  tendon_.find_ratios(view_.span_tension_n, conditions.friction_scale);
  const Tendon::Pull pull = tendon_.pull(wound_m, slack_m, broken);
  solve(pull, dt_s, load, conditions.room);
  const double given_m = move(dt_s, conditions.room);
  // The tension at the end of the step: what the links gave way has left the cable.
  *view_.tension_n = std::max(pull.tension_n - pull.rate_n_per_m * given_m, 0.0);
  for (std::size_t k = 0; k < 2 * make_.joints(); ++k) view_.span_tension_n[k] = *view_.tension_n * tendon_.ratio(k);
  tendon_.follow(strips_);
  tendon_.slide(view_.span_tension_n, dt_s);
  tendon_.age(*view_.tension_n, dt_s);
}

// Linearly implicit step: (damping / dt + stiffness) change = force. The cable's pull across a groove works on the pose
// of the link beyond alone, and falls with every link that gives way.
void Finger::solve(const Tendon::Pull& pull, double dt_s, const FingerLoad& load, const Room& room) {
  const std::size_t n = make_.joints();
  for (std::size_t j = 0; j < n; ++j) {
    const StripForce strip = strips_[j].condense(dt_s, room);
    const Eigen::Vector3d by_cable = tendon_.ratio(2 * j) * tendon_.growth(j);
    for (std::size_t k = 0; k < n; ++k) {
      matrix_.block<kFreedoms, kFreedoms>(kFreedoms * j, kFreedoms * k) =
          by_cable * pull.rate_n_per_m * tendon_.growth(k).transpose();
    }
    matrix_.block<kFreedoms, kFreedoms>(kFreedoms * j, kFreedoms * j) += strip.tangent;
    force_.segment<kFreedoms>(kFreedoms * j) = -strip.force - pull.tension_n * by_cable;
    const double over_rad = strips_[j].pose().z() - stop_rad_[j];
    if (over_rad > 0.0) {
      force_(kFreedoms * j + 2) -= kStopStiffness_NmPerRad * over_rad;
      matrix_(kFreedoms * j + 2, kFreedoms * j + 2) += kStopStiffness_NmPerRad;
    }
  }
  if (load.force != nullptr) {
    for (std::size_t i = 0; i < kFreedoms * n; ++i) {
      force_(i) += load.force[i];
      for (std::size_t k = 0; k < kFreedoms * n; ++k) matrix_(i, k) += load.stiffness[i * load.stride + k];
    }
  }
  factors_.compute(matrix_);
  change_ = factors_.solve(force_);
}

// Take the step, or as much of it as turns no joint too far; returns the cable [m] that it lets out.
double Finger::move(double dt_s, const Room& room) {
  double largest_rad = kLargestTurn_rad;
  for (std::size_t j = 0; j < make_.joints(); ++j) largest_rad = std::max(largest_rad, std::abs(change_(3 * j + 2)));
  const double share = kLargestTurn_rad / largest_rad;
  double given_m = 0.0;
  for (std::size_t j = 0; j < make_.joints(); ++j) {
    const Pose change = share * change_.segment<kFreedoms>(kFreedoms * j);
    const Eigen::Vector2d middle_m = strips_[j].middle_m();
    given_m -= tendon_.growth(j).dot(change);
    strips_[j].move(change, share, dt_s, room);
    speed_[j] = change / dt_s;
    middle_speed_m_s_[j] = (strips_[j].middle_m() - middle_m) / dt_s;
    view_.q[j] = strips_[j].pose().z();
    view_.joint_speed[j] = speed_[j].z();
  }
  return given_m;
}

}  // namespace softgrip::plant
