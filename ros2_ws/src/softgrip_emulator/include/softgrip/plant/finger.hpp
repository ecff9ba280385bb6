// SPDX-License-Identifier: Apache-2.0
// One mounted finger: links, the strips between them, and the tendon that closes it. SI units.
//
// Links are rigid; every strip is a beam (strip.hpp), so a link can shift and turn against the one before. Motion is
// overdamped (a finger of soft TPU weighs ten grams), so the poses follow first-order equations; they are stepped
// linearly implicit because strips, tendon, groove stops and contacts are stiff.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <cstddef>
#include <vector>

#include "softgrip/plant/strip.hpp"
#include "softgrip/plant/tendon.hpp"

namespace softgrip::plant {

// A link's pose against the link before: along, inward, turn.
constexpr std::size_t kFreedoms = 3;
constexpr std::size_t kMaxJoints = 6;

// What a finger is made of (plant/truth.py explains the values).
struct FingerMake {
  std::vector<StripMake> strips;  // n
  TendonMake tendon;
  double body_height_m, slack_m;

  std::size_t joints() const { return strips.size(); }
  const std::vector<double>& link_m() const { return tendon.link_m; }
};

// What is so for all fingers: the room, and friction against that of new guides.
struct Conditions {
  double friction_scale = 1.0;
  Room room;
};

// Where the bank keeps what others see of a finger.
struct FingerView {
  double* q;               // (n) joint angles [rad]
  double* joint_speed;     // (n) [rad/s]
  double* span_tension_n;  // (2 n) after each routing contact, spool to tip
  double* tension_n;       // at the spool
};

// Force on the poses from outside, (3 n) [N, N, N m a joint], and its stiffness against their motion, (3 n, 3 n) in
// rows `stride` apart; null when nothing touches the finger.
struct FingerLoad {
  const double* force = nullptr;
  const double* stiffness = nullptr;
  std::size_t stride = 0;
};

// Where a finger's points are in its base frame [m], and the directions of its links [rad].
struct FingerShape {
  std::vector<Eigen::Vector2d> joints;   // n + 1: middles of the strips, and the tip
  std::vector<Eigen::Vector2d> origins;  // n: where each link's end of its joint has gone
  std::vector<double> heading_rad;       // n
};

class Finger {
 public:
  Finger(FingerMake make, FingerView view);

  // One step [s] with `wound_m` of cable wound on the spool since mounting, `slack_m` of it loose.
  void step(double wound_m, double slack_m, bool broken, const Conditions& conditions, double dt_s,
            const FingerLoad& load);

  // Become what another copy of this finger is.
  void adopt(const Finger& before);

  // How much cable the present shape takes in [m].
  double pulled_length_m() const { return tendon_.pulled_length_m(); }

  // What it will not forget, mounted or not: strips (2 n), then the tendon.
  std::vector<double> recall() const;
  void restore(const std::vector<double>& memory);

  // The shape now, or as it was `ago_s` before by the speeds of the last step.
  void shape(FingerShape& shape, double ago_s = 0.0) const;

  const FingerMake& make() const { return make_; }

 private:
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kFreedoms * kMaxJoints, 1>;
  using Matrix =
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kFreedoms * kMaxJoints, kFreedoms * kMaxJoints>;

  void solve(const Tendon::Pull& pull, double dt_s, const FingerLoad& load, const Room& room);
  double move(double dt_s, const Room& room);

  FingerMake make_;
  FingerView view_;
  std::vector<Strip> strips_;  // n
  Tendon tendon_;
  std::vector<double> stop_rad_;                   // n
  std::vector<Pose> speed_;                        // n: of the links
  std::vector<Eigen::Vector2d> middle_speed_m_s_;  // n: of the strips' middles
  Vector force_, change_;
  Matrix matrix_;
  Eigen::PartialPivLU<Matrix> factors_;
};

}  // namespace softgrip::plant
