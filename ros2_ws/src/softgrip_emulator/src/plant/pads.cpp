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
  chain_m_.resize(2 * make.joints() + 2);
  heading_rad_.resize(make.joints());
  finger->chain(finger->q(), chain_m_.data(), heading_rad_.data());
  for (std::size_t link = 0; link < make.joints(); ++link) {
    const double cos = std::cos(heading_rad_[link]), sin = std::sin(heading_rad_[link]);
    for (std::size_t pad = 0; pad < kPadsPerLink; ++pad) {
      const double reach_m = make.link_m[link] * kAlongLink[pad];
      const double depth_m = kDepth[pad] * make.body_height_m;
      const double x = chain_m_[2 * link] + reach_m * cos - depth_m * sin;
      const double y = chain_m_[2 * link + 1] - reach_m * sin - depth_m * cos;
      in_finger_m_.emplace_back(x, y);
      points_m_.push_back(origin_m_ + to_world(x, y));
    }
  }
}

Eigen::Vector2d Pads::lever(std::size_t pad, std::size_t joint) const {
  // Turning closes, i.e. (x, y) goes by (y, -x).
  const double arm_x = in_finger_m_[pad].x() - chain_m_[2 * joint];
  const double arm_y = in_finger_m_[pad].y() - chain_m_[2 * joint + 1];
  return to_world(arm_y, -arm_x);
}

}  // namespace softgrip::plant
