// SPDX-License-Identifier: Apache-2.0
// Where on the fingers a product can press: pad points on the inner side of every link, and how poses move them.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "softgrip/plant/finger.hpp"

namespace softgrip::plant {

// Where a finger starts, in the world (along the palm, out of the palm); side +1 = fingers, -1 = thumb.
struct SlotPlace {
  double along_m, out_m, side, rest_angle_rad;
  double across_m;  // out of the grasp plane
};

constexpr std::size_t kPadsPerLink = 4;

// The pads of the finger in one slot.
class Pads {
 public:
  explicit Pads(const SlotPlace& place);

  // Put them where the finger's links are now; null when the slot is empty.
  void follow(const Finger* finger);

  std::size_t count() const { return points_m_.size(); }
  // In the world [m].
  const Eigen::Vector2d& point(std::size_t pad) const { return points_m_[pad]; }
  // Freedoms that move a pad: the poses of its own link and of the links before.
  static std::size_t freedoms_of(std::size_t pad) { return kFreedoms * (pad / kPadsPerLink + 1); }
  // How a pad moves with one of them, in the world [m/m or m/rad].
  Eigen::Vector2d lever(std::size_t pad, std::size_t freedom) const;

 private:
  Eigen::Vector2d to_world(double x, double y) const { return x * forward_ - y * inward_; }

  Eigen::Vector2d origin_m_, forward_, inward_;
  FingerShape shape_;                                    // in the finger's base frame
  std::vector<Eigen::Vector2d> in_finger_m_, points_m_;  // (P): in the finger's base frame, in the world
};

}  // namespace softgrip::plant
