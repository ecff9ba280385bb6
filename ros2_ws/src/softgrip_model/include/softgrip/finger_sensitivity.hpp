// SPDX-License-Identifier: Apache-2.0
// Exact derivatives of an equilibrium, by the implicit function theorem on the same arrow that Newton uses.
//
// Rows:    q_0..q_{n-1} [rad], tip x, tip y [mm], actuator tension, tip tension [N], pulled length [mm].
// Columns: the prescribed quantity; h_0..h_{n-1}; r_0..r_{2n-1} [mm]; the friction coefficients; a factor on all
// moduli.
#pragma once

#include <Eigen/LU>

#include "softgrip/finger_equilibrium.hpp"

namespace softgrip::finger {

inline constexpr int kMaxRows = kMaxJoints + 5;
inline constexpr int kMaxColumns = 1 + 3 * kMaxJoints + friction::kMaxCoefficients + 1;

inline int sensitivity_rows(int joints) {
  return joints + 5;
}
inline int sensitivity_columns(int joints, friction::Law law) {
  return 3 * joints + friction::coefficient_count(law) + 2;
}

template <typename Real>
struct TipOf {
  Real x_mm{}, y_mm{};
};
using Tip = TipOf<double>;

// In the base frame: x along the straight finger from joint 0, closing towards -y. `directions` gives the links'
// directions.
template <typename Real, typename Directions>
TipOf<Real> tip_of(const Design& d, const PerJoint<Real>& angle_rad, Directions&& directions) {
  TipOf<Real> tip;
  Real heading{};
  for (int j = 0; j < d.joints; ++j) {
    heading += angle_rad[j];
    const DirectionOf<Real> link = directions(j, heading);
    tip.x_mm += d.link_mm[j] * link.cosine;
    tip.y_mm -= d.link_mm[j] * link.sine;
  }
  return tip;
}

inline Tip tip_of(const Design& d, const PerJoint<double>& angle_rad) {
  return tip_of(d, angle_rad, [](int, double heading) { return Direction(heading); });
}

using Column = std::array<double, kMaxColumns>;

struct Sensitivity {
  std::array<Column, kMaxRows> d{};
  int columns = 0;
  bool finite = true;
};

namespace detail {

// Derivatives of the cable's slope inside link k to the two routing distances that span it.
struct SlopeRouting {
  double to_exit = 0.0, to_entry = 0.0;            // r_{2k-1}, r_{2k}
  double span_to_exit = 0.0, span_to_entry = 0.0;  // of the span's length

  SlopeRouting(const Finger& finger, int k) {
    const Design& d = finger.design;
    if (k == 0) return;
    const double before = 0.5 * d.opening_rad[k - 1];
    if (k == d.joints) {
      span_to_exit = -std::sin(before);
      return;
    }
    const double after = 0.5 * d.opening_rad[k];
    const auto [dx, dy] = finger.link_offset(k);
    const double span = finger.link_span_mm[k];
    to_exit = (dx * std::cos(before) + dy * std::sin(before)) / (span * span);
    to_entry = (-dx * std::cos(after) + dy * std::sin(after)) / (span * span);
    span_to_exit = (-dx * std::sin(before) + dy * std::cos(before)) / span;
    span_to_entry = (-dx * std::sin(after) - dy * std::cos(after)) / span;
  }
};

}  // namespace detail

class SensitivityPass {
 public:
  SensitivityPass(const Finger& finger, const Equilibrium& at, Control control, double target)
      : finger_(finger),
        d_(finger.design),
        n_(d_.joints),
        coefficients_(friction::coefficient_count(finger.friction.model.law)),
        columns_(sensitivity_columns(n_, finger.friction.model.law)) {
    log_slope_ = 1.0;
    friction::Tension tension(finger.friction, at.state.log_tip_tension);
    stretch(std::exp(tension.log), finger.link_span_mm[n_]);
    stretch_span(std::exp(tension.log), n_);
    for (int j = n_ - 1; j >= 0; --j) tension = joint(j, at.state.angle_rad[j], tension);
    close_with(control, target);
    write(at, std::exp(at.state.log_tip_tension), std::exp(tension.log));
  }

  const Sensitivity& result() const { return out_; }

