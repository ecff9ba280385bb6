// SPDX-License-Identifier: Apache-2.0
// Mode R: the thesis' own recipe for a closing (section 3.2.2), kept to reproduce its numbers, not to predict.
//
// Explicit increments: each one divides a pull dL among the joints by arm^2 e^-S / K, S = sum of ln Rf up to the joint,
// Rf taken at the tensions of the step before. It drops T d(arm), so it is no equilibrium (docs/finger.md).
#pragma once

#include "softgrip/finger_sensitivity.hpp"

namespace softgrip::finger {

// What bends a joint: the tension in its span, or what its two points take from the tension (Eqs 3.5, 3.6 as printed;
// what is left at the tip bends the last joint, so that the joints' forces sum up to the actuator's).
enum class BendingForce : std::uint8_t { SpanTension = 0, TensionLoss = 1 };

struct Replication {
  double passage_radius_mm = 0.0;  // of the cable's hole; a point counts once the cable bears on it; 0 = always
  double cable_radius_mm = 0.0;
  double neighbour_mm = 35.0;  // where the cable is held before the first and beyond the last point
  double initial_tension_N = 0.05;
  BendingForce force = BendingForce::SpanTension;
};

struct ReplicationStep {
  PerJoint<double> angle_rad{};
  PerSpan<double> tension_N{};
  std::uint32_t status = kOk;
};

namespace detail {

struct Point {
  double x = 0.0, y = 0.0;
};

// Routing points in the base frame, with the two places beyond the ends where the cable is held.
inline std::array<Point, kMaxPoints + 2> cable_points(const Design& d, const PerJoint<double>& q, double neighbour_mm) {
  std::array<Point, kMaxPoints + 2> points{};
  Point joint;
  double heading = 0.0;  // of the link before the joint, clockwise
  auto along = [](const Point& from, double angle, double ahead, double aside) {
    return Point{from.x + ahead * std::cos(angle) - aside * std::sin(angle),
                 from.y - ahead * std::sin(angle) - aside * std::cos(angle)};
  };
  for (int j = 0; j < d.joints; ++j) {
    const double half = 0.5 * d.opening_rad[j];
    const double ra = d.routing_mm[2 * j], rb = d.routing_mm[2 * j + 1];
    points[2 * j + 1] = along(joint, heading, -ra * std::sin(half), ra * std::cos(half));
    heading += q[j];
    points[2 * j + 2] = along(joint, heading, rb * std::sin(half), rb * std::cos(half));
    joint = along(joint, heading, d.link_mm[j], 0.0);
  }
  const Point& last = points[2 * d.joints];
  points[0] = {points[1].x - neighbour_mm, points[1].y};
  points[2 * d.joints + 1] = along(last, heading, neighbour_mm, 0.0);
  return points;
}

inline double distance_to_line(const Point& p, const Point& a, const Point& b) {
  const double dx = b.x - a.x, dy = b.y - a.y;
  return std::abs(dx * (p.y - a.y) - dy * (p.x - a.x)) / std::hypot(dx, dy);
}

}  // namespace detail

class ReplicationRun {
 public:
  ReplicationRun(const Finger& finger, const Replication& recipe) : finger_(finger), recipe_(recipe) {
    now_.tension_N.fill(recipe.initial_tension_N);
  }

  const ReplicationStep& advance(double pull_mm) {
    const Design& d = finger_.design;
    const int n = d.joints;
    const auto points = detail::cable_points(d, now_.angle_rad, recipe_.neighbour_mm);
    const double clearance = std::sqrt(2.0) * recipe_.passage_radius_mm - recipe_.cable_radius_mm;
    PerSpan<double> share{};  // e^-S behind each point
    PerJoint<double> arm{};
    double log_loss = 0.0;
    share[0] = 1.0;
    for (int i = 0; i < 2 * n; ++i) {
      const int j = i / 2;
      const double q = now_.angle_rad[j];
      const Groove groove = finger_.groove(j, q);
      const double phi = finger_.bend_rad(i, groove, q);
      if (detail::distance_to_line(points[i + 1], points[i], points[i + 2]) >= clearance) {
        const friction::Evaluation e = friction::evaluate(finger_.friction.model, std::abs(phi), now_.tension_N[i + 1]);
        if (!e.has_value()) return now_.status = kFrictionBlowUp, now_;
        log_loss += e.log_ratio;
      }
      share[i + 1] = std::exp(-log_loss);
      arm[j] = groove.arm_mm;
    }
    PerJoint<double> turn{};  // dq / dTa
    double taken = 0.0;
    for (int j = 0; j < n; ++j) {
      turn[j] = arm[j] * bending_share(share, j) / finger_.strip[j].at(now_.angle_rad[j]).d_angle;
      taken += arm[j] * turn[j];
    }
    const double tension_step = pull_mm / taken;
    if (!std::isfinite(tension_step)) return now_.status = kNotConverged, now_;
    for (int j = 0; j < n; ++j) {
      now_.angle_rad[j] += turn[j] * tension_step;
      if (now_.angle_rad[j] >= d.opening_rad[j]) return now_.status = kOutOfReach, now_;
    }
    for (int i = 0; i <= 2 * n; ++i) now_.tension_N[i] += share[i] * tension_step;
    return now_;
  }

 private:
  // Of the actuator's tension.
  double bending_share(const PerSpan<double>& share, int joint) const {
    if (recipe_.force == BendingForce::SpanTension) return share[2 * joint + 1];
    const bool is_last = joint + 1 == finger_.design.joints;
    return share[2 * joint] - (is_last ? 0.0 : share[2 * joint + 2]);
  }

  const Finger& finger_;
  Replication recipe_;
  ReplicationStep now_;
};

}  // namespace softgrip::finger
