// SPDX-License-Identifier: Apache-2.0
// One-sided, frictionless contacts of a planar finger: each keeps a gap from becoming negative.
#pragma once

#include "softgrip/finger_design.hpp"

namespace softgrip::finger {

enum class ContactKind : std::uint8_t {
  JointLimit = 0,  // the object keeps a joint from closing beyond an angle; force is a moment [N mm]
  Plane = 1,       // a point of the finger stays on one side of a plane
  Circle = 2,      // a point of the finger stays outside a circle: a cylinder across the plane, or the cut of a sphere
};

struct Contact {
  ContactKind kind = ContactKind::JointLimit;
  int index = 0;                  // joint, or the link that carries the point
  double along_mm = 0.0;          // from the link's joint to the point
  double limit_rad = 0.0;         // JointLimit
  double x_mm = 0.0, y_mm = 0.0;  // Plane: unit normal, towards the free side; Circle: centre; in the base frame
  double size_mm = 0.0;           // Plane: normal . p >= size; Circle: radius
};

inline constexpr int kMaxContacts = 8;

}  // namespace softgrip::finger
