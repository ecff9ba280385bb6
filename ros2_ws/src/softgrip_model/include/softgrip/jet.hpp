// SPDX-License-Identifier: Apache-2.0
// A number with its derivatives to n variables: formulas written once for doubles give exact derivatives (forward
// mode).
#pragma once

#include <array>
#include <cmath>

#include "softgrip/lanes.hpp"

namespace softgrip {

template <int n>
struct Jet {
  double value = 0.0;
  std::array<double, n> d{};

  Jet() = default;
  Jet(double constant) : value(constant) {}  // NOLINT: a number is a Jet that depends on nothing
  static Jet variable(double value, int i) {
    Jet x(value);
    x.d[i] = 1.0;
    return x;
  }

  // f(x) from its value and slope there.
  Jet through(double f, double slope) const {
    Jet out(f);
    for (int i = 0; i < n; ++i) out.d[i] = slope * d[i];
    return out;
  }

  Jet& operator+=(const Jet& other) {
    value += other.value;
    for (int i = 0; i < n; ++i) d[i] += other.d[i];
    return *this;
  }
  Jet& operator-=(const Jet& other) {
    value -= other.value;
    for (int i = 0; i < n; ++i) d[i] -= other.d[i];
    return *this;
  }

  friend Jet operator+(Jet a, const Jet& b) { return a += b; }
  friend Jet operator-(Jet a, const Jet& b) { return a -= b; }
  friend Jet operator-(const Jet& a) { return a.through(-a.value, -1.0); }
  friend Jet operator*(const Jet& a, const Jet& b) {
    Jet out(a.value * b.value);
    for (int i = 0; i < n; ++i) out.d[i] = a.value * b.d[i] + b.value * a.d[i];
    return out;
  }
  friend Jet operator/(const Jet& a, const Jet& b) {
    const double per = 1.0 / b.value;
    Jet out(a.value * per);
    for (int i = 0; i < n; ++i) out.d[i] = (a.d[i] - out.value * b.d[i]) * per;
    return out;
  }
  // With plain numbers nothing but the value matters.
  friend Jet operator+(Jet a, double b) { return a.value += b, a; }
  friend Jet operator+(double a, Jet b) { return b.value += a, b; }
  friend Jet operator-(Jet a, double b) { return a.value -= b, a; }
  friend Jet operator-(double a, const Jet& b) { return b.through(a - b.value, -1.0); }
  friend Jet operator*(const Jet& a, double b) { return a.through(a.value * b, b); }
  friend Jet operator*(double a, const Jet& b) { return b * a; }
  friend Jet operator/(const Jet& a, double b) { return a * (1.0 / b); }
  friend Jet operator/(double a, const Jet& b) { return b.through(a / b.value, -a / (b.value * b.value)); }

  friend bool operator<(const Jet& a, const Jet& b) { return a.value < b.value; }
  friend bool operator>(const Jet& a, const Jet& b) { return a.value > b.value; }
};

inline double value_of(double x) {
  return x;
}
template <int n>
double value_of(const Jet<n>& x) {
  return x.value;
}

// Looked up by their argument; std's own for doubles stand beside them.
template <int n>
Jet<n> sqrt(const Jet<n>& x) {
  const double root = std::sqrt(x.value);
  return x.through(root, 0.5 / root);
}
template <int n>
Jet<n> exp(const Jet<n>& x) {
  const double e = std::exp(x.value);
  return x.through(e, e);
}
template <int n>
Jet<n> abs(const Jet<n>& x) {
  return x.value < 0.0 ? -x : x;
}
template <int n>
void sine_cosine(const Jet<n>& angle, Jet<n>& sine, Jet<n>& cosine) {
  const double s = std::sin(angle.value), c = std::cos(angle.value);
  sine = angle.through(s, c);
  cosine = angle.through(c, -s);
}
inline double direction_of(double y, double x) {
  return std::atan2(y, x);
}
template <int n>
Jet<n> direction_of(const Jet<n>& y, const Jet<n>& x) {
  Jet<n> out(std::atan2(y.value, x.value));
  const double per = 1.0 / (x.value * x.value + y.value * y.value);
  for (int i = 0; i < n; ++i) out.d[i] = (x.value * y.d[i] - y.value * x.d[i]) * per;
  return out;
}

// atan(y/x) for x > 0, as lanes have it.
template <int n>
Jet<n> arctan(const Jet<n>& y, const Jet<n>& x) {
  return direction_of(y, x);
}

}  // namespace softgrip
