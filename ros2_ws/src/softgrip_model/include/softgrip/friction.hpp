// SPDX-License-Identifier: Apache-2.0
// How a cable slides over a printed surface: Rf = T1/T2 in closed form, with exact derivatives.
//
// T2 is the low (holding) tension [N], T1 >= T2 the high (pulling) tension, theta the wrap angle [rad], r = r_cable +
// r_surface [mm]. Source: C.-D. Matte, "Toward Predictable Tendon Driven Soft Robots" (2025), Eqs 3.7-3.9;
// docs/friction.md settles its ambiguities.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "softgrip/lanes.hpp"

namespace softgrip::friction {

// Eq 3.7, Eq 3.8, Eq 3.9.
enum class Law : std::uint8_t { Capstan = 0, Heap = 1, Matte = 2 };

// Reading of K in Eq 3.8. Printed: K = -x, as the thesis prints it. Limit: K -> 0. Exact: K = +x, the integral of
// dT/dtheta = alpha r^(1-n) T^n started from the low tension. x = alpha (1-n) (r/T2)^(1-n) theta.
enum class KReading : std::uint8_t { Printed = 0, Limit = 1, Exact = 2 };

// What to know about a value, as bits. A value with kBlowUp or kInvalid is NaN; with any other bit it is finite.
enum Status : std::uint8_t {
  kOk = 0,
  kAngleOutsideRange = 1,    // outside the calibrated angles
  kTensionOutsideRange = 2,  // outside the calibrated tensions
  kTensionFloored = 4,       // T2 below kTensionFloor_N: evaluated at the floor
  kSurfaceClamped = 8,       // epsilon - lambda ln T2 < 0: counted as 0, friction cannot push
  kBlowUp = 16,              // x >= 1 with the printed K: the law has no value at this angle
  kInvalid = 32,             // not finite, negative angle, n outside (0,1), r <= 0
};

// Below this tension (r/T2)^(1-n) leaves what any cable was measured at; finger.md fixes it.
inline constexpr double kTensionFloor_N = 1e-2;
inline constexpr double kLogTensionFloor = -4.605170185988091;

struct Range {
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
  template <typename Real>
  MaskOf<Real> holds(const Real& value) const {
    return (value >= low) & (value <= high);
  }
};

// Coefficients by law. Capstan: {mu}. Heap: {alpha, n}. Matte: {alpha, n, epsilon, lambda}; lambda as it stands in
// Eq 3.9 (minus sign), so lambda > 0 lets friction fall with tension. alpha [(N/mm)^(1-n)], the others [1].
inline constexpr int kMaxCoefficients = 4;
using Coefficients = std::array<double, kMaxCoefficients>;

constexpr int coefficient_count(Law law) {
  return law == Law::Capstan ? 1 : law == Law::Heap ? 2 : 4;
}

struct Model {
  Law law = Law::Matte;
  KReading k_reading = KReading::Printed;
  Coefficients coefficients{};
  double radius_mm = 0.0;
  Range angle_rad;  // calibrated
  Range tension_N;  // calibrated, of T2
};

// Lanes have no status: one without a value is NaN or infinite.
template <typename Real>
struct EvaluationOf {
  Real log_ratio;               // ln Rf
  Real d_angle;                 // d ln Rf / d theta [1/rad]
  Real d_log_tension;           // d ln Rf / d ln T2
  Coefficients d_coefficients;  // d ln Rf / d coefficient, zero where the law has none
  std::uint8_t status;
  Real power_ratio = Real{} + 1.0;  // Rf^-(1-n); takes (r/T)^(1-n) past the bend

