// SPDX-License-Identifier: Apache-2.0
// The plant's finger at rest under a wound cable: where its links stand, cable stretch and capstan ratios, worked out
// from the places of its links.
#include <gtest/gtest.h>

#include <cmath>

#include "softgrip/plant/finger.hpp"

namespace softgrip::plant {
namespace {

FingerMake two_joints() {
  FingerMake make;
  make.tendon.link_m = {0.03, 0.025};
  make.tendon.opening_rad = {1.4, 1.2};
  make.tendon.entry_radius_m = {0.008, 0.007};
  make.tendon.exit_radius_m = {0.009, 0.0075};
  make.tendon.clearance_m.assign(4, 0.0);
  make.tendon.friction_pressure.assign(4, 0.0);
  make.tendon.friction_adhesion.assign(4, 0.0);
  make.tendon.bending_n = 0.0;
  make.tendon.bending_share = 0.0;
  make.tendon.friction_stribeck_share = 0.0;
  make.tendon.friction_stribeck_speed_m_s = 0.01;
  make.tendon.presliding_m = 1e-4;
  make.tendon.cable_stiffness_n = 2000.0;
  make.tendon.lead_length_m = 0.2;
  make.tendon.bedding_strain = 0.0;
  make.tendon.bedding_n = 1.0;
  make.tendon.creep_share = 0.0;
  make.tendon.creep_time_s = 1.0;
  make.tendon.knot_slip_m = 0.0;
  make.tendon.wear_per_j.assign(4, 0.0);
  const std::array<double, 4> none{0.0, 0.0, 0.0, 0.0}, times{1.0, 1.0, 1.0, 1.0};
  const StressLaw law{{20e6, 0.0, 0.0}, {20e6, 0.0, 0.0}};
  make.strips = {{0.010, 0.003, 0.015, law, 0.3, 0.0, 1.0, 0.02, none, times, 0.0},
                 {0.009, 0.0028, 0.015, law, 0.3, 1.0, 1.0, 0.02, none, times, 0.0}};
  make.body_height_m = 0.02;
  make.slack_m = 0.0;
  return make;
}

// A finger that has had time to come to rest with cable wound.
class RestingFinger {
 public:
  RestingFinger(const FingerMake& make, double wound_m) : finger(make, {q, speed, span_tension, &tension}) {
    for (int i = 0; i < 4000; ++i) finger.step(wound_m * std::min(1.0, i / 1000.0), 0.0, false, {}, 1e-3, {});
    finger.shape(shape);
  }

  // A point of a link, given along it and towards the closing side from its end of the joint.
  Eigen::Vector2d on_link(std::size_t link, double along, double inward) const {
    const double cos = std::cos(shape.heading_rad[link]), sin = std::sin(shape.heading_rad[link]);
    return shape.origins[link] + Eigen::Vector2d(cos * along - sin * inward, -sin * along - cos * inward);
  }

  // Where the cable enters and leaves a groove.
  Eigen::Vector2d entry(const FingerMake& make, std::size_t j) const {
    const double half = make.tendon.opening_rad[j] / 2.0, r = make.tendon.entry_radius_m[j];
    if (j == 0) return {-r * std::sin(half), -r * std::cos(half)};
    return on_link(j - 1, make.tendon.link_m[j - 1] - r * std::sin(half), r * std::cos(half));
  }
  Eigen::Vector2d exit(const FingerMake& make, std::size_t j) const {
    const double half = make.tendon.opening_rad[j] / 2.0, r = make.tendon.exit_radius_m[j];
    return on_link(j, r * std::sin(half), r * std::cos(half));
  }

