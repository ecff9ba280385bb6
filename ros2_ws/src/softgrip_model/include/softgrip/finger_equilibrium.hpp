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
#include <type_traits>

#include "softgrip/finger_flexure.hpp"
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
  PerJoint<std::array<Real, 2>> shift_mm{};  // (u, v) of mode F
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
  std::array<double, kMaxJoints + 1> slope_rad{};     // of the cable inside link k-1; 0 before joint 0 and at the tip
  std::array<double, kMaxJoints + 1> link_span_mm{};  // cable inside link k-1
  double reach_mm = 0.0;                              // pulled length with all grooves shut; in mode F a bound of it
  FlexureSides sides;                                 // mode F alone, like the next two
  FlexuresOf<double> flexure;
  PerJoint<std::array<double, 3>> response_per_N{};  // of (q, u, v) of the straight finger
  std::uint32_t remarks = kOk;                       // on the design, for every one of its states

  bool is_flexure() const { return design.joint_model == JointModel::Flexure; }

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
    if (is_flexure()) prepare_flexures();
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

  // What bends the strip of a mode F joint: its material's law, stiffer for being held across.
  template <typename Real, typename Shape>
  Real strip_moment(const FlexuresOf<Shape>& f, int j, const Real& bend) const {
    const double stiffer = design.study.strip * held_across(design, j), angle = value_of(bend);
    const Moment moment = strip[j].at(angle);
    const Real of_angle = bend.through(stiffer * moment.value_Nmm, stiffer * moment.d_angle);
    if constexpr (std::is_same_v<Shape, double>) {
      return of_angle / f.softness;
    } else {
      return (of_angle + f.thickness_mm[j].through(0.0, stiffer * strip[j].d_thickness(angle))) / f.softness;
    }
  }

 private:
  SOFTGRIP_APART void prepare_flexures() {
    if (!within(FlexureRange{}, design)) remarks |= kFlexureOutside;
    // a span can vanish where its strip gives; links shorten by less than this
    constexpr double kMaxShortening = 0.1;
    reach_mm = 0.0;
    for (int j = 0; j < design.joints; ++j) reach_mm += straight_span_mm[j] + kMaxShortening * design.link_mm[j];
    sides = FlexureSides(design);
    flexure = flexures_of(design, sides, design.thickness_mm, design.routing_mm, 1.0,
                          [](const ShapeJet& x, int, int) { return x.value; });
    for (int j = 0; j < design.joints; ++j) {
      using Local = Jet<4>;  // to q, u, v and the tension
      FlexureState<Local, double> at(flexure.joint[j], Local::variable(0.0, 0), Local::variable(0.0, 1),
                                     Local::variable(0.0, 2));
      at.load(
          Local::variable(0.0, 3), [&](const Local& bend) { return strip_moment(flexure, j, bend); }, Local(0.0),
          NoObject{});
      std::array<double, 3> push;
      for (int i = 0; i < 3; ++i) push[i] = -at.residual[i].d[3];
      response_per_N[j] = solved(at.residual, push);
    }
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

// Adds what friction's coefficients change to ln Rf; nothing where nobody asks for it.
struct NoCoefficients {
  template <typename Real>
  void operator()(Real&, const friction::Evaluation&) const {}
};

// Mode F: past the link behind joint j and the joint, from the tension beyond them to the one before.
template <typename Real, typename Shape>
struct FlexurePass {
  std::array<Real, 3> residual;
  Real log_across, log_before;
  Real phi_entry, phi_exit, strip_bend_rad;
  Real span_mm, taken_mm, link_turn_rad;  // taken: by the joint's groove and by the link that becomes shorter; turn: up
                                          // to the middle of the last link
  std::uint8_t friction_status = 0;

  template <typename Coefficients>
  FlexurePass(const Finger& finger, const FlexuresOf<Shape>& f, int j, const Real& q, const Real& u, const Real& v,
              const Real& log_beyond, const Coefficients& coefficients) {
    const Design& d = finger.design;
    const Real link_tension = exp(log_beyond);
    const LinkEndOf<Shape>&exit = f.exit_end[j], &entry = f.entry_end[j];
    FlexureState<Real, Shape> joint(f.joint[j], q, u, v);
    // bends of the cable against links whose ends have turned
    phi_exit = f.exit_bend(j, joint.direction_rad, q, link_tension);
    log_across = past(finger, phi_exit, log_beyond, coefficients);
    const Real tension = exp(log_across);
    phi_entry = f.entry_bend(j, joint.direction_rad, tension);
    log_before = past(finger, phi_entry, log_across, coefficients);

    const Moment stop = stop_moment(d.stop, d.opening_rad[j], value_of(q));
    joint.load(
        tension, [&](const Real& bend) { return finger.strip_moment(f, j, bend); },
        q.through(stop.value_Nmm, stop.d_angle), NoObject{});
    residual = joint.residual;
    strip_bend_rad = joint.bend_rad;
    span_mm = joint.span_mm;
    taken_mm = f.straight_span_mm[j] - span_mm + f.link_shortening(j) * link_tension;
    link_turn_rad = (j + 1 < d.joints ? exit.turn + entry.turn : exit.turn) * link_tension;
  }

 private:
  template <typename Coefficients>
  Real past(const Finger& finger, const Real& phi, const Real& log_low, const Coefficients& coefficients) {
    const PointFriction<friction::Slopes::All> point(finger, value_of(phi), {finger.friction, value_of(log_low)});
    friction_status |= point.law.status;
    Real high = phi.through(value_of(log_low) + point.law.log_ratio, point.d_phi) + log_low.through(0.0, point.gain());
    coefficients(high, point.law);
    return high;
  }
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
  PerJoint<std::array<Linear<Real>, 2>> shift_mm;  // mode F
  PerJoint<Linear<Real>> taken_mm;                 // cable that each joint takes in
  PerPoint<Linear<Real>> phi_rad;
  PerJoint<Linear<Real>> strip_bend_rad;
  Linear<Real> pulled_mm{};
  Linear<Real> link_turn_rad{};  // of all links together, up to the middle of the last
  Real log_tip_step;
  std::uint8_t friction_status = 0;

  // `prescribed`: the prescribed quantity; of a tension its ln.
  template <typename HalfAngles>
  SweepOf(const Finger& finger, const StateOf<Real>& x, Control control, const Real& prescribed,
          PerJoint<HalfAngles>& half_angles) {
    const Design& d = finger.design;
    const int n = d.joints;
    Linear<Real> along{x.log_tip_tension, Real{}, Real{} + 1.0};
    friction::TensionOf<Real> beyond(finger.friction, x.log_tip_tension);
    log_tension[2 * n] = along;
    stretch(d, along, Real{} + finger.link_span_mm[n]);
    for (int j = n - 1; j >= 0; --j) {
      if constexpr (kLanes<Real> == 1) {
        if (finger.is_flexure()) {
          flexure(finger, j, x, along, beyond);
          continue;
        }
      }
      hinge(finger, j, x.angle_rad[j], along, beyond, half_angles[j]);
    }
    const Linear<Real> row = controlled(control, n);
    log_tip_step = (prescribed - row.value - row.constant) / row.slope;
  }

  // What `prescribed` is compared with.
  Linear<Real> controlled(Control control, int n) const {
    if (control == Control::PulledLength) return pulled_mm;
    if (control == Control::Tension) return log_tension[0];
    Linear<Real> sum{};
    for (int j = 0; j < n; ++j) sum.add(angle_rad[j].value, angle_rad[j].constant, angle_rad[j].slope);
    sum.add(link_turn_rad.value, link_turn_rad.constant, link_turn_rad.slope);
    return sum;
  }

 private:
  // Mode P: past one joint, whose angle is its only unknown.
  template <typename HalfAngles>
  void hinge(const Finger& finger, int j, const Real& q, Linear<Real>& along, friction::TensionOf<Real>& beyond,
             HalfAngles& half_angles) {
    const Design& d = finger.design;
    const Joint<friction::Slopes::State, Real> joint(finger, j, q, finger.groove(j, q, half_angles), beyond);
    beyond = joint.before;
    const Real gain = joint.torque * joint.exit.gain();
    const Real per_diagonal = 1.0 / joint.diagonal;
    const Real constant = (gain * along.constant - joint.residual()) * per_diagonal;
    const Real slope = gain * along.slope * per_diagonal;
    angle_rad[j] = {q, constant, slope};

    along = through(along, joint.exit, joint.exit_slope, angle_rad[j]);
    log_tension[2 * j + 1] = along;
    taken_mm[j] = {finger.straight_span_mm[j] - joint.groove.span_mm, joint.groove.arm_mm * constant,
                   joint.groove.arm_mm * slope};
    pulled_mm.add(taken_mm[j].value, taken_mm[j].constant, taken_mm[j].slope);
    if (d.cable.compliance_per_N > 0.0) {
      stretch(d, along, joint.groove.span_mm);
      const Real shorter = joint.torque * d.cable.compliance_per_N;
      pulled_mm.add(Real{}, -shorter * constant, -shorter * slope);
    }
    along = through(along, joint.entry, joint.entry_slope, angle_rad[j]);
    log_tension[2 * j] = along;
    stretch(d, along, Real{} + finger.link_span_mm[j]);

    const Real entry_turn = -joint.groove.d_direction, exit_turn = joint.groove.d_direction + 1.0;
    phi_rad[2 * j] = {joint.phi_entry, entry_turn * constant, entry_turn * slope};
    phi_rad[2 * j + 1] = {joint.phi_exit, exit_turn * constant, exit_turn * slope};
    strip_bend_rad[j] = angle_rad[j];
    friction_status |= joint.exit.law.status | joint.entry.law.status;
  }

  // Mode F: past the link behind a joint and the joint, whose unknowns are its turn and the shift of the frame beyond
  // it.
  SOFTGRIP_APART void flexure(const Finger& finger, int j, const State& x, Linear<double>& along,
                              friction::Tension& beyond) {
    using Local = Jet<4>;  // to q, u, v and ln of the tension beyond
    const Design& d = finger.design;
    const FlexuresOf<double>& f = finger.flexure;
    const Local log_beyond = Local::variable(along.value, 3);
    const Local q = Local::variable(x.angle_rad[j], 0);
    const FlexurePass<Local, double> pass(finger, f, j, q, Local::variable(x.shift_mm[j][0], 1),
                                          Local::variable(x.shift_mm[j][1], 2), log_beyond, NoCoefficients{});
    std::array<double, 3> back, push;
    for (int i = 0; i < 3; ++i) {
      back[i] = -pass.residual[i].value - pass.residual[i].d[3] * along.constant;
      push[i] = -pass.residual[i].d[3] * along.slope;
    }
    const auto constant = solved(pass.residual, back), slope = solved(pass.residual, push);
    const Linear<double> tension = along;
    auto linear = [&](const Local& y) {
      Linear<double> out{y.value, y.d[3] * tension.constant, y.d[3] * tension.slope};
      for (int i = 0; i < 3; ++i) out.add(0.0, y.d[i] * constant[i], y.d[i] * slope[i]);
      return out;
    };
    angle_rad[j] = {x.angle_rad[j], constant[0], slope[0]};
    for (int i : {0, 1}) shift_mm[j][i] = {x.shift_mm[j][i], constant[i + 1], slope[i + 1]};
    const Linear<double> taken = linear(pass.taken_mm), turned = linear(pass.link_turn_rad);
    taken_mm[j] = taken;
    pulled_mm.add(taken.value, taken.constant, taken.slope);
    link_turn_rad.add(turned.value, turned.constant, turned.slope);
    along = log_tension[2 * j + 1] = linear(pass.log_across);
    stretch(d, along, pass.span_mm.value);
    along = log_tension[2 * j] = linear(pass.log_before);
    stretch(d, along, finger.link_span_mm[j]);
    beyond = friction::Tension(finger.friction, along.value);
    phi_rad[2 * j] = linear(pass.phi_entry);
    phi_rad[2 * j + 1] = linear(pass.phi_exit);
    strip_bend_rad[j] = linear(pass.strip_bend_rad);
    friction_status |= pass.friction_status;
  }

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
  out.status = where(Real{} == Real{}, finger.remarks);
  out.state.log_tip_tension = sweep.log_tension[2 * d.joints].value + ds;
  out.pulled_mm = sweep.pulled_mm.after(ds);
  for (int i = 0; i <= 2 * d.joints; ++i) out.log_tension[i] = sweep.log_tension[i].after(ds);
  Real taken{};
  const Real per_pull = 1.0 / sweep.pulled_mm.slope;
  for (int j = d.joints - 1; j >= 0; --j) {
    const Real q = sweep.angle_rad[j].after(ds);
    out.state.angle_rad[j] = q;
    if (finger.is_flexure()) {
      for (int i : {0, 1}) out.state.shift_mm[j][i] = sweep.shift_mm[j][i].after(ds);
    }
    for (int i : {2 * j, 2 * j + 1}) {
      out.phi_rad[i] = sweep.phi_rad[i].after(ds);
      out.status |= range_flags(finger, out.phi_rad[i], out.log_tension[i + 1]);
    }
    taken += sweep.taken_mm[j].slope;
    out.pull_rate[j] = taken * per_pull;
    out.status |= where(out.pull_rate[j] < -1e-9, kReversing);
    if (d.stop.moment_Nmm > 0.0) out.status |= where(q > d.opening_rad[j] - d.stop.margin_rad, kStopEngaged);
    out.status |= where(finger.strip[j].surface_strain(sweep.strip_bend_rad[j].after(ds)) > d.material.max_strain,
                        kStrainOutside);
  }
}

// What is seen of an equilibrium of mode F.
SOFTGRIP_APART inline FlexurePosture<double, double> posture_of(const Finger& finger, const Equilibrium& found) {
  PerJoint<double> tension{};
  for (int j = 0; j < finger.design.joints; ++j) tension[j] = std::exp(found.log_tension[2 * j + 2]);
  return {finger.design, finger.flexure, found.state.angle_rad, found.state.shift_mm, tension};
}

// A cable that pulls turns a joint its way: an angle against it belongs to a branch on which the cable has passed the
// apex, and that no closing reaches. A strip that its roots press askew may start a little below zero.
template <typename Real>
inline MaskOf<Real> on_wrong_branch(const Finger& finger, const Real& q) {
  constexpr double kRootTurn_rad = 0.05, kRounding_rad = 1e-9;
  return q < -(finger.is_flexure() ? kRootTurn_rad : kRounding_rad);
}

// Newton stops once a step is so small that, converging quadratically, the next would be rounding.
inline constexpr double kSmallestStep = 1e-6;

// Newton from a start.
inline void newton(const Finger& finger, State x, Control control, double target, PerJoint<TurningHalfAngle>& turning,
                   Equilibrium& out) {
  constexpr double kLargestAngleStep = 0.25, kLargestLogStep = 1.0;
  constexpr int kMaxIterations = 60;
  const int n = finger.design.joints;
  const double prescribed = control == Control::Tension ? std::log(target) : target;
  out.status = kNotConverged;
  for (out.iterations = 1; out.iterations <= kMaxIterations; ++out.iterations) {
    const Sweep sweep(finger, x, control, prescribed, turning);
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
      const double taken = std::clamp(full, -kLargestAngleStep, std::min(kLargestAngleStep, room));
      x.angle_rad[j] += taken;
      if (!finger.is_flexure()) continue;
      const double share = full == taken ? 1.0 : taken / full;
      for (int i : {0, 1}) {
        const double shift = sweep.shift_mm[j][i].constant + sweep.shift_mm[j][i].slope * ds;
        largest = std::max(largest, std::abs(shift) / finger.design.length_mm[j]);
        x.shift_mm[j][i] += share * shift;
      }
    }
    if (!finite) return;
    if (largest < kSmallestStep) {
      for (int j = 0; j < n; ++j) {
        if (on_wrong_branch(finger, x.angle_rad[j])) return;
      }
      accept(finger, sweep, out);
      return;
    }
  }
}

