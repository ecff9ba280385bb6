// SPDX-License-Identifier: Apache-2.0
// The rigorous law's tangent is the derivative of its forces, also where principal stretches are equal; with a cable's
// friction it leads to the same equilibrium as the constant matrix, by a Newton step's strides.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "meshes.hpp"
#include "softgrip/gdfe/ogden.hpp"
#include "softgrip/gdfe/solver.hpp"

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

// A strip of rubber (nu = 0.49) that a cable bends which runs along its upper side, rubbing at every bend.
Problem strip_with_cable() {
  Problem problem = testing::held_block({8, 2, 1}, {1.0, 0.5, 1.0}, 1.0, 0.49);
  const double shear_modulus = 1.0, bulk_modulus = 49.67;
  problem.ogden = {OgdenMaterial{{shear_modulus}, {2.0}, bulk_modulus}};
  problem.matrix_weight.assign(problem.matrix_weight.size(), 2.0 * (shear_modulus + bulk_modulus / 3.0));
  Cable cable;
  cable.entry = Eigen::Vector3d(-1.0, 0.0, 0.0);
  cable.friction.law = friction::Law::Capstan;
  cable.friction.coefficients = {0.9};
  cable.friction.radius_mm = 1.0;
  for (const double x : {0.0, 2.0, 4.0, 6.0, 8.0}) {
    CablePoint point;
    for (Eigen::Index i = 0; i < problem.rest.rows(); ++i) {
      if (problem.rest(i, 0) != x || problem.rest(i, 1) != 1.0) continue;
      point.nodes.push_back(static_cast<std::int32_t>(i));
      point.weights.push_back(0.5);
    }
    cable.points.push_back(point);
  }
  problem.cables = {cable};
  return problem;
}

Outcome pulled(const Problem& problem, int max_tangent_unknowns, const Nodes& start, double tension, double length) {
  Settings settings;
  settings.law = Law::Rigorous;
  settings.window = 20;
  settings.max_tangent_unknowns = max_tangent_unknowns;
  Solver solver(problem, settings);
  Task task = testing::idle_task(problem);
  task.drives = {{true, length}};
  task.tolerance = 1e-9;
  task.length_tolerance = 1e-9;
  task.max_iterations = 20000;
  return solver.solve(task, start, {tension});
}

TEST(Tangent, LeadsACableWithFrictionToTheEquilibriumOfTheConstantMatrix) {
  const Problem problem = strip_with_cable();
  const Nodes rest = Nodes::Zero(problem.rest.rows(), 3);
  const Outcome by_constant = pulled(problem, 0, rest, 0.0, 0.4), by_tangent = pulled(problem, 20000, rest, 0.0, 0.4);
  ASSERT_TRUE(by_constant.converged);
  ASSERT_TRUE(by_tangent.converged);
  EXPECT_LT((by_constant.displacement - by_tangent.displacement).cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_NEAR(by_constant.anchor_tension[0], by_tangent.anchor_tension[0], 1e-6 * by_constant.anchor_tension[0]);
  EXPECT_GT(by_tangent.tension[0].front(), 1.5 * by_tangent.anchor_tension[0]);  // it does rub
  EXPECT_LT(4 * by_tangent.iterations, by_constant.iterations);
  EXPECT_EQ(by_tangent.unstable_modes, -1);
}

TEST(Tangent, ClosesInOnAnEquilibriumByNewtonsStrides) {
  const Problem problem = strip_with_cable();
  const Outcome before = pulled(problem, 20000, Nodes::Zero(problem.rest.rows(), 3), 0.0, 0.39);
  const Outcome after = pulled(problem, 20000, before.displacement, before.anchor_tension[0], 0.4);
  ASSERT_TRUE(before.converged && after.converged);
  ASSERT_GT(after.history.size(), 3U);
  EXPECT_LT(after.history[3], 1e-5);  // 2e-4 where a cable's friction stays out of the tangent
}

}  // namespace
}  // namespace softgrip::gdfe