  double ratio() const { return std::exp(log_ratio); }
  bool has_value() const { return (status & (kBlowUp | kInvalid)) == 0; }
};
using Evaluation = EvaluationOf<double>;

// ln(1+K)/K to full precision, regular at K = 0: the rounding of 1+K cancels (Kahan), and log is quicker than log1p.
inline double log1p_over(double k) {
  const double rounded = 1.0 + k;
  return rounded == 1.0 ? 1.0 - 0.5 * k
                        : std::log(rounded) * (1.0 / (rounded - 1.0));  // both at once, unlike a quotient
}

template <typename Real>
inline Real log1p_over(Real k) {
  for (int i = 0; i < kLanes<Real>; ++i) k[i] = log1p_over(k[i]);
  return k;
}

// Bends have small K and small surface terms; for these, short series are as exact as the library's functions and
// quicker.
inline constexpr double kSmall = 0.125;

// log1p_over by 2/(2+K) (1 + z/3 + z^2/5 + ...), z = (K/(2+K))^2.
template <typename Real>
inline Real quick_log1p_over(const Real& k) {
  if (!all(abs(k) < kSmall)) return log1p_over(k);
  const Real per_sum = 1.0 / (2.0 + k), s = k * per_sum, z = s * s, z2 = z * z;
  const Real far = 1.0 / 9 + z * (1.0 / 11) + z2 * (1.0 / 13);
  return 2.0 * per_sum * (1.0 + z * (1.0 / 3) + z2 * (1.0 / 5 + z * (1.0 / 7) + z2 * far));
}

template <typename Real>
inline Real quick_exp(const Real& x) {
  if (!all(abs(x) < kSmall)) return exp(x);
  const Real x2 = x * x, x4 = x2 * x2;
  const Real low = 1.0 + x + x2 * (1.0 / 2 + x * (1.0 / 6));
  const Real middle = 1.0 / 24 + x * (1.0 / 120) + x2 * (1.0 / 720 + x * (1.0 / 5040));
  const Real high = 1.0 / 40320 + x * (1.0 / 362880) + x2 * (1.0 / 3628800);
  return low + x4 * (middle + x4 * high);
}

// d/dK of ln(1+K)/K; the series where the difference quotient would lose digits.
inline double log1p_over_slope(double k) {
  if (std::abs(k) < 1e-3) {
    return -1.0 / 2 + k * (2.0 / 3 + k * (-3.0 / 4 + k * (4.0 / 5 + k * (-5.0 / 6))));
  }
  return (1.0 / (1.0 + k) - std::log1p(k) / k) / k;
}

inline double k_sign(KReading reading) {
  return reading == KReading::Printed ? -1.0 : reading == KReading::Exact ? 1.0 : 0.0;
}

// Wrap angle [rad] at which the printed form stops having a value (x = 1); infinite for the other readings and Capstan.
inline double blow_up_angle(const Model& model, double tension_N) {
  if (model.law == Law::Capstan || model.k_reading != KReading::Printed) return std::numeric_limits<double>::infinity();
  const double m = 1.0 - model.coefficients[1];
  const double slope = model.coefficients[0] * m * std::pow(model.radius_mm / std::fmax(tension_N, kTensionFloor_N), m);
  return slope > 0.0 ? 1.0 / slope : std::numeric_limits<double>::infinity();
}

namespace detail {

inline Evaluation no_value(std::uint8_t status) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  return {nan, nan, nan, {nan, nan, nan, nan}, status};
}

inline bool sound(const Model& model) {
  for (int i = 0; i < coefficient_count(model.law); ++i) {
    if (!std::isfinite(model.coefficients[i])) return false;
  }
  const double n = model.coefficients[1];
  return model.law == Law::Capstan || (n > 0.0 && n < 1.0 && model.radius_mm > 0.0);
}

}  // namespace detail

// A model as kernels evaluate it many times: what does not change is worked out once.
struct Prepared {
  Model model;
  double log_radius;
  double exponent;  // 1-n; 0 for Capstan, which knows no tension
  bool sound;

  explicit Prepared(const Model& m)
      : model(m),
        log_radius(std::log(m.radius_mm)),
        exponent(m.law == Law::Capstan ? 0.0 : 1.0 - m.coefficients[1]),
        sound(detail::sound(m)) {}
};

// A tension as kernels carry it past one bend after another: ln T and (r/T)^(1-n), each led on without the other, so
// that the logarithm and the exponential of a bend are worked out side by side.
template <typename Real>
struct TensionOf {
  Real log;
  Real power;

  TensionOf(const Prepared& prepared, const Real& log_tension)
      : log(log_tension), power(exp(prepared.exponent * (prepared.log_radius - log_tension))) {}

  TensionOf before(const EvaluationOf<Real>& bend) const { return {log + bend.log_ratio, power * bend.power_ratio}; }

 private:
  TensionOf(const Real& log_tension, const Real& slackness) : log(log_tension), power(slackness) {}
};
using Tension = TensionOf<double>;

// Which derivatives an evaluation fills in; the coefficients' cost a second logarithm.
enum class Slopes { State, All };

