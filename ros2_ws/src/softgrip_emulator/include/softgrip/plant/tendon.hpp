// SPDX-License-Identifier: Apache-2.0
// The cable of one finger: where it runs through the holes of the links, and what friction leaves of its tension.
//
// A hole is wider than the cable. The cable takes the shortest way through all holes: it lies on the rim of a hole that
// bends it and passes freely through one that lies on its way, where nothing rubs (the contact rule of thesis section
// 3.2.2). Friction at each contact carries a bristle state s in -1..1: T(after) = T(before) exp(-s mu phi). It turns
// round over a short cable travel (Dahl), which gives hysteresis; a coefficient that falls with speed gives stick-slip.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "softgrip/plant/strip.hpp"

namespace softgrip::plant {

// n values per joint or 2 n per contact, base to tip (plant/truth.py explains them).
struct TendonMake {
  std::vector<double> link_m, opening_rad, entry_radius_m, exit_radius_m;  // n
  std::vector<double> clearance_m, friction_pressure, friction_adhesion;   // 2 n
  double bending_n, bending_share, friction_stribeck_share, friction_stribeck_speed_m_s;
  double presliding_m, cable_stiffness_n, lead_length_m;
  double bedding_strain, bedding_n;  // what a braid gives for good under tensions far above bedding_n
  double creep_share, creep_time_s;  // of the cable's elastic strain, in addition, after a while
  double knot_slip_m;                // for each e-fold of loadings
  std::vector<double> wear_per_j;    // 2 n: growth of friction with the work of pressing and sliding

  std::size_t joints() const { return link_m.size(); }
};

class Tendon {
 public:
  // Tension at the spool, and how it falls with cable that comes out.
  struct Pull {
    double tension_n, rate_n_per_m;
  };

  // Through the straight finger, (n) strips.
  Tendon(TendonMake make, const std::vector<Strip>& strips);

  // Follow the links to where they are now, (n) poses of `Strip`.
  void follow(const std::vector<Strip>& strips);

  // Tension after each contact over the tension at the spool, (2 n), given the tensions there now.
  void find_ratios(const double* span_tension_n, double friction_scale);
  Pull pull(double wound_m, double slack_m, bool broken) const;
  // Turn the bristles by what the cable has travelled over each contact, which also wears it.
  void slide(const double* span_tension_n, double dt_s);
  // Let the cable bed in, creep and slip in its knot under the tension at the spool.
  void age(double tension_n, double dt_s);

  // What the tendon will not forget, `memory` (3 + 2 n): bedding strain, largest tension [N], loadings, wear.
  void restore(const double* memory);
  void recall(double* memory) const;
  std::size_t memory() const { return 3 + wear_.size(); }
  // How much longer it has become since it was mounted [m].
  double lengthened_m() const;

  // How much shorter the way is than through the straight finger [m].
  double pulled_length_m() const { return straight_m_ - way_m(); }
  double ratio(std::size_t contact) const { return ratio_[contact]; }
  // How the cable across groove j grows with the pose of the link beyond, [m/m, m/m, m/rad].
  const Eigen::Vector3d& growth(std::size_t joint) const { return growth_[joint]; }
  const TendonMake& make() const { return make_; }

 private:
  Eigen::Vector2d entry(std::size_t joint) const;
  Eigen::Vector2d exit(std::size_t joint) const;
  void settle(const std::vector<Strip>& strips);
  double way_m() const;
  double log_ratio(std::size_t contact, double tension_n) const;
  void measure_beyond(const double* span_tension_n, std::vector<double>& beyond_m) const;

  TendonMake make_;
  std::vector<Eigen::Vector2d> entry_flank_, exit_flank_;  // n: unit vectors away from the joint
  double straight_m_ = 0.0;
  bool has_room_ = false;
  // State.
  std::vector<double> offset_m_;                           // 2 n: along the flank from the middle of the hole
  std::vector<double> bristle_, slid_from_m_, speed_m_s_;  // 2 n
  double bedded_ = 0.0, largest_n_ = 0.0, loadings_ = 0.0, crept_ = 0.0, tension_before_n_ = 0.0;
  double longer_when_mounted_m_ = 0.0;
  std::vector<double> wear_;  // 2 n
  // What follows from the shape.
  std::vector<double> span_m_;            // n: cable in each groove
  std::vector<double> link_span_m_;       // n + 1: on the base and on each link
  std::vector<Eigen::Vector3d> growth_;   // n
  std::vector<double> wrap_rad_;          // 2 n
  std::vector<double> ratio_, beyond_m_;  // 2 n
};

}  // namespace softgrip::plant
