// SPDX-License-Identifier: Apache-2.0
// One bending strip between two links as a geometrically exact beam in the plane (Reissner 1972; Simo 1985). SI units.
//
// Axes: a along the link before, b towards the side that the finger closes to; a turn from a to b closes. The strip
// runs from a = -l/2 to l/2 at rest. Its far link has the pose (u, v, q): where the point of the link that lay on the
// joint has gone, and how far the link has turned. The strip is a chain of bonds: a root in the link before, beam
// elements, a root in the link beyond. Each bond knows three strains and their forces; the nodes between them are the
// strip's own.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cstddef>

#include "softgrip/plant/section.hpp"

namespace softgrip::plant {

using Pose = Eigen::Vector3d;  // (a, b, turn)

constexpr std::size_t kRelaxations = 4;

struct StripMake {
  double length_m, thickness_m, width_m;
  StressLaw law;  // of the printed material
  double poisson;
  double near_root, far_root;  // how much the links give at the strip's ends: 1 as half spaces do, 0 not at all
  double damping_s;            // viscous forces = damping_s times the rate of the elastic ones
  std::array<double, kRelaxations> relaxing_share, relaxing_time_s;  // of the elastic forces, Prony's series
  double softening;  // share of its stiffness that running in takes (Mullins)
};

// What the room does to a strip: how stiff its material is, and how fast it relaxes, against the temperature of its
// data sheet.
struct Room {
  double stiffness = 1.0, pace = 1.0;
};

// What a strip does to its far link: force along (u, v, q), and how it grows against a change of the pose.
struct StripForce {
  Eigen::Vector3d force;  // [N, N, N m]
  Eigen::Matrix3d tangent;
};

class Strip {
 public:
  explicit Strip(const StripMake& make);

  // Force and tangent of a step of `dt_s` from where everything is, the strip's own nodes eliminated.
  StripForce condense(double dt_s, const Room& room = {});

  // Move the far link by a change of its pose; the nodes follow by this share of what the step asks of them.
  void move(const Pose& change, double share, double dt_s, const Room& room = {});

  const Pose& pose() const { return far_; }
  // The middle of the strip, where a marker on its flank is.
  Eigen::Vector2d middle_m() const { return nodes_[kElements / 2].head<2>(); }

  // What the strip will not forget: the largest energy [J/m] that each of its elements has held.
  static constexpr std::size_t kMemory = 2;
  void restore(const double* energy_j_m);
  void recall(double* energy_j_m) const;

 private:
  static constexpr std::size_t kElements = kMemory, kNodes = kElements + 1, kBonds = kElements + 2;

  struct Bond {
    Eigen::Vector3d force = Eigen::Vector3d::Zero();  // elastic [N, N, N m]
    // parts of it that have relaxed
    std::array<Eigen::Vector3d, kRelaxations> relaxed = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(),
                                                         Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    Eigen::Matrix3d tangent = Eigen::Matrix3d::Zero();
    Eigen::Matrix<double, 3, 6> shape = Eigen::Matrix<double, 3, 6>::Zero();  // strains by (pose before, pose behind)
    double length_m = 1.0;
    double energy_j_m = 0.0, largest_j_m = 0.0;  // held now, and ever
  };

  double intact(const Bond& bond) const;
  void measure();
  void measure_near_root(Bond& bond) const;
  void measure_element(Bond& bond, const Pose& before, const Pose& behind) const;
  void measure_far_root(Bond& bond) const;

  StripMake make_;
  Section section_;
  Eigen::Matrix3d near_stiffness_, far_stiffness_;
  double shear_flexibility_;  // 1 / (G A) [1/N]
  std::array<Pose, kNodes> nodes_;
  Pose far_ = Pose::Zero();
  std::array<Bond, kBonds> bonds_;
  // Left by condense: what a node moves by itself, and with the node behind it.
  std::array<Eigen::Vector3d, kNodes> own_;
  std::array<Eigen::Matrix3d, kNodes> with_next_;
};

}  // namespace softgrip::plant
