// SPDX-License-Identifier: Apache-2.0
// A product's outline in the grasp plane: a rounded rectangle, for each finger as thick as it is where that one is.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

namespace softgrip::plant {

// One product; `round` is a ball rather than a bar: it gets thinner away from its middle.
struct Product {
  double width_m, height_m, length_m, corner_m;
  bool round;
  double mass_kg, friction, stiffness_n_per_m, crush_n;
};

struct Nearest {
  double distance_m;       // negative inside
  Eigen::Vector2d normal;  // outward
};

class Outline {
 public:
  // The cross-section that a finger meets which stands `across_m` out of the grasp plane.
  Outline(const Product& product, double across_m, double finger_width_m) {
    const double edge_m = std::max(std::abs(across_m) - finger_width_m / 2.0, 0.0);
    const double reach = edge_m / (product.length_m / 2.0);
    // Away from the middle of a ball a finger meets a smaller cross-section; beyond the end it meets nothing.
    double shrink = reach < 1.0 ? 1.0 : 0.0;
    if (product.round) shrink = std::sqrt(std::max(1.0 - reach * reach, 0.0));
    const Eigen::Vector2d half_m(product.width_m / 2.0, product.height_m / 2.0);
    core_m_ = (half_m.array() - product.corner_m) * shrink;
    corner_m_ = product.corner_m * shrink;
    met_ = shrink > 0.0;
  }

  // Whether the finger meets the product at all.
  bool met() const { return met_; }

  // From a point, given from the product's centre [m].
  Nearest nearest(const Eigen::Vector2d& offset_m) const {
    const Eigen::Vector2d from_core = offset_m.cwiseAbs() - core_m_;
    const double deepest = from_core.maxCoeff();
    const Eigen::Vector2d outer = from_core.cwiseMax(0.0);
    const double length = std::sqrt(outer.x() * outer.x() + outer.y() * outer.y());
    Eigen::Vector2d direction;
    if (length > kOnCore_m) {
      direction = outer / length;
    } else {
      direction = Eigen::Vector2d(from_core.x() == deepest ? 1.0 : 0.0, from_core.y() == deepest ? 1.0 : 0.0);
    }
    const Eigen::Vector2d side(offset_m.x() >= 0.0 ? 1.0 : -1.0, offset_m.y() >= 0.0 ? 1.0 : -1.0);
    return {length + std::min(deepest, 0.0) - corner_m_, side.cwiseProduct(direction)};
  }

 private:
  static constexpr double kOnCore_m = 1e-9;
  Eigen::Vector2d core_m_;
  double corner_m_;
  bool met_;
};

}  // namespace softgrip::plant
