// SPDX-License-Identifier: Apache-2.0
// Exact derivatives of an equilibrium, by the implicit function theorem on the same arrow that Newton uses.
//
// Rows:    q_0..q_{n-1} [rad], tip x, tip y [mm], actuator tension, tip tension [N], pulled length [mm].
// Columns: the prescribed quantity; h_0..h_{n-1}; r_0..r_{2n-1} [mm]; the friction coefficients; a factor on all moduli.
#pragma once

#include "softgrip/finger_equilibrium.hpp"

namespace softgrip::finger {

inline constexpr int kMaxRows = kMaxJoints + 5;
inline constexpr int kMaxColumns = 1 + 3 * kMaxJoints + friction::kMaxCoefficients + 1;

inline int sensitivity_rows(int joints) { return joints + 5; }
inline int sensitivity_columns(int joints, friction::Law law) {
  return 3 * joints + friction::coefficient_count(law) + 2;
}

template <typename Real>
struct TipOf {
  Real x_mm{}, y_mm{};
};
using Tip = TipOf<double>;

// In the base frame: x along the straight finger from joint 0, closing towards -y. `directions` gives the links' directions.
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
  double to_exit = 0.0, to_entry = 0.0;              // r_{2k-1}, r_{2k}
  double span_to_exit = 0.0, span_to_entry = 0.0;    // of the span's length

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
      : finger_(finger), d_(finger.design), n_(d_.joints),
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
    double slope = 0.0, wanted = 1.0;
    if (control == Control::PulledLength) {
      row = pulled_;
      slope = pulled_slope_;
    } else if (control == Control::Tension) {
      row = log_;
      slope = log_slope_;
      wanted = 1.0 / target;
    } else {
      for (int j = 0; j < n_; ++j) {
        for (int p = 0; p < columns_; ++p) row[p] += angle_[j][p];
        slope += angle_slope_[j];
      }
    }
    for (int p = 0; p < columns_; ++p) log_tip_[p] = ((p == 0 ? wanted : 0.0) - row[p]) / slope;
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

}  // namespace softgrip::finger
