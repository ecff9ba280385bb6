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
  made.spool_radius_m = 0.01;
  made.friction_factor = 1.0;
  return made;
}

Shaft run(const Motor& motor, double duty, double tension_n, double seconds) {
  constexpr double kStep_s = 1e-4;
  Shaft shaft{0.0, 0.0, 0.0, kAmbient_C};
  for (int i = 0; i < static_cast<int>(seconds / kStep_s); ++i)
    shaft = motor.turned(shaft, duty, 10.0, tension_n, 12.0, kStep_s);
  return shaft;
}

TEST(Motor, RunsAtTheSpeedWhereTorqueBalances) {
  const Motor m = motor();
  const Ratings& r = m.ratings;
  const double tension_n = 20.0, duty = 0.8, load = tension_n * m.spool_radius_m;
  // k (U - e w) / R = load + friction + c w
  const double friction = r.gear_friction_nm + kGearLoadShare * load;
  const double speed = (r.torque_constant_nm_per_a * duty * 12.0 / r.resistance_ohm - load - friction) /
                       (r.gear_viscous_nms + r.torque_constant_nm_per_a * r.back_emf_vs_per_rad / r.resistance_ohm);
  EXPECT_NEAR(run(m, duty, tension_n, 2.0).velocity_rad_s, speed, 1e-3 * speed);
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
  const double current = 0.5 * 12.0 / m.ratings.resistance_ohm;
  const double heat_w = current * current * m.ratings.resistance_ohm;
  const Shaft shaft = run(m, 0.5, 0.0, 120.0);  // ten time constants
  EXPECT_EQ(shaft.angle_rad, 0.0);
  EXPECT_NEAR(shaft.current_a, current, 1e-12);
  EXPECT_NEAR(shaft.temperature_c, kAmbient_C + heat_w * m.ratings.thermal_resistance_k_per_w, 0.1);
}

TEST(Motor, CurrentKeepsToItsLimit) {
  const Shaft shaft = motor().turned({0.0, 0.0, 0.0, kAmbient_C}, -1.0, 0.3, 0.0, 12.0, 1e-3);
  EXPECT_EQ(shaft.current_a, -0.3);
}

}  // namespace
}  // namespace softgrip::plant
