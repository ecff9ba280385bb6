// SPDX-License-Identifier: Apache-2.0
// The plant's finger at rest under a wound cable: moments, cable stretch and capstan ratios, worked out from its
// geometry.
#include <gtest/gtest.h>

#include <cmath>

#include "softgrip/plant/finger.hpp"

namespace softgrip::plant {
namespace {

FingerMake two_joints() {
  FingerMake make;
  make.link_m = {0.03, 0.025};
  make.opening_rad = {1.4, 1.2};
  make.entry_radius_m = {0.008, 0.007};
  make.exit_radius_m = {0.009, 0.0075};
  make.moment_linear = {0.12, 0.08};
  make.moment_quadratic = {0.0, 0.0};
  make.moment_cubic = {0.02, 0.01};
  make.friction_coefficient.assign(4, 0.0);
  make.friction_bite.assign(4, 0.0);
  make.body_height_m = 0.02;
  make.damping_s = 0.02;
  make.creep_share = 0.0;
  make.creep_time_s = 10.0;
  make.friction_tension_exponent = 0.0;
  make.friction_stribeck_share = 0.0;
  make.friction_stribeck_speed_m_s = 0.01;
  make.presliding_m = 1e-4;
  make.cable_stiffness_n = 2000.0;
  make.lead_length_m = 0.2;
  make.slack_m = 0.0;
  return make;
}

// A finger that has had time to come to rest with cable wound.
class RestingFinger {
 public:
  RestingFinger(const FingerMake& make, double wound_m) : finger(make, {q, speed, span_tension, &tension}) {
    for (int i = 0; i < 4000; ++i) finger.step(wound_m * std::min(1.0, i / 1000.0), 0.0, false, 1.0, 1e-3, {});
  }

  // d(cable in the groove)/dq of joint j, by differences of the law of cosines.
  double arm(const FingerMake& make, std::size_t j) const {
    const auto span = [&](double angle) {
      const double ra = make.entry_radius_m[j], rb = make.exit_radius_m[j];
      return std::sqrt(ra * ra + rb * rb - 2.0 * ra * rb * std::cos(make.opening_rad[j] - angle));
    };
    const double step = 1e-6;
    return (span(q[j] - step) - span(q[j] + step)) / (2.0 * step);
  }

  double q[2] = {}, speed[2] = {}, span_tension[4] = {}, tension = 0.0;
  Finger finger;
};

TEST(PlantFinger, MomentsBalanceTheTensionInEveryGroove) {
  const FingerMake make = two_joints();
  RestingFinger resting(make, 0.006);
  ASSERT_GT(resting.tension, 1.0);
  for (std::size_t j = 0; j < 2; ++j) {
    const double q = resting.q[j], moment = q * (make.moment_linear[j] + make.moment_cubic[j] * q * q);
    EXPECT_NEAR(moment, resting.tension * resting.arm(make, j), 1e-4 * moment);
    EXPECT_NEAR(resting.speed[j], 0.0, 1e-6);
  }
}

TEST(PlantFinger, WoundCableIsPulledLengthAndStretch) {
  const FingerMake make = two_joints();
  const double wound_m = 0.006;
  RestingFinger resting(make, wound_m);
  double spans_m = 0.0;
  for (std::size_t j = 0; j < 2; ++j) {
    const double ra = make.entry_radius_m[j], rb = make.exit_radius_m[j], gap = make.opening_rad[j] - resting.q[j];
    spans_m += std::sqrt(ra * ra + rb * rb - 2.0 * ra * rb * std::cos(gap));
  }
  const double on_link_1_m = 0.03 - 0.009 * std::sin(0.7) - 0.007 * std::sin(0.6),
               on_link_2_m = 0.025 - 0.0075 * std::sin(0.6);
  const double stretch_m =
      resting.tension * (make.lead_length_m + spans_m + on_link_1_m + on_link_2_m) / make.cable_stiffness_n;
  EXPECT_NEAR(resting.finger.pulled_length_m() + stretch_m, wound_m, 1e-7);
}

TEST(PlantFinger, TensionFallsTowardsTheTipByTheWrapAngles) {
  FingerMake make = two_joints();
  const double mu = 0.3;
  make.friction_coefficient.assign(4, mu);
  make.presliding_m = 1e-6;  // the last point is slid over only by what the cable behind it stretches
  RestingFinger resting(make, 0.006);
  // the groove's span as a vector in the frame of the link before it
  double before = 0.0;  // slope of the cable on that link
  double expected = resting.tension;
  for (std::size_t j = 0; j < 2; ++j) {
    const double half = make.opening_rad[j] / 2.0, ra = make.entry_radius_m[j], rb = make.exit_radius_m[j],
                 q = resting.q[j];
    const double slope =
        std::atan2(ra * std::cos(half) - rb * std::cos(half - q), ra * std::sin(half) + rb * std::sin(half - q));
    const double run_m = 0.03 - 0.009 * std::sin(0.7) - 0.007 * std::sin(0.6);
    const double after = j == 0 ? std::atan2(0.009 * std::cos(0.7) - 0.007 * std::cos(0.6), run_m) : 0.0;
    expected *= std::exp(-mu * std::abs(slope - before));
    EXPECT_NEAR(resting.span_tension[2 * j], expected, 2e-3 * expected);
    expected *= std::exp(-mu * std::abs(slope - after + q));
    EXPECT_NEAR(resting.span_tension[2 * j + 1], expected, 2e-3 * expected);
    before = after;
  }
}

TEST(PlantFinger, ABrokenTendonLetsItGo) {
  const FingerMake make = two_joints();
  RestingFinger resting(make, 0.006);
  for (int i = 0; i < 4000; ++i) resting.finger.step(0.006, 0.0, true, 1.0, 1e-3, {});
  EXPECT_EQ(resting.tension, 0.0);
  EXPECT_NEAR(resting.q[0], 0.0, 1e-6);
}

}  // namespace
}  // namespace softgrip::plant
