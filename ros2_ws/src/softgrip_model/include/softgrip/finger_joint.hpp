// SPDX-License-Identifier: Apache-2.0
// One joint: the V groove the cable crosses, and the strip that bends. Closed forms with their derivatives.
#pragma once

#include <algorithm>
#include <cmath>

#include "softgrip/finger_design.hpp"
#include "softgrip/lanes.hpp"

namespace softgrip::finger {

// Sine and cosine of an angle.
template <typename Real>
struct DirectionOf {
  Real rad, sine, cosine;
  explicit DirectionOf(const Real& angle) : rad(angle) { sine_cosine(angle, sine, cosine); }
};
using Direction = DirectionOf<double>;

// A turn by so little that short series give its sine and cosine to full precision.
struct SmallTurn {
  static constexpr double kLargest_rad = 1.0 / 32;
  double rad, sine, cosine;

  explicit SmallTurn(double turn) : rad(turn) {
    const double t2 = turn * turn;
    sine = turn * (1.0 + t2 * (-1.0 / 6 + t2 * (1.0 / 120 + t2 * (-1.0 / 5040))));
    cosine = 1.0 + t2 * (-1.0 / 2 + t2 * (1.0 / 24 + t2 * (-1.0 / 720)));
  }

  Direction applied_to(Direction from) const {
    const double s = from.sine * cosine + from.cosine * sine;
    from.cosine = from.cosine * cosine - from.sine * sine;
    from.sine = s;
    from.rad += rad;
    return from;
  }
};

// Directions of one angle after another, each by a small turn from the last one that was worked out in full: a few
// products instead of two library functions.
class Turning {
 public:
  Direction at(double rad) {
    const double turn = rad - kept_.rad;
    if (!(std::abs(turn) < SmallTurn::kLargest_rad)) return kept_ = Direction(rad);
    return SmallTurn(turn).applied_to(kept_);
  }

 private:
  Direction kept_{0.0};
};

// Half the angle w between a groove's flanks as its closed forms need it, with the angle of the span against the
// perpendicular of the groove's bisector: atan((rb - ra) cos / ((ra + rb) sin)).
template <typename Real>
struct HalfAngleOf {
  DirectionOf<Real> half;
  Real lean_rad;

  HalfAngleOf(const Real& half_rad, double ra, double rb)
      : half(half_rad), lean_rad(arctan(Real((rb - ra) * half.cosine), Real((ra + rb) * half.sine))) {}
  HalfAngleOf(const DirectionOf<Real>& direction, const Real& lean) : half(direction), lean_rad(lean) {}
};
using HalfAngle = HalfAngleOf<double>;

// The same for one angle after another. The span's vector (sum sin, difference cos) turns with the half angle.
class TurningHalfAngle {
 public:
  HalfAngle at(double half_rad, double ra, double rb) {
    const double change = half_rad - kept_.half.rad;
    if (!(std::abs(change) < SmallTurn::kLargest_rad)) return kept_ = HalfAngle(half_rad, ra, rb);
    const SmallTurn turn(change);
    const Direction to = turn.applied_to(kept_.half);
    const double sum = ra + rb, difference = rb - ra;
    const double across = -sum * difference * turn.sine;
    const double along =
        sum * sum * kept_.half.sine * to.sine + difference * difference * kept_.half.cosine * to.cosine;
    const double t = across / along, t2 = t * t;
    if (!(std::abs(t) < SmallTurn::kLargest_rad)) return kept_ = HalfAngle(half_rad, ra, rb);
    const double arc = t * (1.0 + t2 * (-1.0 / 3 + t2 * (1.0 / 5 + t2 * (-1.0 / 7 + t2 * (1.0 / 9)))));
    return {to, kept_.lean_rad + arc};
  }

 private:
  HalfAngle kept_{Direction(HUGE_VAL), 0.0};
};

// The same for lanes: each worked out in full, which their functions make cheap.
struct EachHalfAngle {
  template <typename Real>
  HalfAngleOf<Real> at(const Real& half_rad, double ra, double rb) const {
    return {half_rad, ra, rb};
  }
};

// The free span across a groove whose flanks make the angle w = opening - q; ra, rb = distance of entry and exit from
// the apex. From the triangle apex-entry-exit: law of cosines for the span, law of tangents for its direction.
template <typename Real>
struct GrooveOf {
  Real span_mm;        // c
  Real arm_mm;         // -dc/dq = ra rb sin w / c
  Real d_arm;          // d arm / dq
  Real direction_rad;  // of the span in the proximal link's frame
  Real d_direction;    // d / dq
  Real sin_w, cos_w;

  GrooveOf(double opening_rad, const Real& q, double ra, double rb)
      : GrooveOf(HalfAngleOf<Real>(0.5 * (opening_rad - q), ra, rb), q, ra, rb) {}

  GrooveOf(const HalfAngleOf<Real>& w, const Real& q, double ra, double rb) {
    const Real sum_s = (ra + rb) * w.half.sine, difference_c = (rb - ra) * w.half.cosine;
    sin_w = 2.0 * w.half.sine * w.half.cosine;
    cos_w = 1.0 - 2.0 * w.half.sine * w.half.sine;
    span_mm = sqrt(Real(sum_s * sum_s + difference_c * difference_c));
    const Real per_span = 1.0 / span_mm;
    arm_mm = ra * rb * sin_w * per_span;
    d_arm = (arm_mm * arm_mm - ra * rb * cos_w) * per_span;
    direction_rad = -0.5 * q - w.lean_rad;
    d_direction = -0.5 - 0.5 * (rb * rb - ra * ra) * per_span * per_span;
  }
};

using Groove = GrooveOf<double>;

// Derivatives of a groove's quantities to the two routing distances.
struct GrooveRouting {
  double span_a, span_b, arm_a, arm_b, direction_a, direction_b;

