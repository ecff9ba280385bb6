// SPDX-License-Identifier: Apache-2.0
// The equations of one state on a path, linearised: what Newton solves for assumed states of bends and contacts.
#pragma once

#include <Eigen/LU>
#include <vector>

#include "softgrip/finger_contact.hpp"
#include "softgrip/finger_solver.hpp"

namespace softgrip::finger {

enum class Slide : std::int8_t { Back = -1, Stuck = 0, Pulled = 1 };

struct PathStep {
  PerJoint<double> angle_rad{};                // of the joints; in mode F of the frames that meet there
  PerJoint<std::array<double, 2>> shift_mm{};  // mode F
  PerJoint<double> seen_rad{};                 // from the middle of one link to that of the next
  PerJoint<double> strip_bend_rad{};
  PerPoint<double> phi_rad{};
  std::array<double, 2> tip_mm{};
  PerSpan<double> log_tension{};
  PerPoint<Slide> slide{};
  PerPoint<double> slip_mm{};                  // cable that has passed each point towards the actuator
  std::array<double, kMaxContacts> force_N{};  // N mm at a joint limit
  std::array<double, kMaxContacts> gap_mm{};   // rad at a joint limit
  std::array<bool, kMaxContacts> touches{};
  double pulled_mm = 0.0;
  int iterations = 0;
  std::uint32_t status = kSlack;
};

// Where each unknown sits: joints (the angle; in mode F also the shift), ln tensions, contact forces. Rows: balances of
// the joints, bends, the control, contacts.
struct PathLayout {
  int joints, per_joint, contacts;

  PathLayout(const Finger& finger, std::size_t touching)
      : joints(finger.design.joints), per_joint(finger.is_flexure() ? 3 : 1), contacts(static_cast<int>(touching)) {}

  int points() const { return 2 * joints; }
  int spans() const { return 2 * joints + 1; }
  int joint(int j) const { return per_joint * j; }
  int tension(int i) const { return per_joint * joints + i; }
  int force(int c) const { return tension(spans()) + c; }
  int size() const { return force(contacts); }

  // Rows; balances have the joints' places.
  int bend(int i) const { return tension(i); }
  int control() const { return tension(points()); }
};

struct PathSystem {
  static constexpr int kMaxUnknowns = 3 * kMaxJoints + kMaxSpans + kMaxContacts;
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxUnknowns, kMaxUnknowns>;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxUnknowns, 1>;

  Matrix jacobian;
  Vector residual;
  std::uint8_t friction_status = 0;
  // The states that the iterate asks for, whatever was assumed.
  PerPoint<Slide> required_slide{};
  std::array<bool, kMaxContacts> touches{};

  // Changes the states that the iterate contradicts, all or only the first; returns how many.
  int revise(PathStep& at, const PathLayout& layout, bool all) const;
  // Lets the stuck bends go whose ratio is beyond what friction holds; returns how many.
  int give_way(PathStep& at, const PathLayout& layout) const;
};

// At an iterate, whose slips, gaps, angles, tip and pulled length are filled in; `before` is the state that slips are
// counted from.
PathSystem path_system(const Finger& finger, const std::vector<Contact>& contacts, double compliance,
                       const PathStep& before, PathStep& at, Control control, double target);

}  // namespace softgrip::finger
