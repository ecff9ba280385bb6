// SPDX-License-Identifier: Apache-2.0
// Nodes of the mesh against rigid planes, spheres and cylinders, with Coulomb friction; no penalty, no refactorisation.
//
// One iteration x <- x + d of the constant-matrix solver becomes, with contact forces lambda on the nodes that touch,
//   d = L^-1 (lambda - g),   gap + n . d >= 0,   lambda_n >= 0,   lambda_n (gap + n . d) = 0,
//   |lambda_t| <= mu lambda_n, and where the inequality is strict no slip since the last converged state.
// lambda is found by projected Gauss-Seidel on the compliance S L^-1 S^T of the touching nodes, whose columns are
// solved for when a node first comes near. At the fixed point d = 0: g = lambda exactly, and no node is inside an
// obstacle.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "softgrip/gdfe/preconditioner.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

class Contact {
 public:
  Contact(std::vector<Obstacle> obstacles, const Nodes& rest, Preconditioner& preconditioner);

  // Starts a solve: where obstacles stand, and where they and the mesh stood that slip counts from.
  void set_task(const Task& task);

  // Adds the forces of the last iteration to `residual` (-g): steps and changes of lambda then vanish together, and so
  // do the rounding errors of a factor in float.
  void add_last_forces(std::vector<double>& residual) const;

  // position: [node][kStride]. Finds lambda for a step that follows from the residual with the last forces. Adds the
  // change of the forces to `residual` and its motion to `step`.
  void resolve(const double* position, std::vector<double>& residual, std::vector<double>& step);

  // Largest penetration, or distance at which a force acts, at the positions last looked at.
  double gap_error() const { return gap_error_; }

  const std::vector<Touch>& touches() const { return touches_; }

  double force_squared() const;

 private:
  struct Pair {
    std::int32_t obstacle, node;
    Gap gap;
    Eigen::Vector3d last, force, free_step, slip;  // free_step, slip: with the last iteration's contact forces
    bool sliding;
  };

  void find_pairs(const double* position, const std::vector<double>& step);
  void solve_forces();
  void add_force(std::int32_t node, const Eigen::Vector3d& force, std::vector<double>& residual) const;
  Eigen::Vector3d motion_of(const std::vector<double>& step, std::int32_t node) const;
  double compliance(std::size_t axis, std::int32_t pushed, std::int32_t moved);

  std::vector<Obstacle> obstacles_;
  const Nodes rest_;
  Preconditioner& preconditioner_;
  const Unknowns& unknowns_;
  std::vector<std::int32_t> place_;  // node -> its number among all that may touch, -1
  std::vector<std::int32_t> candidates_;
  std::array<std::vector<std::vector<double>>, 3> columns_;  // [axis][candidate]: L^-1 e at all candidates, when known
  std::vector<Eigen::Vector3d> motions_, motions_before_;
  Nodes before_;
  std::vector<Pair> pairs_;
  std::vector<Touch> touches_;
  std::vector<std::vector<Eigen::Vector3d>> last_force_;  // [obstacle][candidate of the obstacle]
  double gap_error_ = 0.0;
};

}  // namespace softgrip::gdfe
