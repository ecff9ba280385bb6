// SPDX-License-Identifier: Apache-2.0
// Friction laws against their differential equation, and slopes against differences.
#include <gtest/gtest.h>

#include "softgrip/friction.hpp"

namespace softgrip::friction {
namespace {

Model model(Law law, Coefficients coefficients, KReading reading = KReading::Exact) {
  Model made;
  made.law = law;
  made.k_reading = reading;
  made.coefficients = coefficients;
  made.radius_mm = 3.75;
  return made;
}

TEST(Friction, CapstanIsEulersFormula) {
  EXPECT_NEAR(evaluate(model(Law::Capstan, {0.3}), 1.2, 5.0).ratio(), std::exp(0.36), 1e-14);
}

// dT/dtheta = alpha r^(1-n) T^n from the low tension, by Runge and Kutta's fourth-order steps.
TEST(Friction, ExactHeapLawIntegratesItsDifferentialEquation) {
  const double alpha = 0.427, n = 0.731, radius_mm = 3.75, angle_rad = 1.5, low_n = 2.0;
  const auto slope = [&](double tension) { return alpha * std::pow(radius_mm, 1.0 - n) * std::pow(tension, n); };
  double tension = low_n;
  constexpr int kSteps = 2000;
  const double h = angle_rad / kSteps;
  for (int i = 0; i < kSteps; ++i) {
    const double k1 = slope(tension), k2 = slope(tension + h / 2 * k1), k3 = slope(tension + h / 2 * k2),
                 k4 = slope(tension + h * k3);
    tension += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
  }
  EXPECT_NEAR(evaluate(model(Law::Heap, {alpha, n}), angle_rad, low_n).ratio(), tension / low_n, 1e-10);
}

TEST(Friction, MatteAddsASurfaceTermThatFallsWithTension) {
  const double low_n = 2.0;
  const double heap = evaluate(model(Law::Heap, {0.3, 0.75}), 0.8, low_n).log_ratio;
  const double matte = evaluate(model(Law::Matte, {0.3, 0.75, 0.1, 0.06}), 0.8, low_n).log_ratio;
  EXPECT_NEAR(matte - heap, 0.1 - 0.06 * std::log(low_n), 1e-14);
  // beyond exp(epsilon / lambda) it would push: it counts as none
  const Evaluation beyond = evaluate(model(Law::Matte, {0.3, 0.75, 0.1, 0.06}), 0.8, 6.0);
  EXPECT_NEAR(beyond.log_ratio, evaluate(model(Law::Heap, {0.3, 0.75}), 0.8, 6.0).log_ratio, 1e-14);
  EXPECT_NE(beyond.status & kSurfaceClamped, 0);
}

TEST(Friction, SlopesAreThoseOfDifferences) {
  const double angle_rad = 0.8, low_n = 2.0, step = 1e-5;
  for (const KReading reading : {KReading::Printed, KReading::Limit, KReading::Exact}) {
    const Model matte = model(Law::Matte, {0.3, 0.75, 0.1, 0.06}, reading);
    const Evaluation here = evaluate(matte, angle_rad, low_n);
    const auto log_ratio = [&](const Model& of, double angle, double log_factor) {
      return evaluate(of, angle, low_n * std::exp(log_factor)).log_ratio;
    };
    const auto slope = [&](double more, double less) { return (more - less) / (2.0 * step); };
    EXPECT_NEAR(here.d_angle, slope(log_ratio(matte, angle_rad + step, 0.0), log_ratio(matte, angle_rad - step, 0.0)),
                1e-8);
    EXPECT_NEAR(here.d_log_tension, slope(log_ratio(matte, angle_rad, step), log_ratio(matte, angle_rad, -step)), 1e-8);
    for (std::size_t k = 0; k < 4; ++k) {
      Model more = matte, less = matte;
      more.coefficients[k] += step;
      less.coefficients[k] -= step;
      EXPECT_NEAR(here.d_coefficients[k], slope(log_ratio(more, angle_rad, 0.0), log_ratio(less, angle_rad, 0.0)),
                  1e-7);
    }
  }
}

TEST(Friction, PrintedFormHasNoValueBeyondItsBlowUpAngle) {
  const Model heap = model(Law::Heap, {0.6, 0.5}, KReading::Printed);
  const double angle_rad = blow_up_angle(heap, 1.0);
  EXPECT_NEAR(0.6 * 0.5 * std::sqrt(3.75) * angle_rad, 1.0, 1e-12);  // x = alpha (1-n) (r/T)^(1-n) theta = 1
  EXPECT_TRUE(evaluate(heap, 0.99 * angle_rad, 1.0).has_value());
  EXPECT_FALSE(evaluate(heap, 1.01 * angle_rad, 1.0).has_value());
}

}  // namespace
}  // namespace softgrip::friction
