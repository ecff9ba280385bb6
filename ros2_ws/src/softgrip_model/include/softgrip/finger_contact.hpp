// SPDX-License-Identifier: Apache-2.0
// One-sided, frictionless contacts of a planar finger: a gap that may not be negative, with its slopes to the angles.
#pragma once

#include <Eigen/Core>

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

struct Gap {
  double value_mm = 0.0;  // rad for a joint limit
  Eigen::Matrix<double, kMaxJoints, 1> slope = Eigen::Matrix<double, kMaxJoints, 1>::Zero();
  Eigen::Matrix<double, kMaxJoints, kMaxJoints> curvature = Eigen::Matrix<double, kMaxJoints, kMaxJoints>::Zero();
};

inline Gap gap_of(const Contact& contact, const Design& d, const PerJoint<double>& q) {
  Gap gap;
  if (contact.kind == ContactKind::JointLimit) {
    gap.value_mm = contact.limit_rad - q[contact.index];
    gap.slope[contact.index] = -1.0;
    return gap;
  }
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  std::array<Eigen::Vector2d, kMaxJoints> joint;
  double heading = 0.0;
  for (int j = 0; j <= contact.index; ++j) {
    joint[j] = point;
    heading += q[j];
    const double length = j < contact.index ? d.link_mm[j] : contact.along_mm;
    point += length * Eigen::Vector2d(std::cos(heading), -std::sin(heading));
  }
  Eigen::Vector2d normal(contact.x_mm, contact.y_mm);
  double per_radius = 0.0;  // curvature of the surface met
  if (contact.kind == ContactKind::Plane) {
    gap.value_mm = normal.dot(point) - contact.size_mm;
  } else {
    const Eigen::Vector2d from_centre = point - normal;
    const double distance = from_centre.norm();
    gap.value_mm = distance - contact.size_mm;
    normal = from_centre / distance;
    per_radius = 1.0 / distance;
  }
  const Eigen::Vector2d tangent(-normal.y(), normal.x());
  std::array<Eigen::Vector2d, kMaxJoints> turn;  // d point / dq
  for (int j = 0; j <= contact.index; ++j) {
    const Eigen::Vector2d arm = point - joint[j];
    turn[j] = {arm.y(), -arm.x()};
    gap.slope[j] = normal.dot(turn[j]);
  }
  for (int i = 0; i <= contact.index; ++i) {
    for (int j = 0; j <= contact.index; ++j) {
      const Eigen::Vector2d arm = point - joint[std::max(i, j)];
      gap.curvature(i, j) = -normal.dot(arm) + per_radius * tangent.dot(turn[i]) * tangent.dot(turn[j]);
    }
  }
  return gap;
}

}  // namespace softgrip::finger
