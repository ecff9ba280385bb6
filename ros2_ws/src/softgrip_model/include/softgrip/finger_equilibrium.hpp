// SPDX-License-Identifier: Apache-2.0
// Equilibrium of a finger whose cable slides towards the actuator at every routing point (closing).
//
// Unknowns: joint angles q_0..q_{n-1} and s = ln(tension at the tip). The tensions follow from the tip inwards,
//   ln T_{i} = ln T_{i+1} + ln Rf(|phi_i|, T_{i+1})          at routing point i (thesis Eq 3.9),
// so joint j, which feels the span tension T_{2j+1}, depends on q_j..q_{n-1} and s only. The Jacobian is an arrow:
// forward substitution gives dq = a + b ds, and the control's row gives ds.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "softgrip/finger_design.hpp"
#include "softgrip/finger_joint.hpp"
#include "softgrip/friction.hpp"

namespace softgrip::finger {

// What is prescribed: pulled length [mm], actuator tension [N], or the sum of the joint angles [rad].
enum class Control : std::uint8_t { PulledLength = 0, Tension = 1, Deflection = 2 };

// Tensions are numbered by span: 0 actuator to point 0, 2j+1 across the groove of joint j, 2n the tip span.
inline constexpr int kMaxSpans = kMaxPoints + 1;
template <typename T>
using PerSpan = std::array<T, kMaxSpans>;

template <typename Real>
struct StateOf {
  PerJoint<Real> angle_rad{};
  Real log_tip_tension{};
};
using State = StateOf<double>;

template <typename Real>
State lane_of(const StateOf<Real>& x, int i) {
  State one;
  for (int j = 0; j < kMaxJoints; ++j) one.angle_rad[j] = lane(x.angle_rad[j], i);
  one.log_tip_tension = lane(x.log_tip_tension, i);
  return one;
}

// A design with everything that does not change while the finger closes.
struct Finger {
  Design design;
  friction::Prepared friction;
  friction::Range angle_rad, log_tension;  // calibrated; looked at once a solution is found
  PerJoint<Strip> strip;
  PerJoint<double> straight_span_mm{}, straight_arm_mm{};
  std::array<double, kMaxJoints + 1> slope_rad{};         // of the cable inside link k-1; 0 before joint 0 and at the tip
  std::array<double, kMaxJoints + 1> link_span_mm{};      // cable inside link k-1
  double reach_mm = 0.0;                                  // pulled length with all grooves shut

  Finger(const Design& d, const friction::Model& f) : design(d), friction(f), angle_rad(f.angle_rad) {
    const int n = d.joints;
    log_tension = {f.tension_N.low > 0.0 ? std::log(f.tension_N.low) : -HUGE_VAL, std::log(f.tension_N.high)};
    for (int j = 0; j < n; ++j) {
      strip[j] = Strip(d.material, d.width_mm[j], d.thickness_mm[j], d.length_mm[j]);
      const double ra = d.routing_mm[2 * j], rb = d.routing_mm[2 * j + 1];
      const Groove straight = groove(j, 0.0);
      straight_span_mm[j] = straight.span_mm;
      straight_arm_mm[j] = straight.arm_mm;
      reach_mm += straight_span_mm[j] - std::abs(ra - rb);
    }
    link_span_mm[0] = d.cable.lead_mm + d.base_mm;
    link_span_mm[n] = d.link_mm[n - 1] - d.routing_mm[2 * n - 1] * std::sin(0.5 * d.opening_rad[n - 1]);
    for (int k = 1; k < n; ++k) {
      const auto [dx, dy] = link_offset(k);
      slope_rad[k] = std::atan2(dy, dx);
      link_span_mm[k] = std::hypot(dx, dy);
    }
  }

  Groove groove(int j, double q) const {
    return {design.opening_rad[j], q, design.routing_mm[2 * j], design.routing_mm[2 * j + 1]};
  }

  template <typename Real, typename HalfAngles>
  GrooveOf<Real> groove(int j, const Real& q, HalfAngles& half_angles) const {
    const double ra = design.routing_mm[2 * j], rb = design.routing_mm[2 * j + 1];
    return {half_angles.at(Real(0.5 * (design.opening_rad[j] - q)), ra, rb), q, ra, rb};
  }

  // Signed bend of the cable at a routing point, given the groove it belongs to.
  template <typename Real>
  Real bend_rad(int point, const GrooveOf<Real>& groove, const Real& q) const {
    const int j = point / 2;
    return point % 2 == 0 ? slope_rad[j] - groove.direction_rad : groove.direction_rad - slope_rad[j + 1] + q;
  }

