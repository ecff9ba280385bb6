// SPDX-License-Identifier: Apache-2.0
// The strip's beam against closed forms of beam theory and against its differential equation integrated here.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "softgrip/plant/section.hpp"
#include "softgrip/plant/strip.hpp"

namespace softgrip::plant {
namespace {

constexpr double kModulus = 20e6, kLength = 0.010, kThickness = 0.003, kWidth = 0.015, kPoisson = 0.3;
constexpr double kPlate = kModulus / (1.0 - kPoisson * kPoisson);
constexpr double kBending = kPlate * kWidth * kThickness * kThickness * kThickness / 12.0;
constexpr double kAxial = kPlate * kWidth * kThickness;
constexpr double kShear = 5.0 / 6.0 * kModulus / (2.0 * (1.0 + kPoisson)) * kWidth * kThickness;

StripMake linear(double near_root, double far_root) {
  const StressLaw law{{kModulus, 0.0, 0.0}, {kModulus, 0.0, 0.0}};
  return {
      kLength, kThickness, kWidth, law, kPoisson, near_root, far_root, 0.0, {0.0, 0.0, 0.0, 0.0}, {1.0, 1.0, 1.0, 1.0},
      0.0};
}

// Bring a strip to rest under a force on its far link, (u, v, q).
Strip loaded(const StripMake& make, const Eigen::Vector3d& force) {
  Strip strip(make);
  for (int i = 1; i <= 400; ++i) {
    const double share = std::min(1.0, i / 200.0);
    const StripForce now = strip.condense(1.0);
    const Pose change = now.tangent.inverse() * (share * force - now.force);
    strip.move(change, 1.0, 1.0);
  }
  EXPECT_LT((strip.condense(1.0).force - force).norm(), 1e-9 * (1.0 + force.norm()));
  return strip;
}

TEST(Section, ALinearFibreGivesTheStiffnessOfTheRectangle) {
  const Section section({{kModulus, 0.0, 0.0}, {kModulus, 0.0, 0.0}}, kThickness, kWidth, 1.0);
  const SectionForce force = section.force(0.02, 30.0);
  EXPECT_NEAR(force.normal_n, kModulus * kWidth * kThickness * 0.02, 1e-9);
  EXPECT_NEAR(force.moment_nm, kModulus * kWidth * std::pow(kThickness, 3) / 12.0 * 30.0, 1e-12);
  EXPECT_NEAR(force.by_both_nm, 0.0, 1e-9);
}

TEST(Section, TangentsAreWhatDifferencesGive) {
  const Section section({{21.89e6, -44.7e6, 36.7e6}, {21.89e6, 20e6, 5e6}}, kThickness, kWidth, 1.2);
  const double step = 1e-6;
  for (const double curvature : {0.0, 40.0, 120.0}) {
    const SectionForce at = section.force(0.01, curvature);
    const SectionForce longer = section.force(0.01 + step, curvature), shorter = section.force(0.01 - step, curvature);
    const SectionForce more = section.force(0.01, curvature + step), less = section.force(0.01, curvature - step);
    EXPECT_NEAR(at.by_strain_n, (longer.normal_n - shorter.normal_n) / (2 * step), 1e-4 * at.by_strain_n);
    EXPECT_NEAR(at.by_both_nm, (more.normal_n - less.normal_n) / (2 * step), 1e-4 * std::abs(at.by_both_nm) + 1e-3);
    EXPECT_NEAR(at.by_curvature_nm2, (more.moment_nm - less.moment_nm) / (2 * step), 1e-4 * at.by_curvature_nm2);
  }
}

TEST(Section, SofteningInTensionPushesTheFibresTogether) {
  // Softer in tension than in compression: a bent section without strain of its axis is compressed on the whole.
  const Section section({{20e6, -20e6, 0.0}, {20e6, 20e6, 0.0}}, kThickness, kWidth, 1.0);
  EXPECT_LT(section.force(0.0, 80.0).normal_n, -1.0);
}

TEST(Strip, AnEndMomentBendsItToAnArc) {
  const double turn = 1.4, moment = kBending * turn / kLength;
  const Strip strip = loaded(linear(0.0, 0.0), {0.0, 0.0, moment});
  EXPECT_NEAR(strip.pose().z(), turn, 1e-4);
  // The arc starts at -l/2 along a; its end is the far link's, half a strip before that link's origin.
  const double radius = kLength / turn, cos = std::cos(turn), sin = std::sin(turn);
  const double a = -0.5 * kLength + radius * sin - 0.5 * kLength * cos;
  const double b = radius * (1.0 - cos) - 0.5 * kLength * sin;
  EXPECT_NEAR(strip.pose().x(), a, 2e-6);
  EXPECT_NEAR(strip.pose().y(), b, 2e-6);
  EXPECT_NEAR(strip.middle_m().x(), -0.5 * kLength + radius * std::sin(turn / 2), 2e-6);
  EXPECT_NEAR(strip.middle_m().y(), radius * (1.0 - std::cos(turn / 2)), 2e-6);
}

TEST(Strip, ASmallForceBendsAndShearsItAsTimoshenkoSays) {
  // Across at the origin of the far link, i.e. in the strip's middle: its ends turn against each other by nothing.
  const double force = 1e-3;
  const Strip strip = loaded(linear(0.0, 0.0), {0.0, force, 0.0});
  EXPECT_NEAR(strip.pose().y(), force * (std::pow(kLength, 3) / (12.0 * kBending) + kLength / kShear),
              1e-4 * force * 1e-3);
  EXPECT_NEAR(strip.pose().z(), 0.0, 1e-9);
  const Strip pulled = loaded(linear(0.0, 0.0), {force, 0.0, 0.0});
  EXPECT_NEAR(pulled.pose().x(), force * kLength / kAxial, 1e-3 * force * kLength / kAxial);
}

TEST(Strip, RootsGiveAsOfDonnellsHalfSpace) {
  const double moment = 1e-4, root = 16.67 / M_PI / (kPlate * kWidth * kThickness * kThickness);
  EXPECT_NEAR(loaded(linear(1.0, 1.0), {0.0, 0.0, moment}).pose().z(), moment * (kLength / kBending + 2.0 * root),
              1e-4 * moment * kLength / kBending);
  // Such a root is worth 0.44 thicknesses of strip.
  EXPECT_NEAR(root * kBending / kThickness, 16.67 / M_PI / 12.0, 1e-12);
}

// From the root on, with the force and moment of the far link: the beam's own differential equation, by Runge-Kutta.
Pose integrated(const Eigen::Vector3d& force, const Pose& far) {
  const Eigen::Vector2d pull = force.head<2>();
  const auto slope = [&](const Pose& at) {
    // The force acts at the far link's origin.
    const Eigen::Vector2d arm = far.head<2>() - at.head<2>();
    const double moment = force.z() + arm.x() * pull.y() - arm.y() * pull.x();
    const double cos = std::cos(at.z()), sin = std::sin(at.z());
    const double stretch = 1.0 + (cos * pull.x() + sin * pull.y()) / kAxial;
    const double shear = (cos * pull.y() - sin * pull.x()) / kShear;
    return Pose(stretch * cos - shear * sin, stretch * sin + shear * cos, moment / kBending);
  };
  Pose at(-0.5 * kLength, 0.0, 0.0);
  const int steps = 400;
  const double h = kLength / steps;
  for (int i = 0; i < steps; ++i) {
    const Pose k1 = slope(at), k2 = slope(at + 0.5 * h * k1), k3 = slope(at + 0.5 * h * k2), k4 = slope(at + h * k3);
    at += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }
  return at;
}

TEST(Strip, LargeLoadsGiveTheElasticaWithStretchAndShear) {
  for (const Eigen::Vector3d& force :
       {Eigen::Vector3d(-12.0, 0.0, 0.06), Eigen::Vector3d(-10.0, -12.0, 0.10), Eigen::Vector3d(5.0, 15.0, 0.02)}) {
    const Strip strip = loaded(linear(0.0, 0.0), force);
    const Pose& far = strip.pose();
    const Pose end = integrated(force, far);
    // Where the far link holds its end of the strip.
    EXPECT_NEAR(end.z(), far.z(), 0.01 * std::abs(far.z()) + 2e-4);
    EXPECT_NEAR(end.x(), far.x() + 0.5 * kLength * std::cos(far.z()), 0.01 * kLength);
    EXPECT_NEAR(end.y(), far.y() + 0.5 * kLength * std::sin(far.z()), 0.01 * kLength);
  }
}

TEST(Strip, ItGivesBackTheWorkOfAClosedWay) {
  Strip strip(linear(1.0, 1.0));
  double work_j = 0.0, size_j = 0.0;
  const int steps = 2000;
  Pose at = Pose::Zero();
  for (int i = 1; i <= steps; ++i) {
    const double phase = 2.0 * M_PI * i / steps;
    const Pose next(2e-5 * std::sin(phase), 2e-4 * std::sin(phase), 0.4 * (1.0 - std::cos(phase)));
    Eigen::Vector3d force = strip.condense(1.0).force;
    strip.move(next - at, 1.0, 1.0);
    strip.condense(1.0);
    strip.move(Pose::Zero(), 1.0, 1.0);
    force = 0.5 * (force + strip.condense(1.0).force);
    work_j += force.dot(next - at);
    size_j += std::abs(force.dot(next - at));
    at = next;
  }
  EXPECT_NEAR(work_j, 0.0, 1e-3 * size_j);
}

// Moment that keeps a strip turned, [N m], after `seconds` at that turn.
double held_moment(Strip& strip, double turn, double seconds, double pace = 1.0) {
  // Held by its angle; along and across it is free.
  for (int i = 0; i < 1500; ++i) {
    const StripForce now = strip.condense(0.02);
    Pose change = Pose::Zero();
    const double to_go = turn - strip.pose().z();
    change.z() = std::clamp(to_go, -0.001, 0.001);
    change.head<2>() = now.tangent.topLeftCorner<2, 2>().inverse() *
                       (-now.force.head<2>() - now.tangent.topRightCorner<2, 1>() * change.z());
    strip.move(change, 1.0, 1e-9);
  }
  const int steps = 4000;
  for (int i = 0; i < steps; ++i) strip.move(Pose::Zero(), 0.0, seconds / steps, {1.0, pace});
  return strip.condense(0.02).force.z();
}

TEST(Strip, ItRelaxesAsItsSeriesSays) {
  StripMake make = linear(0.0, 0.0);
  make.damping_s = 0.035;
  make.relaxing_share = {0.1, 0.05, 0.1, 0.02};
  make.relaxing_time_s = {0.3, 3.0, 30.0, 300.0};
  Strip strip(make);
  const double at_once = held_moment(strip, 0.5, 1e-6);
  for (const double pace : {1.0, 2.0}) {
    Strip other(make);
    const double later = held_moment(other, 0.5, 10.0, pace);
    double left = 1.0;
    for (std::size_t k = 0; k < 4; ++k) {
      left -= make.relaxing_share[k] * (1.0 - std::exp(-10.0 * pace / make.relaxing_time_s[k]));
    }
    EXPECT_NEAR(later / at_once, left, 2e-3);
  }
}

TEST(Strip, RunInItIsSofterUntilItIsBentFurther) {
  StripMake make = linear(0.0, 0.0);
  make.damping_s = 0.035;
  Strip elastic(make);
  make.softening = 0.2;
  Strip used(make);
  held_moment(used, 1.2, 0.0);
  const double there = held_moment(used, 1.2, 0.0), half = held_moment(used, 0.4, 0.0);
  EXPECT_NEAR(half / held_moment(elastic, 0.4, 0.0), 0.8, 0.01);
  EXPECT_NEAR(there / held_moment(elastic, 1.2, 0.0), 1.0, 0.01);
  // Another copy that remembers is as soft.
  double memory[Strip::kMemory];
  used.recall(memory);
  Strip again(make);
  again.restore(memory);
  EXPECT_NEAR(held_moment(again, 0.4, 0.0), half, 1e-3 * half);
}

}  // namespace
}  // namespace softgrip::plant
