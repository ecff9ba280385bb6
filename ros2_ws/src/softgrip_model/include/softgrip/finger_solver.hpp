// SPDX-License-Identifier: Apache-2.0
// Equilibria from nothing, and along a closing. A failed element says why; it never carries numbers.
#pragma once

#include "softgrip/finger_sensitivity.hpp"

namespace softgrip::finger {

namespace detail {

inline Equilibrium without_solution(std::uint32_t status) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  Equilibrium out;
  out.state.angle_rad.fill(nan);
  out.state.log_tip_tension = nan;
  out.log_tension.fill(nan);
  out.pull_rate.fill(nan);
  out.phi_rad.fill(nan);
  out.pulled_mm = nan;
  out.status = status;
  return out;
}

// Straight finger, no tension.
inline Equilibrium slack(const Finger& finger) {
  Equilibrium out;
  out.log_tension.fill(-HUGE_VAL);
  out.pull_rate.fill(0.0);
  out.state.log_tip_tension = -HUGE_VAL;
  for (int j = 0; j < finger.design.joints; ++j) {
    const Groove groove = finger.groove(j, 0.0);
    for (int i : {2 * j, 2 * j + 1}) out.phi_rad[i] = finger.bend_rad(i, groove, 0.0);
  }
  out.status = kSlack;
  return out;
}

// kOk when Newton may try; otherwise the answer's status.
inline std::uint32_t unsolvable(const Finger& finger, Control control, double target) {
  if (!std::isfinite(target)) return kBadTarget;
  if (control == Control::Tension && target < 0.0) return kBadTarget;
  const bool rigid = finger.design.cable.compliance_per_N == 0.0;
  if (control == Control::PulledLength && rigid && target >= finger.reach_mm) {
    return kOutOfReach;
  }
  if (control == Control::Deflection) {
    double closed = 0.0;
    for (int j = 0; j < finger.design.joints; ++j) closed += finger.design.opening_rad[j];
    if (target >= closed) return kOutOfReach;
  }
  return kOk;
}

}  // namespace detail

// One equilibrium from nothing: a pure function of its arguments. Where Newton fails from the straight finger's linear
// answer, the target is approached in steps.
inline Equilibrium solve(const Finger& finger, Control control, double target) {
  const std::uint32_t refusal = detail::unsolvable(finger, control, target);
  if (refusal != kOk) return detail::without_solution(refusal);
  if (target <= 0.0) return detail::slack(finger);
  PerJoint<TurningHalfAngle> turning;
  Equilibrium found;
  newton(finger, straight_start(finger, control, target), control, target, turning, found);
  if ((found.status & kFailure) == kOk) return found;
  constexpr int kSteps = 32;
  State x = straight_start(finger, control, target / kSteps);
  int iterations = found.iterations;
  for (int i = 1; i <= kSteps; ++i) {
    newton(finger, x, control, target * i / kSteps, turning, found);
    iterations += found.iterations;
    if ((found.status & kFailure) != kOk) return detail::without_solution(found.status & kFailure);
    x = found.state;
  }
  found.iterations = iterations;
  return found;
}

// Equilibria along growing targets, each started where the last six lead: then one Newton step suffices, or two for
// lanes of targets solved together.
class March {
 public:
  explicit March(const Finger& finger, Control control) : finger_(finger), control_(control) {}

  Equilibrium to(double target) {
    const double log_target = std::log(target);
    Equilibrium found;
    if (known_ > 0 && target > last_target_ && detail::unsolvable(finger_, control_, target) == kOk) {
      newton(finger_, ahead(target, log_target), control_, target, turning_, found);
    }
    if ((found.status & kFailure) != kOk) {
      known_ = 0;
      found = solve(finger_, control_, target);
    }
    if ((found.status & (kFailure | kSlack)) == kOk) keep_solution(target, log_target, found.state);
    return found;
  }

  // As many of the next targets as `found` has lanes, together; false where they are better asked for one by one.
  template <typename Real>
  bool to(const double* targets, EquilibriumOf<Real>& found) {
    constexpr int kNext = kLanes<Real>;
    if (known_ < kPoints || detail::unsolvable(finger_, control_, targets[kNext - 1]) != kOk) return false;
    Real target, log_target;
    double before = last_target_;
    for (int i = 0; i < kNext; before = targets[i++]) {
      if (!(targets[i] > before)) return false;
      target[i] = targets[i];
      log_target[i] = std::log(targets[i]);
    }
    const Real& prescribed = control_ == Control::Tension ? log_target : target;
    if (!newton_lanes(finger_, ahead(target, log_target), control_, prescribed, found)) return false;
    for (int i = std::max(0, kNext - kPoints); i < kNext; ++i)
      keep_solution(target[i], log_target[i], lane_of(found.state, i));
    return true;
  }

 private:
  static constexpr int kPoints = 6;

  // Lagrange extrapolation over u = ln(target) of angle/target and ln(tension/target): down to the straight finger
  // these are smooth in u, while angle and ln(tension) are not polynomials in the target.
  template <typename Real>
  StateOf<Real> ahead(const Real& target, const Real& u) const {
    const int n = finger_.design.joints;
    StateOf<Real> x;
    x.log_tip_tension = u;
    for (int i = 0; i < known_; ++i) {
      Real numerator = Real{} + 1.0;
      double denominator = 1.0;
      for (int k = 0; k < known_; ++k) {
        if (k == i) continue;
        numerator *= u - log_target_[k];
        denominator *= log_target_[i] - log_target_[k];
      }
      const Real weight = numerator * (1.0 / denominator), angle_weight = weight * target;
      for (int j = 0; j < n; ++j) x.angle_rad[j] += angle_weight * state_[i].angle_rad[j];
      for (int j = 0; j < n && finger_.is_flexure(); ++j) {
        for (int k : {0, 1}) x.shift_mm[j][k] += angle_weight * state_[i].shift_mm[j][k];
      }
      x.log_tip_tension += weight * state_[i].log_tip_tension;
    }
    for (int j = 0; j < n; ++j) {
      const double shut = finger_.design.opening_rad[j];
      const double nearly = 0.2 * last_target_ * state_[newest_].angle_rad[j] + 0.8 * shut;
      x.angle_rad[j] = x.angle_rad[j] >= shut ? Real{} + nearly : x.angle_rad[j];
    }
    return x;
  }

  void keep_solution(double target, double log_target, const State& found) {
    newest_ = known_ == 0 ? 0 : (newest_ + 1) % kPoints;
    known_ = std::min(known_ + 1, kPoints);
    last_target_ = target;
    log_target_[newest_] = log_target;
    const double per_target = 1.0 / target;
    State& kept = state_[newest_];
    for (int j = 0; j < finger_.design.joints; ++j) kept.angle_rad[j] = found.angle_rad[j] * per_target;
    for (int j = 0; j < finger_.design.joints && finger_.is_flexure(); ++j) {
      for (int k : {0, 1}) kept.shift_mm[j][k] = found.shift_mm[j][k] * per_target;
    }
    kept.log_tip_tension = found.log_tip_tension - log_target;
  }

  const Finger& finger_;
  Control control_;
  PerJoint<TurningHalfAngle> turning_;
  std::array<State, kPoints> state_;  // a ring; angles and tension relative to the target
  std::array<double, kPoints> log_target_{};
  double last_target_ = 0.0;
  int known_ = 0, newest_ = 0;
};

}  // namespace softgrip::finger
