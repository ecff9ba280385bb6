// SPDX-License-Identifier: Apache-2.0
// Motor, gear and spool of one servo: electrics, friction of the gear, heat. SI units at the output shaft.
#pragma once

#include <algorithm>
#include <cmath>

namespace softgrip::plant {

constexpr double kAmbient_C = 24.0;
// The load presses the gear's teeth: this share of it is friction. Rhoban/bam identified 0.068 on XL330s
// (bam/params/xl330/m4.json, load_friction_base).
constexpr double kGearLoadShare = 0.06;
// Copper: 0.393 % more resistance a kelvin (IEC 60028), from the 25 degC of a data sheet.
constexpr double kCopper_perK = 0.00393;
constexpr double kRated_C = 25.0;

struct Shaft {
  double angle_rad, velocity_rad_s, temperature_c, winding_c;
  double current_a = 0.0;  // in the winding
  double duty = 0.0;       // what the power stage applies; below what was asked for where a limit acts
};

struct Ratings {
  double resistance_ohm, back_emf_vs_per_rad, torque_constant_nm_per_a, inertia_kgm2, gear_viscous_nms;
  double gear_friction_nm, thermal_resistance_k_per_w, heat_capacity_j_per_k;
  double winding_to_case_k_per_w, winding_capacity_j_per_k;
};

// What the firmware asks of the power stage: duty cycle -1..1, and the largest current, of the winding or of the
// supply.
struct Drive {
  double duty, current_limit_a;
  bool limits_supply;
};

struct Motor {
  Ratings ratings;
  double spool_radius_m;
  double friction_factor;     // gear friction of this copy relative to the ratings
  double extra_heat_w = 0.0;  // what a fault heats it with
  bool jammed = false;

  double resistance_ohm(double winding_c) const {
    return ratings.resistance_ohm * (1.0 + kCopper_perK * (winding_c - kRated_C));
  }

  // The duty cycle that keeps the limit. Of the winding: |duty V - e| <= R i. Of the supply, which carries duty times
  // the winding's current: duty (duty V - e) <= R i.
  double limited_duty(const Drive& drive, double emf_v, double supply_v, double ohm) const {
    const double drop_v = ohm * drive.current_limit_a;
    double centre = emf_v / supply_v, reach = drop_v / supply_v;
    if (drive.limits_supply) {
      centre = 0.5 * emf_v / supply_v;
      reach = std::sqrt(centre * centre + drop_v / supply_v);
    }
    return std::clamp(std::clamp(drive.duty, centre - reach, centre + reach), -1.0, 1.0);
  }

  // The shaft one step [s] later (semi-implicit Euler).
  Shaft turned(Shaft shaft, const Drive& drive, double tension_n, double supply_v, double dt_s) const {
    const double ohm = resistance_ohm(shaft.winding_c);
    shaft.current_a = shaft.duty = 0.0;
    if (drive.current_limit_a > 0.0 && drive.duty != 0.0 && supply_v > 0.0) {
      const double emf_v = ratings.back_emf_vs_per_rad * shaft.velocity_rad_s;
      shaft.duty = limited_duty(drive, emf_v, supply_v, ohm);
      shaft.current_a = (shaft.duty * supply_v - emf_v) / ohm;
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
    heat(shaft, shaft.current_a * shaft.current_a * ohm, dt_s);
    return shaft;
  }

  // The copper warms the winding, the winding the case, where the servo's sensor is.
  void heat(Shaft& shaft, double copper_w, double dt_s) const {
    const double inward_w = (shaft.winding_c - shaft.temperature_c) / ratings.winding_to_case_k_per_w;
    const double loss_w = (shaft.temperature_c - kAmbient_C) / ratings.thermal_resistance_k_per_w;
    const double case_j_per_k = ratings.heat_capacity_j_per_k - ratings.winding_capacity_j_per_k;
    shaft.winding_c += dt_s * (copper_w - inward_w) / ratings.winding_capacity_j_per_k;
    shaft.temperature_c += dt_s * (inward_w + extra_heat_w - loss_w) / case_j_per_k;
  }
};

}  // namespace softgrip::plant
