// SPDX-License-Identifier: Apache-2.0
// Several numbers worked on at once. Formulas are templates over Real: a double, or Lanes<n> of n doubles side by side.
//
// Lanes are the compiler's own vectors, so + - * / and comparisons read the same for both; a comparison of lanes gives
// a mask, and `mask ? a : b` chooses lane by lane. The functions here are to within 2 units in the last place.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace softgrip {

namespace detail {
template <int n>
struct LanesOf {
  typedef double type __attribute__((vector_size(n * sizeof(double))));
};
}  // namespace detail

template <int n>
using Lanes = typename detail::LanesOf<n>::type;

template <typename Real>
inline constexpr int kLanes = sizeof(Real) / sizeof(double);  // NOLINT(bugprone-sizeof-expression): a double has one

template <typename Real>
using MaskOf = decltype(Real{} < Real{});  // bool for a double

inline double lane(double value, int) {
  return value;
}
template <typename Real>
double lane(const Real& value, int i) {
  return value[i];
}

inline bool all(bool mask) {
  return mask;
}
template <typename Mask>
bool all(const Mask& mask) {
  auto each = mask[0];
  for (int i = 1; i < kLanes<Mask>; ++i) each &= mask[i];
  return each != 0;
}

template <typename Mask>
bool any(const Mask& mask) {
  return !all(mask == 0);
}

// Bits of a status word, where the mask is set.
inline std::uint32_t where(bool mask, std::uint32_t bits) {
  return mask ? bits : 0;
}
template <typename Mask>
Mask where(const Mask& mask, std::uint32_t bits) {
  return mask & static_cast<std::int64_t>(bits);
}

inline double abs(double x) {
  return std::abs(x);
}
template <typename Real>
Real abs(const Real& x) {
  return x < 0.0 ? -x : x;
}

template <typename Real>
Real larger(const Real& a, const Real& b) {
  return a > b ? a : b;
}

inline double sqrt(double x) {
  return std::sqrt(x);
}
template <typename Real>
Real sqrt(Real x) {
  for (int i = 0; i < kLanes<Real>; ++i) x[i] = std::sqrt(x[i]);
  return x;
}

namespace detail {

// x to the nearest whole number, which is also in the last bits of `bits`.
template <typename Real>
struct Rounded {
  static constexpr double kShift = 6755399441055744.0;  // 1.5 * 2^52
  MaskOf<Real> bits;
  Real value;
  explicit Rounded(const Real& x) {
    const Real shifted = x + kShift;
    std::memcpy(&bits, &shifted, sizeof bits);
    value = shifted - kShift;
  }
};

}  // namespace detail

// exp(x) = 2^n exp(r), |r| < ln(2)/2; stays at exp(+-700) beyond.
inline double exp(double x) {
  return std::exp(x);
}
template <typename Real>
Real exp(const Real& anywhere) {
  constexpr double kPerLog2 = 1.4426950408889634, kLog2 = 6.93147180369123816490e-01,
                   kLog2Rest = 1.90821492927058770002e-10;
  Real x = anywhere < -700.0 ? Real{} - 700.0 : anywhere;
  x = x > 700.0 ? Real{} + 700.0 : x;
  const detail::Rounded<Real> n(x * kPerLog2);
  const Real r = (x - n.value * kLog2) - n.value * kLog2Rest;
  const Real r2 = r * r, r4 = r2 * r2;
  const Real low = r2 * (1.0 / 2 + r * (1.0 / 6) + r2 * (1.0 / 24 + r * (1.0 / 120)));
  const Real middle = 1.0 / 720 + r * (1.0 / 5040) + r2 * (1.0 / 40320 + r * (1.0 / 362880));
  const Real high = 1.0 / 3628800 + r * (1.0 / 39916800) + r2 * (1.0 / 479001600 + r * (1.0 / 6227020800));
  const Real series = 1.0 + (r + (low + r4 * r2 * (middle + r4 * high)));
  const MaskOf<Real> exponent = (n.bits + 1023) << 52;
  Real power;
  std::memcpy(&power, &exponent, sizeof power);
  return series * power;
}

// For turns of a few revolutions.
inline void sine_cosine(double angle_rad, double& sine, double& cosine) {
  sine = std::sin(angle_rad);
  cosine = std::cos(angle_rad);
}
template <typename Real>
void sine_cosine(const Real& angle_rad, Real& sine, Real& cosine) {
  constexpr double kQuarter = 1.57079632673412561417, kQuarterRest = 6.07710050650619224932e-11;
  const detail::Rounded<Real> n(angle_rad * (2.0 / M_PI));
  const Real r = (angle_rad - n.value * kQuarter) - n.value * kQuarterRest;
  const Real z = r * r, z2 = z * z, z4 = z2 * z2;
  const Real s = r + r * z *
                         ((-1.0 / 6 + z * (1.0 / 120)) + z2 * (-1.0 / 5040 + z * (1.0 / 362880)) +
                          z4 * ((-1.0 / 39916800 + z * (1.0 / 6227020800)) - z2 * (1.0 / 1307674368000)));
  const Real c = 1.0 - 0.5 * z +
                 z2 * ((1.0 / 24 - z * (1.0 / 720)) + z2 * (1.0 / 40320 - z * (1.0 / 3628800)) +
                       z4 * ((1.0 / 479001600 - z * (1.0 / 87178291200)) + z2 * (1.0 / 20922789888000)));
  const MaskOf<Real> swapped = (n.bits & 1) != 0;
  const Real sine_size = swapped ? c : s, cosine_size = swapped ? s : c;
  sine = (n.bits & 2) != 0 ? -sine_size : sine_size;
  cosine = ((n.bits + 1) & 2) != 0 ? -cosine_size : cosine_size;
}

// atan(y/x) for x > 0.
inline double arctan(double y, double x) {
  return std::atan(y / x);
}
template <typename Real>
Real arctan(const Real& y, const Real& x) {
  // Cephes' atan: the argument brought below 0.66, then a rational function
  const Real size = abs(y);
  const MaskOf<Real> steep = size > 2.414213562373095 * x, middle = size > 0.66 * x;
  const Real over = steep ? -x : middle ? size - x : size;
  const Real under = steep ? size : middle ? size + x : x;
  const Real base = steep ? Real{} + M_PI / 2 : middle ? Real{} + M_PI / 4 : Real{};
  const Real t = over / under, z = t * t;
  const Real p = (((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1) * z -
                  1.228866684490136173410e2) *
                     z -
                 6.485021904942025371773e1;
  const Real q =
      ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z + 4.328810604912902668951e2) * z +
       4.853903996359136964868e2) *
          z +
      1.945506571482613964425e2;
  const Real angle = base + (t + t * z * (p / q));
  return y < 0.0 ? -angle : angle;
}

}  // namespace softgrip
