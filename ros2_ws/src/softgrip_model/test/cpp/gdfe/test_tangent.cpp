// SPDX-License-Identifier: Apache-2.0
// The rigorous law's tangent is the derivative of its forces, also where principal stretches are equal.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "softgrip/gdfe/ogden.hpp"

namespace softgrip::gdfe {
namespace {

Nodes unit_cube() {
  Nodes nodes(8, 3);
  for (int a = 0; a < 8; ++a) {
    for (int i = 0; i < 3; ++i) nodes(a, i) = 0.5 * (1 + kCornerSigns[static_cast<std::size_t>(a)][i]);
  }
  return nodes;
}

std::vector<double> placed(const Nodes& nodes) {
  std::vector<double> position(8 * kStride, 0.0);
  for (int a = 0; a < 8; ++a) {
    for (int i = 0; i < 3; ++i)
      position[kStride * static_cast<std::size_t>(a) + static_cast<std::size_t>(i)] = nodes(a, i);
  }
  return position;
}

Eigen::VectorXd forces(const OgdenElements& elements, const std::vector<double>& position) {
  std::vector<double> force(8 * kStride, 0.0), strain(1);
  elements.add_forces(position.data(), force.data(), strain.data(), 0, 1);
  Eigen::VectorXd found(24);
  for (int k = 0; k < 24; ++k)
    found(k) = force[kStride * static_cast<std::size_t>(k / 3) + static_cast<std::size_t>(k % 3)];
  return found;
}

// Principal directions of equal stretches are found less exactly: there the step is longer.
void expect_derivative(const Nodes& moved, double step, double error) {
  Hexes hexes(1, 8);
  hexes << 0, 1, 2, 3, 4, 5, 6, 7;
  const OgdenElements elements(unit_cube(), hexes, {0}, {OgdenMaterial{{-5.5, 2.5, 12.3}, {3.3, 3.7, -4.8}, 400.0}});
  const std::vector<double> at = placed(moved);
  const ElementTangent tangent = elements.tangent(at.data(), 0);
  const double size = tangent.cwiseAbs().maxCoeff();
  for (int k = 0; k < 24; ++k) {
    const std::size_t place = kStride * static_cast<std::size_t>(k / 3) + static_cast<std::size_t>(k % 3);
    std::vector<double> more = at, less = at;
    more[place] += step;
    less[place] -= step;
    const Eigen::VectorXd slope = (forces(elements, more) - forces(elements, less)) / (2.0 * step);
    EXPECT_LT((tangent.col(k) - slope).cwiseAbs().maxCoeff(), error * size) << "column " << k;
  }
}

TEST(OgdenTangent, IsTheDerivativeOfTheForces) {
  Nodes moved = unit_cube();
  moved.col(0) *= 1.3;
  moved.col(1) *= 0.9;
  for (int a = 0; a < 8; ++a)
    moved.row(a) += 0.03 * Eigen::RowVector3d(std::sin(3.0 * a), std::cos(2.0 * a), std::sin(a));
  expect_derivative(moved, 1e-6, 1e-7);
}

TEST(OgdenTangent, HoldsAtRestAndWhereStretchesAreEqual) {
  expect_derivative(unit_cube(), 1e-4, 2e-6);
  Nodes drawn = unit_cube();
  drawn.col(2) *= 1.4;
  expect_derivative(drawn, 1e-4, 2e-6);
}

}  // namespace
}  // namespace softgrip::gdfe
