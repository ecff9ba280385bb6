// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/bank.hpp"

#include <algorithm>

namespace softgrip::plant {

FingerBank::FingerBank(const std::vector<std::optional<FingerMake>>& makes) {
  for (const auto& make : makes) joints_ = std::max(joints_, make ? make->joints() : 0);
  q.assign(makes.size() * joints_, 0.0);
  joint_speed = q;
  span_tension_n.assign(2 * q.size(), 0.0);
  tension_n.assign(makes.size(), 0.0);
  slack_m = tension_n;
  broken.assign(makes.size(), 0);
  fingers_.resize(makes.size());
  for (std::size_t i = 0; i < makes.size(); ++i) {
    if (!makes[i]) continue;
    slack_m[i] = makes[i]->slack_m;
    const FingerView view{&q[i * joints_], &joint_speed[i * joints_], &span_tension_n[2 * i * joints_], &tension_n[i]};
    fingers_[i] = std::make_unique<Finger>(*makes[i], view);
  }
}

void FingerBank::step(const double* wound_m, double dt_s, const JointLoad* load) {
  for (std::size_t i = 0; i < fingers_.size(); ++i) {
    if (!fingers_[i]) continue;
    FingerLoad on_finger;
    if (load != nullptr) {
      const std::size_t row = kFreedoms * joints_;
      on_finger = {&load->force[i * row], &load->stiffness[i * row * row], row};
    }
    fingers_[i]->step(wound_m[i], slack_m[i], broken[i] != 0, conditions, dt_s, on_finger);
  }
}

void FingerBank::adopt(const FingerBank& before, std::size_t slot) {
  if (fingers_[slot] && before.fingers_[slot]) fingers_[slot]->adopt(*before.fingers_[slot]);
}

}  // namespace softgrip::plant