  // From exit of joint k-1 to entry of joint k, in the frame of the link between them.
  std::array<double, 2> link_offset(int k) const {
    const double rb = design.routing_mm[2 * k - 1], ra = design.routing_mm[2 * k];
    const double before = 0.5 * design.opening_rad[k - 1], after = 0.5 * design.opening_rad[k];
    return {design.link_mm[k - 1] - rb * std::sin(before) - ra * std::sin(after),
            rb * std::cos(before) - ra * std::cos(after)};
  }
};

// ln Rf at one routing point with its slopes; phi is signed, the law sees its smoothed size.
template <friction::Slopes slopes, typename Real = double>
struct PointFriction {
  friction::EvaluationOf<Real> law;
  Real d_phi;

  PointFriction(const Finger& finger, const Real& phi, const friction::TensionOf<Real>& low) {
    const double smoothing = finger.design.angle_smoothing_rad;
    const Real size = sqrt(Real(phi * phi + smoothing * smoothing));
    if constexpr (kLanes<Real> == 1) {
      law = friction::evaluate_at<slopes>(finger.friction, size, low);
    } else {
      law = friction::lanes_at(finger.friction, size, low);
    }
    d_phi = size > 0.0 ? law.d_angle * phi / size : Real{};
  }
  Real gain() const { return 1.0 + law.d_log_tension; }  // d ln T_high / d ln T_low
};

// One joint with the cable's two bends, linearised: given T beyond the joint, everything up to T before it.
template <friction::Slopes slopes, typename Real = double>
struct Joint {
  GrooveOf<Real> groove;
  Real phi_entry, phi_exit;
  PointFriction<slopes, Real> exit;
  friction::TensionOf<Real> across;  // the free span
  PointFriction<slopes, Real> entry;
  friction::TensionOf<Real> before;
  Real tension, torque;
  MomentOf<Real> strip, stop;
  Real exit_slope, entry_slope;  // d ln Rf / dq
  Real diagonal;                 // d residual / dq

  Joint(const Finger& f, int j, const Real& q, const GrooveOf<Real>& at, const friction::TensionOf<Real>& beyond)
      : groove(at),
        phi_entry(f.bend_rad(2 * j, groove, q)),
        phi_exit(f.bend_rad(2 * j + 1, groove, q)),
        exit(f, phi_exit, beyond),
        across(beyond.before(exit.law)),
        entry(f, phi_entry, across),
        before(across.before(entry.law)),
        tension(exp(across.log)),
        torque(tension * groove.arm_mm),
        strip(f.strip[j].at(q)),
        stop(stop_moment(f.design.stop, f.design.opening_rad[j], q)),
        exit_slope(exit.d_phi * (groove.d_direction + 1.0)),
        entry_slope(-entry.d_phi * groove.d_direction),
        diagonal(strip.d_angle + stop.d_angle - tension * groove.d_arm - torque * exit_slope) {}

  Real moment() const { return strip.value_Nmm + stop.value_Nmm; }
  Real residual() const { return moment() - torque; }
};

// A quantity to first order along the Newton step: value + constant + slope ds.
template <typename Real>
struct Linear {
  Real value, constant, slope;
  void add(const Real& v, const Real& c, const Real& s) { value += v, constant += c, slope += s; }
  Real after(const Real& ds) const { return value + constant + slope * ds; }
};

// One pass from the tip to the actuator: tensions, residuals, and the Newton step that follows from them.
template <typename Real>
struct SweepOf {
  PerSpan<Linear<Real>> log_tension;
  PerJoint<Linear<Real>> angle_rad;
  PerJoint<Real> arm_mm, d_direction;
  PerPoint<Real> phi_rad;
  Linear<Real> pulled_mm{};
  Real log_tip_step;
  std::uint8_t friction_status = 0;

