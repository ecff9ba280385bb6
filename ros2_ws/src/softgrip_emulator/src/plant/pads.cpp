// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/pads.hpp"

#include <cmath>

namespace softgrip::plant {

namespace {

constexpr double kAlongLink[kPadsPerLink] = {0.3, 0.55, 0.8, 1.0};
// The pad at a link's end lies less deep, where the groove is; as a share of the body's height.
constexpr double kDepth[kPadsPerLink] = {1.0, 1.0, 1.0, 0.55};

}  // namespace

Pads::Pads(const SlotPlace& place) : origin_m_(place.along_m, place.out_m) {
  const double cos = std::cos(place.rest_angle_rad), sin = std::sin(place.rest_angle_rad);
  forward_ = {place.side * cos, sin};
  inward_ = {-place.side * sin, cos};
}

void Pads::follow(const Finger* finger) {
  in_finger_m_.clear();
  points_m_.clear();
  if (finger == nullptr) return;
  const FingerMake& make = finger->make();
  finger->shape(shape_);
  for (std::size_t link = 0; link < make.joints(); ++link) {
    const double cos = std::cos(shape_.heading_rad[link]), sin = std::sin(shape_.heading_rad[link]);
    for (std::size_t pad = 0; pad < kPadsPerLink; ++pad) {
      const double reach_m = make.link_m()[link] * kAlongLink[pad];
      const double depth_m = kDepth[pad] * make.body_height_m;
      const double x = shape_.origins[link].x() + reach_m * cos - depth_m * sin;
      const double y = shape_.origins[link].y() - reach_m * sin - depth_m * cos;
      in_finger_m_.emplace_back(x, y);
      points_m_.push_back(origin_m_ + to_world(x, y));
    }
  }
}

Eigen::Vector2d Pads::lever(std::size_t pad, std::size_t freedom) const {
  const std::size_t joint = freedom / kFreedoms;
  if (freedom % kFreedoms == 2) {
    // Turning closes, i.e. (x, y) goes by (y, -x).
    const Eigen::Vector2d arm = in_finger_m_[pad] - shape_.origins[joint];
    return to_world(arm.y(), -arm.x());
  }
  const double heading = joint == 0 ? 0.0 : shape_.heading_rad[joint - 1];
  const double cos = std::cos(heading), sin = std::sin(heading);
  return freedom % kFreedoms == 0 ? to_world(cos, -sin) : to_world(-sin, -cos);
}

}  // namespace softgrip::plant
