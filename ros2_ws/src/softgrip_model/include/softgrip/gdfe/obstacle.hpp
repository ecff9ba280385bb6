// SPDX-License-Identifier: Apache-2.0
// Rigid planes, spheres and cylinders: their signed distance, and a node that one of them holds off.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <vector>

namespace softgrip::gdfe {

enum class ObstacleKind : std::uint8_t { Plane = 0, Sphere = 1, Cylinder = 2 };

struct Obstacle {
  ObstacleKind kind = ObstacleKind::Plane;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // on the plane, centre, or on the cylinder's axis
  Eigen::Vector3d axis = Eigen::Vector3d::UnitY();  // unit: normal of the plane towards the body, axis of the cylinder
  double radius = 0.0;
  double friction = 0.0;            // Coulomb's mu
  std::vector<std::int32_t> nodes;  // that may touch it
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

}  // namespace softgrip::gdfe
