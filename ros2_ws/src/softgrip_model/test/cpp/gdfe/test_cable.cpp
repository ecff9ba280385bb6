// SPDX-License-Identifier: Apache-2.0
// A cable through points: capstan tensions in closed form, forces as slopes of its length, balance.
#include <gtest/gtest.h>

#include <numeric>

#include "softgrip/gdfe/cable.hpp"

namespace softgrip::gdfe {
namespace {

using Points = std::vector<Eigen::Vector3d>;

Cable cable_through(std::size_t points, double mu) {
  Cable cable;
  cable.points.resize(points);
  cable.entry = Eigen::Vector3d(-1.0, 0.0, 0.0);
  cable.friction.law = friction::Law::Capstan;
  cable.friction.coefficients = {mu};
  cable.friction.radius_mm = 1.0;
  return cable;
}

// Bends of 0.3, 0.5 and 0.4 rad, in that order, in one plane.
Points bent() {
  Points points{Eigen::Vector3d::Zero()};
  double direction = 0.0;
  for (const double bend : {0.3, 0.5, 0.4}) {
    direction += bend;
    points.push_back(points.back() + 2.0 * Eigen::Vector3d(std::cos(direction), std::sin(direction), 0.0));
  }
  return points;
}

double length_of(const Cable& cable, const Points& points) {
  double length = -cable.entry.dot(points[0]);
  for (std::size_t k = 0; k + 1 < points.size(); ++k) length += (points[k + 1] - points[k]).norm();
  return length;
}

TEST(Cable, TensionGrowsByEulersFactorAtEveryBend) {
  const double mu = 0.4, anchor = 3.0;
  const CableState state = pull_from_anchor(cable_through(4, mu), bent(), anchor);
  ASSERT_TRUE(state.sound);
  ASSERT_EQ(state.tension.size(), 4U);
  const double expected[] = {anchor * std::exp(mu * 1.2), anchor * std::exp(mu * 0.9), anchor * std::exp(mu * 0.4),
                             anchor};
  for (std::size_t k = 0; k < 4; ++k) EXPECT_NEAR(state.tension[k], expected[k], 1e-12 * expected[k]);
}

TEST(Cable, PullsOnItsPointsWithWhatTheActuatorAndTheAnchorHold) {
  const CableState state = pull_from_anchor(cable_through(4, 0.4), bent(), 3.0);
  const Eigen::Vector3d sum = std::accumulate(state.force.begin(), state.force.end(), Eigen::Vector3d(0.0, 0.0, 0.0));
  EXPECT_TRUE(sum.isApprox(state.tension.front() * Eigen::Vector3d(-1.0, 0.0, 0.0), 1e-12));
}

TEST(Cable, WithoutFrictionForcesAreTensionTimesTheFallOfLength) {
  const Cable cable = cable_through(4, 0.0);
  const double tension = 2.5, step = 1e-6;
  const CableState state = pull_from_anchor(cable, bent(), tension);
  EXPECT_NEAR(state.length + state.entry_length, length_of(cable, bent()), 1e-12);
  for (std::size_t p = 0; p < 4; ++p) {
    for (int axis = 0; axis < 3; ++axis) {
      Points less = bent(), more = bent();
      less[p][axis] -= step;
      more[p][axis] += step;
      const double slope = (length_of(cable, more) - length_of(cable, less)) / (2.0 * step);
      EXPECT_NEAR(state.slope[p][axis], slope, 1e-9);
      EXPECT_NEAR(state.force[p][axis], -tension * slope, 1e-9 * tension);
    }
  }
}

TEST(Cable, ActuatorTensionIsMetWithALawThatDependsOnTension) {
  Cable cable = cable_through(4, 0.0);
  cable.friction.law = friction::Law::Matte;
  cable.friction.coefficients = {0.3, 0.75, 0.1, 0.06};
  cable.friction.radius_mm = 3.75;
  const CableState state = pull_from_actuator(cable, bent(), 5.0);
  ASSERT_TRUE(state.sound);
  EXPECT_NEAR(state.tension.front(), 5.0, 1e-11);
  EXPECT_TRUE(std::is_sorted(state.tension.rbegin(), state.tension.rend()));
}

TEST(Cable, SaysWhereTheFrictionLawHasNoValue) {
  Cable cable = cable_through(4, 0.0);
  cable.friction.law = friction::Law::Heap;
  cable.friction.coefficients = {50.0, 0.5};  // x >= 1 in Eq 3.8 at the first bend
  EXPECT_FALSE(pull_from_anchor(cable, bent(), 1.0).sound);
}

}  // namespace
}  // namespace softgrip::gdfe