// Newton for lanes from good starts. Where a start is so poor that Newton needs damping, or a lane has no value, it
// gives up (false): those targets are better looked at one by one.
template <typename Real>
inline bool newton_lanes(const Finger& finger, StateOf<Real> x, Control control, const Real& prescribed,
                         EquilibriumOf<Real>& out) {
  constexpr double kLargestStep = 0.1;
  constexpr int kMaxIterations = 4;
  PerJoint<EachHalfAngle> half_angles;
  for (out.iterations = 1; out.iterations <= kMaxIterations; ++out.iterations) {
    const SweepOf<Real> sweep(finger, x, control, prescribed, half_angles);
    const Real& ds = sweep.log_tip_step;
    Real largest = abs(ds);
    MaskOf<Real> open = largest < kLargestStep, wrong = Real{} != Real{};
    x.log_tip_tension += ds;
    for (int j = 0; j < finger.design.joints; ++j) {
      const Real step = sweep.angle_rad[j].constant + sweep.angle_rad[j].slope * ds;
      x.angle_rad[j] += step;
      open &= (abs(step) < kLargestStep) & (x.angle_rad[j] < finger.design.opening_rad[j]);
      wrong |= on_wrong_branch(finger, x.angle_rad[j]);
      largest = larger(largest, abs(step));
    }
    if (!all(open)) return false;
    if (all(largest < kSmallestStep)) {
      if (any(wrong)) return false;
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
    compliance[j] = finger.is_flexure() ? finger.response_per_N[j][0] : arm / finger.strip[j].initial_stiffness();
    pull_per_tension += arm * compliance[j];
    angle_per_tension += compliance[j];
  }
  double tension = target;
  if (control == Control::PulledLength) tension = target / pull_per_tension;
  if (control == Control::Deflection) tension = target / angle_per_tension;
  State x;
  for (int j = 0; j < d.joints; ++j) {
    x.angle_rad[j] = std::min(tension * compliance[j], 0.7 * d.opening_rad[j]);
    for (int i : {0, 1}) x.shift_mm[j][i] = x.angle_rad[j] / compliance[j] * finger.response_per_N[j][i + 1];
  }
  x.log_tip_tension = std::log(tension) - (control == Control::Tension ? 1.0 : 0.5);
  return x;
}

}  // namespace softgrip::finger
