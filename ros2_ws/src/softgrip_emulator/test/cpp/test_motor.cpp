// SPDX-License-Identifier: Apache-2.0
// The motor's steady states in closed form: speed, stall, temperature.
#include <gtest/gtest.h>

#include "softgrip/plant/motor.hpp"

namespace softgrip::plant {
namespace {

// Of the size of an XL430 (its e-manual: 12 V, stall 1.5 N m at 1.4 A, 61 rev/min without load).
Motor motor() {
  Motor made{};
  made.ratings.resistance_ohm = 8.5;
  made.ratings.back_emf_vs_per_rad = 1.7;
  made.ratings.torque_constant_nm_per_a = 1.07;
  made.ratings.inertia_kgm2 = 0.01;
  made.ratings.gear_viscous_nms = 0.02;
  made.ratings.gear_friction_nm = 0.05;
  made.ratings.thermal_resistance_k_per_w = 12.0;
  made.ratings.heat_capacity_j_per_k = 1.0;
  made.ratings.winding_to_case_k_per_w = 4.0;
  made.ratings.winding_capacity_j_per_k = 0.2;
  made.spool_radius_m = 0.01;
  made.friction_factor = 1.0;
  return made;
}

constexpr Shaft kAtRest{0.0, 0.0, kAmbient_C, kAmbient_C};

Shaft run(const Motor& motor, double duty, double tension_n, double seconds) {
  constexpr double kStep_s = 1e-4;
  Shaft shaft = kAtRest;
  for (int i = 0; i < static_cast<int>(seconds / kStep_s); ++i) {
    shaft = motor.turned(shaft, {duty, 10.0, false}, tension_n, 12.0, kStep_s);
  }
  return shaft;
}

// Copper: 0.393 % a kelvin from 25 degC (IEC 60028).
double hot_resistance(const Motor& motor, const Shaft& shaft) {
  return motor.ratings.resistance_ohm * (1.0 + 0.00393 * (shaft.winding_c - 25.0));
}

TEST(Motor, RunsAtTheSpeedWhereTorqueBalances) {
  const Motor m = motor();
  const Ratings& r = m.ratings;
  const double tension_n = 20.0, duty = 0.8, load = tension_n * m.spool_radius_m;
  // k (U - e w) / R = load + friction + c w
  const double friction = r.gear_friction_nm + kGearLoadShare * load;
  const Shaft shaft = run(m, duty, tension_n, 2.0);
  const double gain = r.torque_constant_nm_per_a / hot_resistance(m, shaft);
  const double speed = (gain * duty * 12.0 - load - friction) / (r.gear_viscous_nms + gain * r.back_emf_vs_per_rad);
  EXPECT_NEAR(shaft.velocity_rad_s, speed, 1e-3 * speed);
}

TEST(Motor, FrictionHoldsWhatIsWeakerThanItAndNeverReverses) {
  const Motor m = motor();
  const double stall_duty =
      0.9 * m.ratings.gear_friction_nm * m.ratings.resistance_ohm / (m.ratings.torque_constant_nm_per_a * 12.0);
  EXPECT_EQ(run(m, stall_duty, 0.0, 0.5).angle_rad, 0.0);
  EXPECT_GT(run(m, 1.2 * stall_duty, 0.0, 0.5).angle_rad, 0.0);
  EXPECT_EQ(run(m, 0.0, 4.0, 0.5).angle_rad, 0.0);  // 0.04 N m of load against 0.0524 of friction
  EXPECT_LT(run(m, 0.0, 8.0, 0.5).angle_rad, 0.0);  // 0.08 against 0.0548
}

TEST(Motor, WarmsUpToWhatItsThermalResistanceCarriesOff) {
  Motor m = motor();
  m.jammed = true;
  const Shaft shaft = run(m, 0.5, 0.0, 120.0);  // ten time constants
  const double current = 0.5 * 12.0 / hot_resistance(m, shaft), heat_w = 0.5 * 12.0 * current;
  EXPECT_EQ(shaft.angle_rad, 0.0);
  EXPECT_NEAR(shaft.current_a, current, 1e-4);
  const double case_c = kAmbient_C + heat_w * m.ratings.thermal_resistance_k_per_w;
  EXPECT_NEAR(shaft.temperature_c, case_c, 0.1);
  EXPECT_NEAR(shaft.winding_c, case_c + heat_w * m.ratings.winding_to_case_k_per_w, 0.1);
}

TEST(Motor, CurrentKeepsToItsLimit) {
  const double of_winding = motor().turned(kAtRest, {-1.0, 0.3, false}, 0.0, 12.0, 1e-3).current_a;
  EXPECT_NEAR(of_winding, -0.3, 1e-12);
  const Shaft of_supply = motor().turned(kAtRest, {1.0, 0.3, true}, 0.0, 12.0, 1e-3);
  EXPECT_NEAR(of_supply.duty * of_supply.current_a, 0.3, 1e-12);  // what the supply carries
}

}  // namespace
}  // namespace softgrip::plant