 private:
  int thickness(int j) const { return 1 + j; }
  int routing(int i) const { return 1 + n_ + i; }
  int coefficient(int m) const { return 1 + 3 * n_ + m; }
  int stiffness() const { return 1 + 3 * n_ + coefficients_; }

  friction::Tension joint(int j, double q, const friction::Tension& beyond) {
    const Joint<friction::Slopes::All> g(finger_, j, q, finger_.groove(j, q), beyond);
    const double ra = d_.routing_mm[2 * j], rb = d_.routing_mm[2 * j + 1];
    const GrooveRouting groove(g.groove, ra, rb);
    const detail::SlopeRouting before(finger_, j), after(finger_, j + 1);
    const int a = routing(2 * j), b = routing(2 * j + 1);

    bend(g.exit);
    log_[a] += g.exit.d_phi * groove.direction_a;
    log_[b] += g.exit.d_phi * (groove.direction_b - after.to_exit);
    if (j + 1 < n_) log_[b + 1] -= g.exit.d_phi * after.to_entry;

    Column& angle = angle_[j];
    for (int p = 0; p < columns_; ++p) angle[p] = g.torque * log_[p];
    angle[a] += g.tension * groove.arm_a;
    angle[b] += g.tension * groove.arm_b;
    angle[thickness(j)] -= finger_.strip[j].d_thickness(q);
    angle[stiffness()] -= g.strip.value_Nmm;
    for (int p = 0; p < columns_; ++p) angle[p] /= g.diagonal;
    angle_slope_[j] = g.torque * log_slope_ / g.diagonal;
    turn(g.exit_slope, j);

    for (int p = 0; p < columns_; ++p) pulled_[p] += g.groove.arm_mm * angle[p];
    pulled_slope_ += g.groove.arm_mm * angle_slope_[j];
    const GrooveRouting straight(finger_.groove(j, 0.0), ra, rb);
    pulled_[a] += straight.span_a - groove.span_a;
    pulled_[b] += straight.span_b - groove.span_b;
    stretch(g.tension, g.groove.span_mm);
    const double per_span = g.tension * d_.cable.compliance_per_N;
    for (int p = 0; p < columns_; ++p) pulled_[p] -= per_span * g.groove.arm_mm * angle[p];
    pulled_slope_ -= per_span * g.groove.arm_mm * angle_slope_[j];
    pulled_[a] += per_span * groove.span_a;
    pulled_[b] += per_span * groove.span_b;

    bend(g.entry);
    log_[a] += g.entry.d_phi * (before.to_entry - groove.direction_a);
    log_[b] -= g.entry.d_phi * groove.direction_b;
    if (j > 0) log_[a - 1] += g.entry.d_phi * before.to_exit;
    turn(g.entry_slope, j);
    stretch(std::exp(g.before.log), finger_.link_span_mm[j]);
    stretch_span(std::exp(g.before.log), j);
    return g.before;
  }

  // Past one routing point at constant angles.
  void bend(const PointFriction<friction::Slopes::All>& point) {
    for (int p = 0; p < columns_; ++p) log_[p] *= point.gain();
    log_slope_ *= point.gain();
    for (int m = 0; m < coefficients_; ++m) log_[coefficient(m)] += point.law.d_coefficients[m];
  }

  // What the joint's own turning adds.
  void turn(double slope, int j) {
    for (int p = 0; p < columns_; ++p) log_[p] += slope * angle_[j][p];
    log_slope_ += slope * angle_slope_[j];
  }

  void stretch(double tension, double span_mm) {
    const double extension = tension * span_mm * d_.cable.compliance_per_N;
    if (extension == 0.0) return;
    for (int p = 0; p < columns_; ++p) pulled_[p] += extension * log_[p];
    pulled_slope_ += extension * log_slope_;
  }

  void stretch_span(double tension, int k) {
    const detail::SlopeRouting span(finger_, k);
    const double per_span = tension * d_.cable.compliance_per_N;
    if (k > 0) pulled_[routing(2 * k - 1)] += per_span * span.span_to_exit;
    if (k > 0 && k < n_) pulled_[routing(2 * k)] += per_span * span.span_to_entry;
  }