  double q[2] = {}, speed[2] = {}, span_tension[4] = {}, tension = 0.0;
  Finger finger;
  FingerShape shape;
};

TEST(PlantFinger, WoundCableIsPulledLengthAndStretch) {
  const FingerMake make = two_joints();
  const double wound_m = 0.006;
  RestingFinger resting(make, wound_m);
  double spans_m = 0.0, straight_m = 0.0;
  for (std::size_t j = 0; j < 2; ++j) {
    const double half = make.tendon.opening_rad[j] / 2.0, ra = make.tendon.entry_radius_m[j],
                 rb = make.tendon.exit_radius_m[j];
    spans_m += (resting.exit(make, j) - resting.entry(make, j)).norm();
    straight_m += std::hypot((ra + rb) * std::sin(half), (ra - rb) * std::cos(half));
  }
  EXPECT_NEAR(resting.finger.pulled_length_m(), straight_m - spans_m, 1e-12);
  const Eigen::Vector2d from = resting.exit(make, 0), to = resting.entry(make, 1);
  const double on_link_1_m = (to - from).norm(), on_link_2_m = 0.025 - 0.0075 * std::sin(0.6);
  const double stretch_m = resting.tension * (make.tendon.lead_length_m + spans_m + on_link_1_m + on_link_2_m) /
                           make.tendon.cable_stiffness_n;
  ASSERT_GT(resting.tension, 1.0);
  EXPECT_NEAR(resting.finger.pulled_length_m() + stretch_m, wound_m, 1e-7);
}

TEST(PlantFinger, TheLastStripCarriesTheCableOfItsGroove) {
  const FingerMake make = two_joints();
  RestingFinger resting(make, 0.006);
  // The cable draws the last link along the span of its groove; a strip of the same make bends as much by that alone.
  Strip alone(make.strips[1]);
  const double cos = std::cos(resting.shape.heading_rad[0]), sin = std::sin(resting.shape.heading_rad[0]);
  const auto in_link = [&](const Eigen::Vector2d& v) {
    return Eigen::Vector2d(cos * v.x() - sin * v.y(), -sin * v.x() - cos * v.y());
  };
  const Eigen::Vector2d span = in_link(resting.exit(make, 1) - resting.entry(make, 1)).normalized();
  const Eigen::Vector2d arm = in_link(resting.exit(make, 1) - resting.shape.origins[1]);
  const Eigen::Vector3d force(-resting.tension * span.x(), -resting.tension * span.y(),
                              -resting.tension * (arm.x() * span.y() - arm.y() * span.x()));
  for (int i = 0; i < 200; ++i) {
    const StripForce now = alone.condense(1e3);
    alone.move(0.5 * now.tangent.inverse() * (force - now.force), 0.5, 1e3);
  }
  EXPECT_NEAR(alone.pose().z(), resting.q[1], 1e-5);
  EXPECT_NEAR(resting.speed[1], 0.0, 1e-6);
}

TEST(PlantFinger, TensionFallsTowardsTheTipByTheWrapAngles) {
  FingerMake make = two_joints();
  const double mu = 0.3;
  make.tendon.friction_pressure.assign(4, mu);
  make.tendon.presliding_m = 1e-6;  // the last point is slid over only by what the cable behind it stretches
  RestingFinger resting(make, 0.006);
  const Eigen::Vector2d last = resting.on_link(1, 0.025, 0.0075 * std::cos(0.6)) - resting.exit(make, 1);
  const Eigen::Vector2d ways[] = {{1.0, 0.0},
                                  resting.exit(make, 0) - resting.entry(make, 0),
                                  resting.entry(make, 1) - resting.exit(make, 0),
                                  resting.exit(make, 1) - resting.entry(make, 1),
                                  last};
  double expected = resting.tension;
  for (std::size_t k = 0; k < 4; ++k) {
    const double bend = std::acos(ways[k].normalized().dot(ways[k + 1].normalized()));
    expected *= std::exp(-mu * bend);
    EXPECT_NEAR(resting.span_tension[k], expected, 2e-3 * expected);
  }
}

TEST(PlantFinger, ACableWithRoomLiesOnTheRimOrRubsNowhere) {
  FingerMake make = two_joints();
  make.tendon.friction_pressure.assign(4, 0.3);
  make.tendon.presliding_m = 1e-6;
  make.tendon.clearance_m.assign(4, 0.0005);
  RestingFinger resting(make, 0.006);
  // Bent so far the cable lies on the outer rim of every hole: as one without room through holes that much further out.
  FingerMake outer = make;
  outer.tendon.clearance_m.assign(4, 0.0);
  for (auto* row : {&outer.tendon.entry_radius_m, &outer.tendon.exit_radius_m}) {
    for (double& radius_m : *row) radius_m += 0.0005;
  }
  RestingFinger there(outer, resting.finger.pulled_length_m() + 0.001);
  EXPECT_NEAR(resting.q[0] / resting.q[1], there.q[0] / there.q[1], 0.1);
  // With all the room there is the straight finger's cable touches nothing.
  make.tendon.clearance_m.assign(4, 0.003);
  RestingFinger loose(make, 0.0002);
  EXPECT_NEAR(loose.span_tension[3], loose.tension, 1e-3 * loose.tension);
}

TEST(PlantFinger, ABraidBedsInOnceAndItsKnotDrawsTight) {
  FingerMake make = two_joints();
  make.tendon.bedding_strain = 0.005;
  make.tendon.bedding_n = 0.1;
  RestingFinger plain(two_joints(), 0.006), bedded(make, 0.006);
  // All of the cable, lead and finger, has become longer by the whole bedding strain.
  const double straight_m = make.tendon.lead_length_m + 0.035 + 0.055 - 0.0075 * std::sin(0.6);
  EXPECT_NEAR(plain.finger.pulled_length_m() - bedded.finger.pulled_length_m(), 0.005 * straight_m,
              0.15 * 0.005 * straight_m);
  make.tendon.bedding_strain = 0.0;
  make.tendon.knot_slip_m = 1e-4;
  RestingFinger knotted(make, 0.006);
  const std::vector<double> memory = knotted.finger.recall();
  // One loading is up to 10 N and back; this was up only.
  EXPECT_NEAR(memory[4 + 2], knotted.tension / 20.0, 0.05);
}

TEST(PlantFinger, AContactWearsWithForceTimesWay) {
  FingerMake make = two_joints();
  make.tendon.friction_pressure.assign(4, 0.2);
  make.tendon.wear_per_j = {0.0, 5.0, 0.0, 0.0};
  RestingFinger resting(make, 0.006);
  const std::vector<double> memory = resting.finger.recall();
  EXPECT_EQ(memory[4 + 3], 0.0);
  EXPECT_GT(memory[4 + 4], 0.0);
  // At most the whole tension round the whole bend along all the cable that came by.
  EXPECT_LT(memory[4 + 4], 5.0 * resting.tension * resting.q[0] * 0.006);
}

TEST(PlantFinger, ABrokenTendonLetsItGo) {
  const FingerMake make = two_joints();
  RestingFinger resting(make, 0.006);
  for (int i = 0; i < 4000; ++i) resting.finger.step(0.006, 0.0, true, {}, 1e-3, {});
  EXPECT_EQ(resting.tension, 0.0);
  EXPECT_NEAR(resting.q[0], 0.0, 1e-6);
}

}  // namespace
}  // namespace softgrip::plant