  // `wanted`: the prescribed quantity; of a tension its ln.
  template <typename HalfAngles>
  SweepOf(const Finger& finger, const StateOf<Real>& x, Control control, const Real& wanted,
          PerJoint<HalfAngles>& half_angles) {
    const Design& d = finger.design;
    const int n = d.joints;
    Linear<Real> along{x.log_tip_tension, Real{}, Real{} + 1.0};
    friction::TensionOf<Real> beyond(finger.friction, x.log_tip_tension);
    log_tension[2 * n] = along;
    stretch(d, along, Real{} + finger.link_span_mm[n]);
    for (int j = n - 1; j >= 0; --j) {
      const Real q = x.angle_rad[j];
      const Joint<friction::Slopes::State, Real> joint(finger, j, q, finger.groove(j, q, half_angles[j]), beyond);
      beyond = joint.before;
      const Real gain = joint.torque * joint.exit.gain();
      const Real per_diagonal = 1.0 / joint.diagonal;
      const Real constant = (gain * along.constant - joint.residual()) * per_diagonal;
      const Real slope = gain * along.slope * per_diagonal;
      angle_rad[j] = {x.angle_rad[j], constant, slope};

      along = through(along, joint.exit, joint.exit_slope, angle_rad[j]);
      log_tension[2 * j + 1] = along;
      pulled_mm.add(finger.straight_span_mm[j] - joint.groove.span_mm, joint.groove.arm_mm * constant,
                    joint.groove.arm_mm * slope);
      if (d.cable.compliance_per_N > 0.0) {
        stretch(d, along, joint.groove.span_mm);
        const Real shorter = joint.torque * d.cable.compliance_per_N;
        pulled_mm.add(Real{}, -shorter * constant, -shorter * slope);
      }
      along = through(along, joint.entry, joint.entry_slope, angle_rad[j]);
      log_tension[2 * j] = along;
      stretch(d, along, Real{} + finger.link_span_mm[j]);

      arm_mm[j] = joint.groove.arm_mm;
      d_direction[j] = joint.groove.d_direction;
      phi_rad[2 * j] = joint.phi_entry;
      phi_rad[2 * j + 1] = joint.phi_exit;
      friction_status |= joint.exit.law.status | joint.entry.law.status;
    }
    const Linear<Real> row = controlled(control, n);
    log_tip_step = (wanted - row.value - row.constant) / row.slope;
  }

  // What `wanted` is compared with.
  Linear<Real> controlled(Control control, int n) const {
    if (control == Control::PulledLength) return pulled_mm;
    if (control == Control::Tension) return log_tension[0];
    Linear<Real> sum{};
    for (int j = 0; j < n; ++j) sum.add(angle_rad[j].value, angle_rad[j].constant, angle_rad[j].slope);
    return sum;
  }

 private:
  static Linear<Real> through(const Linear<Real>& along, const PointFriction<friction::Slopes::State, Real>& point,
                              const Real& slope, const Linear<Real>& angle) {
    return {along.value + point.law.log_ratio, point.gain() * along.constant + slope * angle.constant,
            point.gain() * along.slope + slope * angle.slope};
  }

  void stretch(const Design& d, const Linear<Real>& along, const Real& span_mm) {
    if (d.cable.compliance_per_N == 0.0) return;
    const Real extension = exp(along.value) * span_mm * d.cable.compliance_per_N;
    pulled_mm.add(extension, extension * along.constant, extension * along.slope);
  }
};

using Sweep = SweepOf<double>;

template <typename Real>
struct EquilibriumOf {
  using Flags = decltype(where(MaskOf<Real>{}, 0));

