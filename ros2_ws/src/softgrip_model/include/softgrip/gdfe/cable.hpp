// SPDX-License-Identifier: Apache-2.0
// A cable through points of the mesh, sliding with friction; it only ever pulls.
//
// Span k runs from point k to k+1; the first point may have an entry span of fixed direction, the last point is its
// anchor. At point p the tension falls towards the anchor: T_before = Rf(|phi_p|, T_after) T_after, phi_p the angle
// between the directions before and after (Eqs 3.7-3.9). Forces follow the spans.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <vector>

#include "softgrip/friction.hpp"

namespace softgrip::gdfe {

// A point as weights of nodes, or fixed in space when it has none.
struct CablePoint {
  std::vector<std::int32_t> nodes;
  std::vector<double> weights;
  Eigen::Vector3d fixed = Eigen::Vector3d::Zero();
};

struct Cable {
  std::vector<CablePoint> points;
  Eigen::Vector3d entry =
      Eigen::Vector3d::Zero();  // unit, from the first point towards the actuator; zero: no entry span
  friction::Model friction;     // forces in newtons, radius in mm
};

// How the cable lies and pulls at one state of the mesh.
struct CableState {
  std::vector<Eigen::Vector3d> force;  // on each point
  std::vector<Eigen::Vector3d> slope;  // d length / d point
  std::vector<double> tension;         // actuator first, anchor last: one more than there are points with friction
  double length = 0.0;                 // of the spans between points
  double entry_length = 0.0;           // change of the entry span, from its direction
  bool sound = true;                   // the friction law has a value
};

// Tension at the anchor -> state.
CableState pull_from_anchor(const Cable& cable, const std::vector<Eigen::Vector3d>& points, double anchor_tension);

// Tension at the actuator -> state.
CableState pull_from_actuator(const Cable& cable, const std::vector<Eigen::Vector3d>& points, double tension);

}  // namespace softgrip::gdfe
