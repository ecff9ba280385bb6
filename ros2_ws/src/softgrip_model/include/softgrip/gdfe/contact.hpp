// SPDX-License-Identifier: Apache-2.0
// Nodes of the mesh against rigid planes, spheres and cylinders, with Coulomb friction; no penalty, no refactorisation.
//
// One iteration x <- x + d of the constant-matrix solver becomes, with contact forces lambda on the nodes that touch,
//   d = L^-1 (lambda - g),   gap + n . d >= 0,   lambda_n >= 0,   lambda_n (gap + n . d) = 0,
//   |lambda_t| <= mu lambda_n, and where the inequality is strict no slip since the last converged state.
// lambda is found by projected Gauss-Seidel on the compliance S L^-1 S^T of the touching nodes, whose columns are solved
// for when a node first comes near. At the fixed point d = 0: g = lambda exactly, and no node is inside an obstacle.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

enum class ObstacleKind : std::uint8_t { Plane = 0, Sphere = 1, Cylinder = 2 };

struct Obstacle {
  ObstacleKind kind = ObstacleKind::Plane;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // on the plane, centre, or on the cylinder's axis
  Eigen::Vector3d axis = Eigen::Vector3d::UnitY();  // unit: normal of the plane towards the body, axis of the cylinder
  double radius = 0.0;
  double friction = 0.0;                            // Coulomb's mu
  std::vector<std::int32_t> nodes;                  // that may touch it
};

// Signed distance to an obstacle moved by `motion`, and its gradient, the direction away from it.
struct Gap {
  double distance;
  Eigen::Vector3d normal;
};
Gap gap_to(const Obstacle& obstacle, const Eigen::Vector3d& motion, const Eigen::Vector3d& point);

// A node that an obstacle holds off.
struct Touch {
  std::int32_t obstacle, node;
  double gap;
  Eigen::Vector3d force;  // on the node
  bool sliding;           // friction is exhausted
};

// What the solver lets the contact see of its unknowns.
struct UnknownsView {
  std::array<const std::vector<std::int32_t>*, 3> dof;  // node -> place within its axis, -1 prescribed
  std::array<std::size_t, 3> offset;                    // of the axis in the state vector
  std::array<std::size_t, 3> same_as;                   // the first axis with the same matrix
  std::function<void(std::size_t axis, double* column)> apply_inverse;  // L^-1 of one axis, in place
  std::array<std::size_t, 3> size;
};

class Contact {
 public:
  Contact() = default;
  Contact(std::vector<Obstacle> obstacles, std::size_t nodes, UnknownsView view);

  bool empty() const { return obstacles_.empty(); }

  // Starts a solve: where obstacles stand, and where they and the mesh stood when sliding was last looked at.
  void begin(const std::vector<Eigen::Vector3d>& motions, const std::vector<Eigen::Vector3d>& motions_before,
             const Nodes& positions_before);

  // Adds the forces of the last iteration to `residual` (-g): steps and changes of lambda then vanish together, and so do
  // the rounding errors of a factor in float.
  void add_last_forces(std::vector<double>& residual) const;

  // position: [node][kStride]. Finds lambda for a step that follows from the residual with the last forces. Adds the change of the forces to
  // `residual` and its motion to `step`.
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

  void gather(const double* position, const std::vector<double>& step);
  void sweep();
  void add_force(std::int32_t node, const Eigen::Vector3d& force, std::vector<double>& residual) const;
  Eigen::Vector3d step_of(const std::vector<double>& step, std::int32_t node) const;
  double compliance(std::size_t axis, std::int32_t pushed, std::int32_t moved);

  std::vector<Obstacle> obstacles_;
  UnknownsView view_;
  std::vector<std::int32_t> place_;                           // node -> its number among all that may touch, -1
  std::vector<std::int32_t> candidates_;
  std::array<std::vector<std::vector<double>>, 3> columns_;   // [axis][candidate]: L^-1 e at all candidates, when known
  std::vector<Eigen::Vector3d> motions_, motions_before_;
  Nodes before_;
  std::vector<Pair> pairs_;
  std::vector<Touch> touches_;
  std::vector<std::vector<Eigen::Vector3d>> last_force_;      // [obstacle][candidate of the obstacle]
  double gap_error_ = 0.0;
};

}  // namespace softgrip::gdfe
