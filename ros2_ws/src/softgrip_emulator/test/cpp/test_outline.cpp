// SPDX-License-Identifier: Apache-2.0
// Distances from a rounded rectangle, by the nearest of many points on it.
#include <gtest/gtest.h>

#include "softgrip/plant/outline.hpp"

namespace softgrip::plant {
namespace {

Product bar() {
  return {0.06, 0.04, 0.1, 0.01, false, 0.2, 0.5, 1000.0, 50.0};
}

// Of a point outside, from points every 0.1 mm around the outline.
double nearest_of_many(const Product& p, const Eigen::Vector2d& from) {
  double nearest = 1.0;
  for (int side = 0; side < 4; ++side) {
    const double sx = side % 2 == 0 ? 1.0 : -1.0, sy = side < 2 ? 1.0 : -1.0;
    const Eigen::Vector2d core(p.width_m / 2 - p.corner_m, p.height_m / 2 - p.corner_m);
    for (int i = 0; i <= 2000; ++i) {
      const double share = i / 2000.0, angle = share * M_PI / 2;
      const Eigen::Vector2d corner(core.x() + p.corner_m * std::cos(angle), core.y() + p.corner_m * std::sin(angle));
      const Eigen::Vector2d top(share * core.x(), p.height_m / 2), right(p.width_m / 2, share * core.y());
      for (const Eigen::Vector2d& at : {corner, top, right}) {
        nearest = std::min(nearest, (Eigen::Vector2d(sx * at.x(), sy * at.y()) - from).norm());
      }
    }
  }
  return nearest;
}

TEST(Outline, DistanceIsToTheNearestPoint) {
  const Outline outline(bar(), 0.0, 0.02);
  ASSERT_TRUE(outline.met());
  for (const Eigen::Vector2d& from :
       {Eigen::Vector2d(0.05, 0.01), Eigen::Vector2d(-0.04, 0.035), Eigen::Vector2d(0.0, -0.06)}) {
    EXPECT_NEAR(outline.nearest(from).distance_m, nearest_of_many(bar(), from), 1e-6);
  }
  EXPECT_NEAR(outline.nearest({0.025, 0.0}).distance_m, -0.005, 1e-12);
}

TEST(Outline, NormalIsTheGradientOfTheDistance) {
  const Outline outline(bar(), 0.0, 0.02);
  const double step = 1e-7;
  for (const Eigen::Vector2d& from :
       {Eigen::Vector2d(0.05, 0.01), Eigen::Vector2d(-0.04, 0.035), Eigen::Vector2d(0.028, -0.001)}) {
    for (int axis = 0; axis < 2; ++axis) {
      const Eigen::Vector2d aside = step * Eigen::Vector2d::Unit(axis);
      const double slope =
          (outline.nearest(from + aside).distance_m - outline.nearest(from - aside).distance_m) / (2 * step);
      EXPECT_NEAR(outline.nearest(from).normal[axis], slope, 1e-6);
    }
  }
}

TEST(Outline, ABallIsThinnerAwayFromItsMiddle) {
  Product ball{0.06, 0.06, 0.06, 0.03, true, 0.2, 0.5, 1000.0, 50.0};
  const double across_m = 0.028, finger_width_m = 0.02, edge_m = across_m - finger_width_m / 2;
  const double radius_m = std::sqrt(0.03 * 0.03 - edge_m * edge_m);
  EXPECT_NEAR(Outline(ball, across_m, finger_width_m).nearest({0.05, 0.0}).distance_m, 0.05 - radius_m, 1e-12);
  EXPECT_FALSE(Outline(ball, 0.05, finger_width_m).met());
}

}  // namespace
}  // namespace softgrip::plant