  void close_with(Control control, double target) {
    Column row{};
    double slope = 0.0, prescribed_slope = 1.0;
    if (control == Control::PulledLength) {
      row = pulled_;
      slope = pulled_slope_;
    } else if (control == Control::Tension) {
      row = log_;
      slope = log_slope_;
      prescribed_slope = 1.0 / target;
    } else {
      for (int j = 0; j < n_; ++j) {
        for (int p = 0; p < columns_; ++p) row[p] += angle_[j][p];
        slope += angle_slope_[j];
      }
    }
    for (int p = 0; p < columns_; ++p) log_tip_[p] = ((p == 0 ? prescribed_slope : 0.0) - row[p]) / slope;
  }

  void write(const Equilibrium& at, double tip_tension, double actuator_tension) {
    out_.columns = columns_;
    double heading = 0.0, x = 0.0, y = 0.0;
    for (int j = 0; j < n_; ++j) {
      heading += at.state.angle_rad[j];
      x += d_.link_mm[j] * std::cos(heading);
      y -= d_.link_mm[j] * std::sin(heading);
    }
    double from_x = 0.0, from_y = 0.0;
    heading = 0.0;
    for (int j = 0; j < n_; ++j) {
      // turning joint j by dq (clockwise) moves the tip by dq (dy, -dx), (dx, dy) = tip - joint
      const double arm_x = x - from_x, arm_y = y - from_y;
      for (int p = 0; p < columns_; ++p) {
        const double angle = angle_[j][p] + angle_slope_[j] * log_tip_[p];
        out_.d[j][p] = angle;
        out_.d[n_][p] += arm_y * angle;
        out_.d[n_ + 1][p] -= arm_x * angle;
      }
      heading += at.state.angle_rad[j];
      from_x += d_.link_mm[j] * std::cos(heading);
      from_y -= d_.link_mm[j] * std::sin(heading);
    }
    for (int p = 0; p < columns_; ++p) {
      out_.d[n_ + 2][p] = actuator_tension * (log_[p] + log_slope_ * log_tip_[p]);
      out_.d[n_ + 3][p] = tip_tension * log_tip_[p];
      out_.d[n_ + 4][p] = pulled_[p] + pulled_slope_ * log_tip_[p];
    }
    for (int row = 0; row < sensitivity_rows(n_); ++row) {
      for (int p = 0; p < columns_; ++p) out_.finite = out_.finite && std::isfinite(out_.d[row][p]);
    }
  }

  const Finger& finger_;
  const Design& d_;
  int n_, coefficients_, columns_;
  Column log_{}, pulled_{}, log_tip_{};  // at constant tip tension; then of the tip tension itself
  double log_slope_ = 0.0, pulled_slope_ = 0.0;
  PerJoint<Column> angle_{};
  PerJoint<double> angle_slope_{};
  Sensitivity out_;
};

// The same of mode F: every number carries its derivatives to the unknowns (q, u, v of each joint, ln T at the tip) and
// to the design; joints up to kJoints.
template <int kJoints>
class FlexureSensitivity {
 public:
  FlexureSensitivity(const Finger& finger, const Equilibrium& at, Control control, double target)
      : finger_(finger),
        n_(finger.design.joints),
        unknowns_(3 * n_ + 1),
        coefficients_(friction::coefficient_count(finger.friction.model.law)) {
    const Design& d = finger.design;
    PerJoint<Real> thickness, q;
    PerPoint<Real> routing;
    PerJoint<std::array<Real, 2>> shift;
    for (int j = 0; j < n_; ++j) {
      thickness[j] = parameter(d.thickness_mm[j], j);
      q[j] = Real::variable(at.state.angle_rad[j], 3 * j);
      for (int i : {0, 1}) shift[j][i] = Real::variable(at.state.shift_mm[j][i], 3 * j + 1 + i);
      for (int i : {2 * j, 2 * j + 1}) routing[i] = parameter(d.routing_mm[i], n_ + i);
    }
    const Real softness = 1.0 / parameter(1.0, 3 * n_ + coefficients_);
    const FlexuresOf<Real> f =
        flexures_of(d, finger.sides, thickness, routing, softness, [this](const ShapeJet& x, int joint, int point) {
          Real lifted(x.value);
          lifted.d[unknowns_ + joint] = x.d[0];
          lifted.d[unknowns_ + n_ + point] = x.d[1];
          return lifted;
        });
    const auto coefficients = [this](Real& log_high, const friction::Evaluation& law) {
      for (int m = 0; m < coefficients_; ++m) log_high.d[unknowns_ + 3 * n_ + m] += law.d_coefficients[m];
    };

    const double give = d.cable.compliance_per_N;
    PerJoint<Real> link_tension;
    const Real log_tip = Real::variable(at.state.log_tip_tension, 3 * n_);
    Real log_beyond = log_tip, pulled = give * (f.link_span_mm[n_] * exp(log_tip));
    for (int j = n_ - 1; j >= 0; --j) {
      const FlexurePass<Real, Real> pass(finger, f, j, q[j], shift[j][0], shift[j][1], log_beyond, coefficients);
      for (int i = 0; i < 3; ++i) residual_[3 * j + i] = pass.residual[i];
      link_tension[j] = exp(log_beyond);
      pulled += pass.taken_mm + give * (pass.span_mm * exp(pass.log_across) + f.link_span_mm[j] * exp(pass.log_before));
      log_beyond = pass.log_before;
    }
    const FlexurePosture<Real, Real> seen(d, f, q, shift, link_tension);
    Real deflection = 0.0;
    for (int j = 0; j < n_; ++j) deflection += row_[j] = seen.angle_rad[j];
    row_[n_] = seen.x_mm;
    row_[n_ + 1] = seen.y_mm;
    row_[n_ + 2] = exp(log_beyond);
    row_[n_ + 3] = exp(log_tip);
    row_[n_ + 4] = pulled;
    const bool by_length = control == Control::PulledLength, by_tension = control == Control::Tension;
    residual_[3 * n_] = by_length ? pulled : by_tension ? log_beyond : deflection;
    solve(by_tension ? 1.0 / target : 1.0);
  }

