// SPDX-License-Identifier: Apache-2.0
// Distances of obstacles, and contact forces as the solution of a complementarity problem, with a dense L.
#include <gtest/gtest.h>

#include "meshes.hpp"
#include "softgrip/gdfe/contact.hpp"

namespace softgrip::gdfe {
namespace {

Obstacle obstacle(ObstacleKind kind) {
  return {kind, {0.2, -0.3, 0.1}, Eigen::Vector3d(1.0, 2.0, -2.0) / 3.0, 0.5, 0.0, {}};
}

TEST(Gap, IsTheDistanceFromTheSurface) {
  const Eigen::Vector3d motion(0.05, 0.1, -0.2);
  const Obstacle plane = obstacle(ObstacleKind::Plane), sphere = obstacle(ObstacleKind::Sphere),
                 cylinder = obstacle(ObstacleKind::Cylinder);
  const Eigen::Vector3d side = plane.axis.unitOrthogonal(), origin = plane.point + motion;
  EXPECT_NEAR(gap_to(plane, motion, origin + 0.7 * plane.axis + 3.0 * side).distance, 0.7, 1e-14);
  EXPECT_NEAR(gap_to(sphere, motion, origin + 2.0 * side).distance, 1.5, 1e-14);
  EXPECT_NEAR(gap_to(sphere, motion, origin + 0.1 * side).distance, -0.4, 1e-14);
  EXPECT_NEAR(gap_to(cylinder, motion, origin + 4.0 * cylinder.axis + 0.9 * side).distance, 0.4, 1e-14);
}

TEST(Gap, NormalIsTheGradientOfTheDistance) {
  const Eigen::Vector3d motion(0.05, 0.1, -0.2), point(1.1, 0.4, -0.6);
  const double step = 1e-6;
  for (const ObstacleKind kind : {ObstacleKind::Plane, ObstacleKind::Sphere, ObstacleKind::Cylinder}) {
    const Obstacle body = obstacle(kind);
    Eigen::Vector3d slope;
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d aside = step * Eigen::Vector3d::Unit(axis);
      slope[axis] =
          (gap_to(body, motion, point + aside).distance - gap_to(body, motion, point - aside).distance) / (2.0 * step);
    }
    EXPECT_TRUE(gap_to(body, motion, point).normal.isApprox(slope, 1e-8));
  }
}

// A block of 3 x 2 x 2 unit cubes, held at x = 0, whose nodes at y = 0 stand on a plane that has come up by 0.02.
class ContactOnABlock : public ::testing::TestWithParam<double> {
 protected:
  static constexpr double kLift = 0.02;

  ContactOnABlock() : problem_(testing::held_block({3, 2, 2}, Eigen::Vector3d::Ones(), 2.0, 0.3)) {
    Obstacle plane;
    plane.friction = GetParam();
    for (Eigen::Index i = 0; i < problem_.rest.rows(); ++i) {
      if (problem_.rest(i, 1) == 0.0 && problem_.rest(i, 0) > 0.0) plane.nodes.push_back(static_cast<std::int32_t>(i));
    }
    problem_.surroundings.obstacles = {plane};
    for (Eigen::Index e = 0; e < problem_.hexes.rows(); ++e) {
      elements_.push_back(make_element(corners_of(problem_.rest, problem_.hexes, e)));
    }
    Settings settings;
    settings.single_precision_factor = false;
    preconditioner_ = std::make_unique<Preconditioner>(problem_, elements_, settings);
  }

  const std::vector<std::int32_t>& nodes() const { return problem_.surroundings.obstacles[0].nodes; }
  std::size_t at(int axis, std::int32_t node) const {
    const AxisUnknowns& a = preconditioner_->unknowns().axes[static_cast<std::size_t>(axis)];
    return a.offset + static_cast<std::size_t>(a.dof[static_cast<std::size_t>(node)]);
  }

  Problem problem_;
  std::vector<Element> elements_;
  std::unique_ptr<Preconditioner> preconditioner_;
};

TEST_P(ContactOnABlock, ForcesSolveTheComplementarityProblemWithFriction) {
  Contact contact(problem_.surroundings.obstacles, problem_.rest, *preconditioner_);
  Task task = testing::idle_task(problem_);
  task.motions = {{0.003, kLift, 0.0}};  // up, and a little along the body
  task.motions_before = {Eigen::Vector3d::Zero()};
  contact.set_task(task);
  const std::size_t count = preconditioner_->unknowns().count;
  std::vector<double> residual(count, 0.0), step(count, 0.0);
  contact.resolve(testing::strided(problem_.rest).data(), residual, step);

  // the step is L^-1 of the forces, by a dense factor
  Eigen::MatrixXd force = Eigen::MatrixXd::Zero(problem_.rest.rows(), 3);
  for (const Touch& touch : contact.touches()) force.row(touch.node) = touch.force;
  for (int axis = 0; axis < 3; ++axis) {
    const DofMap& map = problem_.maps[static_cast<std::size_t>(axis)];
    Eigen::VectorXd right(1 + *std::max_element(map.begin(), map.end()));
    for (std::size_t i = 0; i < map.size(); ++i) {
      if (map[i] >= 0) right(map[i]) = force(static_cast<Eigen::Index>(i), axis);
    }
    const Eigen::VectorXd moved = testing::dense_laplacian(problem_, axis).llt().solve(right);
    for (std::size_t i = 0; i < map.size(); ++i) {
      if (map[i] >= 0) EXPECT_NEAR(step[at(axis, static_cast<std::int32_t>(i))], moved(map[i]), 1e-9);
    }
  }
  // lambda_n >= 0, gap >= 0, one of them zero; |lambda_t| <= mu lambda_n, and no slip where it is less
  ASSERT_FALSE(contact.touches().empty());
  const double friction = GetParam(), largest = force.cwiseAbs().maxCoeff();
  for (const std::int32_t node : nodes()) {
    const double normal = force(node, 1), gap = step[at(1, node)] - kLift;
    const Eigen::Vector2d tangential(force(node, 0), force(node, 2));
    const Eigen::Vector2d slip(step[at(0, node)] - 0.003, step[at(2, node)]);
    EXPECT_GE(normal, 0.0);
    EXPECT_GT(gap, -1e-8);
    EXPECT_LT(std::min(normal / largest, gap / kLift), 1e-6);
    EXPECT_LE(tangential.norm(), friction * normal + 1e-9 * largest);
    const bool is_stuck = tangential.norm() < (1.0 - 1e-6) * friction * normal;
    if (is_stuck) EXPECT_LT(slip.norm(), 1e-6);
    if (friction > 0.0 && normal > 0.0 && !is_stuck) EXPECT_LT(tangential.dot(slip), 0.0);  // against the slip
  }
}

INSTANTIATE_TEST_SUITE_P(Coulomb, ContactOnABlock, ::testing::Values(0.0, 0.1, 2.0));

}  // namespace
}  // namespace softgrip::gdfe
