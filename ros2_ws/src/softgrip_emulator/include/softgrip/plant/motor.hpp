// SPDX-License-Identifier: Apache-2.0
// Motor, gear and spool of one servo: electrics, friction of the gear, heat. SI units at the output shaft.
#pragma once

#include <algorithm>

namespace softgrip::plant {

constexpr double kAmbient_C = 24.0;
// The load presses the gear's teeth: this share of it is friction.
constexpr double kGearLoadShare = 0.06;

struct Shaft {
  double angle_rad, velocity_rad_s, current_a, temperature_c;
};

struct Ratings {
  double resistance_ohm, back_emf_vs_per_rad, torque_constant_nm_per_a, inertia_kgm2, gear_viscous_nms;
  double gear_friction_nm, thermal_resistance_k_per_w, heat_capacity_j_per_k;
};

struct Motor {
  Ratings ratings;
  double spool_radius_m;
  double friction_factor;     // gear friction of this copy relative to the ratings
  double extra_heat_w = 0.0;  // what a fault heats it with
  bool jammed = false;

  // The shaft one step [s] later (semi-implicit Euler).
  Shaft turned(Shaft shaft, double duty, double current_limit_a, double tension_n, double supply_v, double dt_s) const {
    shaft.current_a = 0.0;
    if (current_limit_a > 0.0 && duty != 0.0) {
      const double emf_v = ratings.back_emf_vs_per_rad * shaft.velocity_rad_s;
      const double driven_a = (duty * supply_v - emf_v) / ratings.resistance_ohm;
      shaft.current_a = std::clamp(driven_a, -current_limit_a, current_limit_a);
    }
    const double load_nm = tension_n * spool_radius_m;
    const double drive_nm = ratings.torque_constant_nm_per_a * shaft.current_a - load_nm;
    double velocity = shaft.velocity_rad_s + dt_s * drive_nm / ratings.inertia_kgm2;
    velocity /= 1.0 + dt_s * ratings.gear_viscous_nms / ratings.inertia_kgm2;
    // Coulomb friction as an impulse: it stops the shaft, never reverses it.
    const double friction_nm = friction_factor * (ratings.gear_friction_nm + kGearLoadShare * load_nm);
    const double impulse = dt_s * friction_nm / ratings.inertia_kgm2;
    velocity = velocity > 0.0 ? std::max(0.0, velocity - impulse) : std::min(0.0, velocity + impulse);
    shaft.velocity_rad_s = jammed ? 0.0 : velocity;
    shaft.angle_rad += shaft.velocity_rad_s * dt_s;
    const double heat_w = shaft.current_a * shaft.current_a * ratings.resistance_ohm + extra_heat_w;
    const double loss_w = (shaft.temperature_c - kAmbient_C) / ratings.thermal_resistance_k_per_w;
    shaft.temperature_c += dt_s * (heat_w - loss_w) / ratings.heat_capacity_j_per_k;
    return shaft;
  }
};

}  // namespace softgrip::plant
