// SPDX-License-Identifier: Apache-2.0
// The iteration as a whole: the preconditioner on different axes, Hooke's bar, a cable's length, what goes together.
#include <gtest/gtest.h>

#include <stdexcept>

#include "meshes.hpp"
#include "softgrip/gdfe/solver.hpp"

namespace softgrip::gdfe {
namespace {

using testing::held_block;
using testing::idle_task;

TEST(Preconditioner, AppliesTheInverseOfEveryAxisOwnMatrix) {
  Problem problem = held_block({3, 2, 2}, {1.0, 0.8, 1.2}, 2.0, 0.3);
  problem.maps[1] = testing::shared_maps(problem.rest, [](const auto& at) { return at(0) > 0.0 && at(1) > 0.0; })[0];
  std::vector<Element> elements;
  elements.reserve(static_cast<std::size_t>(problem.hexes.rows()));
  for (Eigen::Index e = 0; e < problem.hexes.rows(); ++e) {
    elements.push_back(make_element(corners_of(problem.rest, problem.hexes, e)));
  }
  Settings settings;
  settings.single_precision_factor = false;
  Preconditioner preconditioner(problem, elements, settings);
  const Unknowns& unknowns = preconditioner.unknowns();
  EXPECT_FALSE(unknowns.has_shared_dof_map);
  EXPECT_EQ(preconditioner.shared_dof_map(2), 0U);
  std::vector<double> values(unknowns.count);
  std::array<Eigen::VectorXd, 3> expected;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const AxisUnknowns& a = unknowns.axes[axis];
    const Eigen::VectorXd right = Eigen::VectorXd::Random(static_cast<Eigen::Index>(a.size));
    expected[axis] = testing::dense_laplacian(problem, static_cast<int>(axis)).llt().solve(right);
    for (std::size_t i = 0; i < a.dof.size(); ++i) {
      if (a.dof[i] >= 0) values[a.offset + static_cast<std::size_t>(a.dof[i])] = right(problem.maps[axis][i]);
    }
  }
  preconditioner.apply(values);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const AxisUnknowns& a = unknowns.axes[axis];
    for (std::size_t i = 0; i < a.dof.size(); ++i) {
      if (a.dof[i] >= 0) {
        EXPECT_NEAR(values[a.offset + static_cast<std::size_t>(a.dof[i])], expected[axis](problem.maps[axis][i]),
                    1e-12);
      }
    }
  }
}

// Without lateral strain (nu = 0) a bar is a spring of stiffness E A / l, E = 2 mu.
TEST(Solver, PullsABarByHookesLaw) {
  const Problem problem = held_block({4, 2, 2}, {1.0, 1.0, 1.0}, 1.5, 0.0);
  Solver solver(problem, Settings{});
  Task task = idle_task(problem);
  const double force = 1e-3;
  for (Eigen::Index i = 0; i < problem.rest.rows(); ++i) {
    if (problem.rest(i, 0) < 4.0) continue;
    const auto is_edge = [](double at) { return at == 0.0 || at == 2.0; };
    const double share = (is_edge(problem.rest(i, 1)) ? 0.25 : 0.5) * (is_edge(problem.rest(i, 2)) ? 0.25 : 0.5);
    task.load(i, 0) = force * share;
  }
  task.tolerance = 1e-9;
  const Outcome outcome = solver.solve(task, Nodes::Zero(problem.rest.rows(), 3), {});
  ASSERT_TRUE(outcome.converged);
  const double expected = force * 4.0 / (2.0 * 1.5 * 4.0);
  for (Eigen::Index i = 0; i < problem.rest.rows(); ++i) {
    EXPECT_NEAR(outcome.displacement(i, 0), expected * problem.rest(i, 0) / 4.0, 1e-3 * expected);
  }
  EXPECT_NEAR(outcome.reaction.col(0).sum(), -force, 1e-8);
}

// A frictionless cable along the bar's axis, from its middle row: pulled in by a length it holds the bar with E A u /
// l.
TEST(Solver, DrivesACableToItsLength) {
  Problem problem = held_block({4, 2, 2}, {1.0, 1.0, 1.0}, 1.5, 0.0);
  Cable cable;
  cable.friction.law = friction::Law::Capstan;
  cable.points.resize(2);
  cable.points[0].fixed = {-1.0, 1.0, 1.0};
  for (Eigen::Index i = 0; i < problem.rest.rows(); ++i) {
    if (problem.rest(i, 0) < 4.0) continue;
    const auto is_edge = [](double at) { return at == 0.0 || at == 2.0; };
    cable.points[1].nodes.push_back(static_cast<std::int32_t>(i));
    cable.points[1].weights.push_back((is_edge(problem.rest(i, 1)) ? 0.25 : 0.5) *
                                      (is_edge(problem.rest(i, 2)) ? 0.25 : 0.5));
  }
  problem.cables = {cable};
  Solver solver(problem, Settings{});
  Task task = idle_task(problem);
  const double shortening = 1e-3;
  task.drives = {{true, shortening}};
  task.tolerance = 1e-8;
  task.length_tolerance = 1e-12;
  const Outcome outcome = solver.solve(task, Nodes::Zero(problem.rest.rows(), 3), {0.0});
  ASSERT_TRUE(outcome.converged);
  EXPECT_NEAR(outcome.shortening[0], shortening, 1e-12);
  const double expected = 2.0 * 1.5 * 4.0 * shortening / 4.0;
  EXPECT_NEAR(outcome.anchor_tension[0], expected, 1e-3 * expected);
}

TEST(Solver, RefusesSectionsWhereContactForcesWouldNotKnowThem) {
  Problem problem = held_block({4, 1, 1}, {1.0, 1.0, 1.0}, 1.0, 0.3);
  Settings settings;
  settings.sections_after = 2;
  EXPECT_NO_THROW(Solver(problem, settings));
  Problem touched = problem;
  touched.surroundings.obstacles.resize(1);
  EXPECT_THROW(Solver(touched, settings), std::invalid_argument);
  Problem different = problem;
  different.maps[2] = testing::shared_maps(problem.rest, [](const auto& at) { return at(0) > 0.0 && at(2) > 0.0; })[2];
  EXPECT_THROW(Solver(different, settings), std::invalid_argument);
}

}  // namespace
}  // namespace softgrip::gdfe
