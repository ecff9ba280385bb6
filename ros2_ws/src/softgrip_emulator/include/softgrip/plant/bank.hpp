// SPDX-License-Identifier: Apache-2.0
// All mounted fingers, and what others see of them in arrays (finger F, joint J), rows padded with zeros.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "softgrip/plant/finger.hpp"

namespace softgrip::plant {

// What products do to the links: force on the poses [N, N, N m a joint], (F, 3 J), and its stiffness against their
// motion, (F, 3 J, 3 J).
struct JointLoad {
  std::vector<double> force, stiffness;
};

class FingerBank {
 public:
  // A slot without a finger has a tendon that pulls on nothing.
  explicit FingerBank(const std::vector<std::optional<FingerMake>>& makes);
  FingerBank(const FingerBank&) = delete;
  FingerBank& operator=(const FingerBank&) = delete;

  // Advance by one step [s] with the cable wound on each spool since mounting [m], (F).
  void step(const double* wound_m, double dt_s, const JointLoad* load);

  // Take over the state of a finger that stays mounted.
  void adopt(const FingerBank& before, std::size_t slot);

  std::size_t slots() const { return fingers_.size(); }
  std::size_t joints() const { return joints_; }
  const Finger* finger(std::size_t slot) const { return fingers_[slot].get(); }
  Finger* finger(std::size_t slot) { return fingers_[slot].get(); }

  std::vector<double> q, joint_speed;  // (F, J)
  std::vector<double> span_tension_n;  // (F, 2 J)
  std::vector<double> tension_n;       // (F)
  std::vector<double> slack_m;         // (F) loose cable, set by whoever mounts
  std::vector<unsigned char> broken;   // (F) whether the tendon is
  Conditions conditions;               // friction of the cable guides, the room

 private:
  std::size_t joints_ = 1;
  std::vector<std::unique_ptr<Finger>> fingers_;
};

}  // namespace softgrip::plant