  StateOf<Real> state;
  PerSpan<Real> log_tension;
  PerJoint<Real> pull_rate;  // cable taken in at joint j and beyond, per unit of cable pulled; negative = reversing
  PerPoint<Real> phi_rad;
  Real pulled_mm{};
  int iterations = 0;
  Flags status = where(Real{} == Real{}, kNotConverged);
};
using Equilibrium = EquilibriumOf<double>;

// Used outside its calibration? Angles below the smallest calibrated one do not count: every finger has some, and all
// laws run straight into their value at no bend.
template <typename Real>
inline auto range_flags(const Finger& finger, const Real& phi, const Real& log_low_tension) {
  return where(abs(phi) > finger.angle_rad.high, kAngleOutside) |
         where(!finger.log_tension.holds(log_low_tension), kTensionOutside);
}

// Takes the last, tiny step along the sweep's linearisation, so that no further pass is needed.
template <typename Real>
inline void accept(const Finger& finger, const SweepOf<Real>& sweep, EquilibriumOf<Real>& out) {
  const Design& d = finger.design;
  const Real ds = sweep.log_tip_step;
  out.status = typename EquilibriumOf<Real>::Flags{};
  out.state.log_tip_tension = sweep.log_tension[2 * d.joints].value + ds;
  out.pulled_mm = sweep.pulled_mm.after(ds);
  for (int i = 0; i <= 2 * d.joints; ++i) out.log_tension[i] = sweep.log_tension[i].after(ds);
  Real taken{};
  const Real per_pull = 1.0 / sweep.pulled_mm.slope;
  for (int j = d.joints - 1; j >= 0; --j) {
    const Real q = sweep.angle_rad[j].after(ds);
    out.state.angle_rad[j] = q;
    const Real turn = q - sweep.angle_rad[j].value;
    out.phi_rad[2 * j] = sweep.phi_rad[2 * j] - sweep.d_direction[j] * turn;
    out.phi_rad[2 * j + 1] = sweep.phi_rad[2 * j + 1] + (sweep.d_direction[j] + 1.0) * turn;
    for (int i : {2 * j, 2 * j + 1}) out.status |= range_flags(finger, out.phi_rad[i], out.log_tension[i + 1]);
    taken += sweep.arm_mm[j] * sweep.angle_rad[j].slope;
    out.pull_rate[j] = taken * per_pull;
    out.status |= where(out.pull_rate[j] < -1e-9, kReversing);
    if (d.stop.moment_Nmm > 0.0) out.status |= where(q > d.opening_rad[j] - d.stop.margin_rad, kStopEngaged);
    out.status |= where(finger.strip[j].surface_strain(q) > d.material.max_strain, kStrainOutside);
  }
}

// Newton stops once a step is so small that, converging quadratically, the next would be rounding.
inline constexpr double kSmallestStep = 1e-6;

// Newton from a start.
inline void newton(const Finger& finger, State x, Control control, double target, PerJoint<TurningHalfAngle>& turning,
                   Equilibrium& out) {
  constexpr double kLargestAngleStep = 0.25, kLargestLogStep = 1.0;
  constexpr int kMostIterations = 60;
  const int n = finger.design.joints;
  const double wanted = control == Control::Tension ? std::log(target) : target;
  out.status = kNotConverged;
  for (out.iterations = 1; out.iterations <= kMostIterations; ++out.iterations) {
    const Sweep sweep(finger, x, control, wanted, turning);
    // a blow-up first: the NaN that it leaves is invalid for the bends further on
    if ((sweep.friction_status & friction::kBlowUp) != 0) {
      out.status = kFrictionBlowUp;
      return;
    }
    if ((sweep.friction_status & friction::kInvalid) != 0) return;
    const double ds = std::clamp(sweep.log_tip_step, -kLargestLogStep, kLargestLogStep);
    double largest = std::abs(sweep.log_tip_step);
    bool finite = std::isfinite(largest);
    x.log_tip_tension += ds;
    for (int j = 0; j < n; ++j) {
      const double full = sweep.angle_rad[j].constant + sweep.angle_rad[j].slope * ds;
      const double room = 0.8 * (finger.design.opening_rad[j] - x.angle_rad[j]);
      largest = std::max(largest, std::abs(full));
      finite = finite && std::isfinite(full);
      x.angle_rad[j] += std::clamp(full, -kLargestAngleStep, std::min(kLargestAngleStep, room));
    }
    if (!finite) return;
    if (largest < kSmallestStep) {
      accept(finger, sweep, out);
      return;
    }
  }
}

// Newton for lanes from good starts. Where a start is so poor that Newton needs damping, or a lane has no value, it gives
// up (false): those targets are better looked at one by one.
template <typename Real>
inline bool newton_lanes(const Finger& finger, StateOf<Real> x, Control control, const Real& wanted,
                         EquilibriumOf<Real>& out) {
  constexpr double kLargestStep = 0.1;
  constexpr int kMostIterations = 4;
  PerJoint<EachHalfAngle> half_angles;
  for (out.iterations = 1; out.iterations <= kMostIterations; ++out.iterations) {
    const SweepOf<Real> sweep(finger, x, control, wanted, half_angles);
    const Real& ds = sweep.log_tip_step;
    Real largest = abs(ds);
    MaskOf<Real> open = largest < kLargestStep;
    x.log_tip_tension += ds;
    for (int j = 0; j < finger.design.joints; ++j) {
      const Real step = sweep.angle_rad[j].constant + sweep.angle_rad[j].slope * ds;
      x.angle_rad[j] += step;
      open &= (abs(step) < kLargestStep) & (x.angle_rad[j] < finger.design.opening_rad[j]);
      largest = larger(largest, abs(step));
    }
    if (!all(open)) return false;
    if (all(largest < kSmallestStep)) {
      accept(finger, sweep, out);
      return true;
    }
  }
  return false;
}

// Where Newton starts when nothing is known: the straight finger's linear, frictionless answer, scaled to the target.
inline State straight_start(const Finger& finger, Control control, double target) {
  const Design& d = finger.design;
  PerJoint<double> compliance{};
  double pull_per_tension = 0.0, angle_per_tension = 0.0;
  for (int j = 0; j < d.joints; ++j) {
    const double arm = finger.straight_arm_mm[j];
    compliance[j] = arm / finger.strip[j].initial_stiffness();
    pull_per_tension += arm * compliance[j];
    angle_per_tension += compliance[j];
  }
  double tension = target;
  if (control == Control::PulledLength) tension = target / pull_per_tension;
  if (control == Control::Deflection) tension = target / angle_per_tension;
  State x;
  for (int j = 0; j < d.joints; ++j) {
    x.angle_rad[j] = std::min(tension * compliance[j], 0.7 * d.opening_rad[j]);
  }
  x.log_tip_tension = std::log(tension) - (control == Control::Tension ? 1.0 : 0.5);
  return x;
}

}  // namespace softgrip::finger