  const Sensitivity& result() const { return out_; }

 private:
  static constexpr int kUnknowns = 3 * kJoints + 1;
  static constexpr int kParameters = 3 * kJoints + friction::kMaxCoefficients + 1;
  using Real = Jet<kUnknowns + kParameters>;
  template <int rows, int columns>
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, rows, columns>;

  Real parameter(double value, int i) const { return Real::variable(value, unknowns_ + i); }

  // Implicit function theorem; the prescribed quantity is the first column.
  void solve(double control_slope) {
    const int columns = out_.columns = sensitivity_columns(n_, finger_.friction.model.law);
    Matrix<kUnknowns, kUnknowns> slopes(unknowns_, unknowns_);
    Matrix<kUnknowns, kParameters + 1> pushed(unknowns_, columns);
    pushed.setZero();
    pushed(unknowns_ - 1, 0) = control_slope;
    for (int i = 0; i < unknowns_; ++i) {
      for (int k = 0; k < unknowns_; ++k) slopes(i, k) = residual_[i].d[k];
      for (int p = 1; p < columns; ++p) pushed(i, p) = -residual_[i].d[unknowns_ + p - 1];
    }
    const Matrix<kUnknowns, kParameters + 1> moved = slopes.partialPivLu().solve(pushed);
    for (int row = 0; row < sensitivity_rows(n_); ++row) {
      for (int p = 0; p < columns; ++p) {
        double& d = out_.d[row][p];
        d = p == 0 ? 0.0 : row_[row].d[unknowns_ + p - 1];
        for (int k = 0; k < unknowns_; ++k) d += row_[row].d[k] * moved(k, p);
        out_.finite = out_.finite && std::isfinite(d);
      }
    }
  }

  const Finger& finger_;
  int n_, unknowns_, coefficients_;
  std::array<Real, kUnknowns> residual_;
  std::array<Real, kJoints + 5> row_;
  Sensitivity out_;
};

SOFTGRIP_APART inline Sensitivity flexure_sensitivity(const Finger& finger, const Equilibrium& at, Control control,
                                                      double target) {
  if (finger.design.joints <= 3) return FlexureSensitivity<3>(finger, at, control, target).result();
  return FlexureSensitivity<kMaxJoints>(finger, at, control, target).result();
}

// Derivatives of an equilibrium, whatever the joints' model.
inline Sensitivity sensitivity_of(const Finger& finger, const Equilibrium& at, Control control, double target) {
  if (finger.is_flexure()) return flexure_sensitivity(finger, at, control, target);
  return SensitivityPass(finger, at, control, target).result();
}

}  // namespace softgrip::finger