  GrooveRouting(const Groove& g, double ra, double rb) {
    const double per_span = 1.0 / g.span_mm;
    span_a = (ra - rb * g.cos_w) * per_span;
    span_b = (rb - ra * g.cos_w) * per_span;
    arm_a = (rb * g.sin_w - g.arm_mm * span_a) * per_span;
    arm_b = (ra * g.sin_w - g.arm_mm * span_b) * per_span;
    direction_a = rb * g.sin_w * per_span * per_span;
    direction_b = -ra * g.sin_w * per_span * per_span;
  }
};

template <typename Real>
struct MomentOf {
  Real value_Nmm{};
  Real d_angle{};
};
using Moment = MomentOf<double>;

// Bending moment of a strip, curvature k = q/l, half thickness H. The laws that are polynomials in q are
// M = m1 q + m2 q|q| + m3 q^3; the neutral-axis law solves a cubic for the shift of the axis.
class Strip {
 public:
  Strip() = default;
  Strip(const Material& material, double width, double thickness, double length)
      : material_(material), width_(width), half_(0.5 * thickness), length_(length), strain_per_angle_(half_ / length) {
    const double h3 = half_ * half_ * half_;
    linear_ = 2.0 * width * material.constant_MPa * h3 / (3.0 * length);
    if (material.law != MomentLaw::Linear) {
      cubic_ = 2.0 * width * material.quadratic_MPa * h3 * half_ * half_ / (15.0 * length * length * length);
    }
    if (material.law == MomentLaw::SignedSecant) cubic_ *= 3.0;
    if (material.law == MomentLaw::AbsoluteTangent) {
      quadratic_ = 2.0 * width * material.linear_MPa * h3 * half_ / (8.0 * length * length);
    }
  }

  double initial_stiffness() const { return linear_; }

  template <typename Real>
  Real surface_strain(const Real& q) const {
    return abs(q) * strain_per_angle_;
  }

  template <typename Real>
  MomentOf<Real> at(const Real& q) const {
    if (material_.law == MomentLaw::NeutralAxis) return neutral_axis(q);
    const Real size = abs(q);
    return {q * (linear_ + size * (quadratic_ + size * cubic_)),
            linear_ + size * (2.0 * quadratic_ + size * 3.0 * cubic_)};
  }

  // dM/dh. The polynomial's terms grow as h^3, h^4, h^5; the neutral-axis moment is H^2 times a function of q H.
  double d_thickness(double q) const {
    const double size = std::abs(q);
    if (material_.law == MomentLaw::NeutralAxis) {
      const Moment moment = neutral_axis(q);
      return 0.5 * (2.0 * moment.value_Nmm + q * moment.d_angle) / half_;
    }
    return 0.5 * q * (3.0 * linear_ + size * (4.0 * quadratic_ + size * 5.0 * cubic_)) / half_;
  }

 private:
  // Stress s(e) = a e^3/3 + b e^2/2 + c e with e = t - shift, t = k y in [-x, x], x = k H. No axial force gives
  // (a/3) shift^3 - (b/2) shift^2 + (c + a x^2/3) shift - b x^2/6 = 0; its slope is E(-shift) + a x^2/3 > 0.
  template <typename Real>
  MomentOf<Real> neutral_axis(const Real& q) const {
    const double a = material_.quadratic_MPa, b = material_.linear_MPa, c = material_.constant_MPa;
    const Real k = q / length_, x = k * half_, x2 = x * x;
    Real shift = b * x2 / (6.0 * (c + a * x2 / 3.0));
    Real slope = Real{} + c;
    for (int i = 0; i < 20; ++i) {
      const Real value = ((a / 3.0 * shift - b / 2.0) * shift + c + a * x2 / 3.0) * shift - b * x2 / 6.0;
      slope = (a * shift - b) * shift + c + a * x2 / 3.0;
      const Real step = value / slope;
      shift -= step;
      if (all(abs(step) < 1e-15)) break;
    }
    const Real d_shift = (b / 3.0 * x - 2.0 * a / 3.0 * x * shift) / slope;  // d shift / dx
    const double factor = width_ * half_ * half_;                            // w/k^2 x^3 = w H^2 x
    const Real bracket = 2.0 * a * x2 / 15.0 + 2.0 / 3.0 * (a * shift - b) * shift + 2.0 / 3.0 * c;
    const Real d_bracket = 4.0 * a * x / 15.0 + 2.0 / 3.0 * (2.0 * a * shift - b) * d_shift;
    return {factor * x * bracket, factor * (bracket + x * d_bracket) * half_ / length_};
  }

  Material material_;
  double width_ = 0.0, half_ = 0.0, length_ = 1.0, strain_per_angle_ = 0.0;
  double linear_ = 0.0, quadratic_ = 0.0, cubic_ = 0.0;
};

// Moment of the groove's stop: smooth (twice) where it starts, infinite where the flanks meet.
template <typename Real>
inline MomentOf<Real> stop_moment(const Stop& stop, double opening_rad, const Real& q) {
  const Real beyond = q - opening_rad + stop.margin_rad;
  if (stop.moment_Nmm == 0.0 || all(beyond <= 0.0)) return {};
  const Real z = larger(Real{}, beyond) / stop.margin_rad;
  const Real per_gap = 1.0 / (1.0 - z);
  const Real value = stop.moment_Nmm * z * z * z * per_gap;
  return {value, stop.moment_Nmm * z * z * (3.0 - 2.0 * z) * per_gap * per_gap / stop.margin_rad};
}

}  // namespace softgrip::finger