namespace detail {

// Eq 3.8 as mu_e theta = G ln(1+K)/K, with G = alpha (r/T2)^m theta, K = sign m G, m = 1-n.
template <Slopes slopes, typename Real>
inline bool add_cable_term(const Prepared& prepared, const Real& angle_rad, const TensionOf<Real>& low,
                           EvaluationOf<Real>& out) {
  const Model& model = prepared.model;
  const double alpha = model.coefficients[0], m = prepared.exponent;
  const Real g = alpha * low.power * angle_rad;
  const double sign = k_sign(model.k_reading);
  const Real k = sign * m * g;
  if constexpr (kLanes<Real> == 1) {
    if (k <= -1.0) return false;
  }
  const Real gain = 1.0 / (1.0 + k);
  out.log_ratio = g * (slopes == Slopes::State ? quick_log1p_over(k) : log1p_over(k));
  out.d_angle = alpha * low.power * gain;
  out.d_log_tension = -m * g * gain;
  out.power_ratio = sign < 0.0 ? 1.0 + k : sign > 0.0 ? gain : exp(-m * g);
  if constexpr (slopes == Slopes::All) {
    const double log_radius_over_tension = prepared.log_radius - low.log;
    out.d_coefficients[0] = low.power * angle_rad * gain;
    out.d_coefficients[1] = -(g * log_radius_over_tension * gain + sign * g * g * log1p_over_slope(k));
  }
  return true;
}

// The term that Eq 3.9 adds: max(0, epsilon - lambda ln T2).
template <typename Real>
inline void add_surface_term(const Prepared& prepared, const Real& log_tension, EvaluationOf<Real>& out) {
  const double lambda = prepared.model.coefficients[3];
  Real surface = prepared.model.coefficients[2] - lambda * log_tension;
  if constexpr (kLanes<Real> == 1) {
    if (surface < 0.0) {
      out.status |= kSurfaceClamped;
      return;
    }
    out.d_log_tension -= lambda;
    out.d_coefficients[2] = 1.0;
    out.d_coefficients[3] = -log_tension;
  } else {
    out.d_log_tension -= surface < 0.0 ? Real{} : Real{} + lambda;
    surface = larger(Real{}, surface);
  }
  out.log_ratio += surface;
  out.power_ratio *= quick_exp(-prepared.exponent * surface);
}

}  // namespace detail

// ln Rf and its slopes in lanes; below the tension's floor a lane is NaN, so that it is looked at alone.
template <typename Real>
inline EvaluationOf<Real> lanes_at(const Prepared& prepared, const Real& angle_rad, const TensionOf<Real>& low) {
  const Model& model = prepared.model;
  EvaluationOf<Real> out{Real{}, Real{}, Real{}, {}, kOk};
  if (model.law == Law::Capstan) {
    out.log_ratio = model.coefficients[0] * angle_rad;
    out.d_angle = Real{} + model.coefficients[0];
    return out;
  }
  detail::add_cable_term<Slopes::State>(prepared, angle_rad, low, out);
  if (model.law == Law::Matte) detail::add_surface_term(prepared, low.log, out);
  out.log_ratio = low.log < kLogTensionFloor ? Real{} + std::numeric_limits<double>::quiet_NaN() : out.log_ratio;
  return out;
}

// ln Rf and its derivatives at one wrap angle and low tension (ln T2 = -infinity is T2 = 0). Says nothing about
// calibrated ranges.
template <Slopes slopes = Slopes::All>
inline Evaluation evaluate_at(const Prepared& prepared, double angle_rad, const Tension& low) {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  if (!prepared.sound || !(angle_rad >= 0.0 && angle_rad < infinity && low.log < infinity)) {
    return detail::no_value(kInvalid);
  }
  const Model& model = prepared.model;
  Evaluation out{0.0, 0.0, 0.0, {}, kOk};
  if (model.law == Law::Capstan) {
    const double mu = model.coefficients[0];
    out.log_ratio = mu * angle_rad;
    out.d_angle = mu;
    out.d_coefficients[0] = angle_rad;
    return out;
  }
  const bool floored = low.log < kLogTensionFloor;
  const Tension used = floored ? Tension(prepared, kLogTensionFloor) : low;
  if (!detail::add_cable_term<slopes>(prepared, angle_rad, used, out)) return detail::no_value(kBlowUp);
  if (model.law == Law::Matte) detail::add_surface_term(prepared, used.log, out);
  if (floored) {
    out.status |= kTensionFloored;
    out.d_log_tension = 0.0;
  }
  return out;
}

// The same where only ln T2 is known.
template <Slopes slopes = Slopes::All>
inline Evaluation evaluate_at_log(const Prepared& prepared, double angle_rad, double log_tension) {
  return evaluate_at<slopes>(prepared, angle_rad, Tension(prepared, log_tension));
}

// The same at a tension [N], looked at against the calibrated ranges.
inline Evaluation evaluate(const Model& model, double angle_rad, double tension_N) {
  if (!(tension_N >= 0.0)) return detail::no_value(kInvalid);
  Evaluation out = evaluate_at_log(Prepared(model), angle_rad, std::log(tension_N));
  if ((out.status & kInvalid) != 0) return out;
  if (!model.angle_rad.holds(angle_rad)) out.status |= kAngleOutsideRange;
  if (!model.tension_N.holds(tension_N)) out.status |= kTensionOutsideRange;
  return out;
}

}  // namespace softgrip::friction
