// SPDX-License-Identifier: Apache-2.0
// A finger along a path of pulled lengths or tensions: closing, opening, objects.
//
// Each routing point is pulled through, stuck, or let back; which one follows from the path (Coulomb's law with the
// ratio Rf in either direction). Unknowns: joint angles, ln of every span's tension, contact forces. The laws are
// complementarity conditions, solved by an active-set method: Newton for assumed states, then the states it
// contradicts.
#pragma once

#include "path_system.hpp"

namespace softgrip::finger {

struct PathSettings {
  double largest_pull_step_mm = 0.25;
  double largest_tension_step_N = 0.5;
  // A stuck, inextensible cable leaves the tension between two bends on one link undetermined; this much give decides.
  double min_compliance_per_N = 1e-6;
};

class Path {
 public:
  Path(const Finger& finger, const std::vector<Contact>& contacts, const PathSettings& settings);

  // The state at the next target (mm, or N); a failed step leaves the path where it was.
  PathStep to(Control control, double target);

 private:
  PathStep slack_step() const;
  bool begin(Control control, double target, PathStep& out);
  bool increment(Control control, double target, PathStep& step) const;
  bool snap(Control control, double target, PathStep& step);
  bool relax(Control control, double target, PathStep& step) const;
  bool settle(Control control, double target, const PathStep& before, PathStep& step) const;
  std::uint32_t flags(const PathStep& step) const;
  PathSystem system_at(const PathStep& before, PathStep& step, Control control, double target) const;

  Finger finger_;
  std::vector<Contact> contacts_;
  PathSettings settings_;
  PathLayout layout_;
  double compliance_;
  PathStep now_;
};

}  // namespace softgrip::finger
