// SPDX-License-Identifier: Apache-2.0
// The finger kernel: a groove's triangle, a strip's moment by quadrature of stress, equilibrium of a whole finger.
#include <gtest/gtest.h>

#include "softgrip/finger_solver.hpp"

namespace softgrip::finger {
namespace {

// Entry and exit as points, the apex at the origin, the proximal link along x and the cable's side below it.
struct Triangle {
  double entry_x, entry_y, exit_x, exit_y;

  Triangle(double opening_rad, double q, double ra, double rb)
      : entry_x(-ra * std::sin(opening_rad / 2)),
        entry_y(-ra * std::cos(opening_rad / 2)),
        exit_x(rb * std::sin(opening_rad / 2 - q)),
        exit_y(-rb * std::cos(opening_rad / 2 - q)) {}
  double span() const { return std::hypot(exit_x - entry_x, exit_y - entry_y); }
  double direction() const { return std::atan2(exit_y - entry_y, exit_x - entry_x); }
};

TEST(Groove, IsATriangleOfTheApexAndTwoRoutingPoints) {
  const double opening = 1.3, ra = 7.0, rb = 9.5, step = 1e-6;
  for (const double q : {0.0, 0.4, 1.1}) {
    const Groove groove(opening, q, ra, rb);
    const auto at = [&](double angle) { return Triangle(opening, angle, ra, rb); };
    EXPECT_NEAR(groove.span_mm, at(q).span(), 1e-12);
    EXPECT_NEAR(groove.direction_rad, at(q).direction(), 1e-12);
    EXPECT_NEAR(groove.arm_mm, -(at(q + step).span() - at(q - step).span()) / (2 * step), 1e-7);
    EXPECT_NEAR(groove.d_direction, (at(q + step).direction() - at(q - step).direction()) / (2 * step), 1e-8);
    const auto arm = [&](double angle) { return Groove(opening, angle, ra, rb).arm_mm; };
    EXPECT_NEAR(groove.d_arm, (arm(q + step) - arm(q - step)) / (2 * step), 1e-7);
  }
}

struct Section {
  double force, moment;
};

// Axial force and moment of a strip whose stress(strain) acts at strain = k y - shift, by the midpoint rule.
template <class Stress>
Section integrate(const Stress& stress, double width, double thickness, double curvature, double shift) {
  constexpr int kSlices = 20000;
  Section sum{0.0, 0.0};
  for (int i = 0; i < kSlices; ++i) {
    const double y = thickness * ((i + 0.5) / kSlices - 0.5), slice = width * thickness / kSlices;
    const double force = stress(curvature * y - shift) * slice;
    sum.force += force;
    sum.moment += force * y;
  }
  return sum;
}

Material tpu(MomentLaw law) {
  Material material;
  material.quadratic_MPa = 40.0;
  material.linear_MPa = -30.0;
  material.constant_MPa = 21.89;
  material.law = law;
  return material;
}

TEST(Strip, MomentOfAbsoluteStrainIsTheIntegralOfItsStress) {
  const double width = 20.0, thickness = 1.6, length = 6.0, q = 0.5;
  const Material m = tpu(MomentLaw::AbsoluteTangent);
  const auto stress = [&](double e) {
    const double size = std::abs(e);
    return e * (m.constant_MPa + size * (m.linear_MPa / 2 + size * m.quadratic_MPa / 3));
  };
  const double expected = integrate(stress, width, thickness, q / length, 0.0).moment;
  EXPECT_NEAR(Strip(m, width, thickness, length).at(q).value_Nmm, expected, 1e-6 * expected);
}

TEST(Strip, NeutralAxisIsWhereTheAxialForceVanishes) {
  const double width = 20.0, thickness = 1.6, length = 6.0, q = 0.5;
  const Material m = tpu(MomentLaw::NeutralAxis);
  const auto stress = [&](double e) { return e * (m.constant_MPa + e * (m.linear_MPa / 2 + e * m.quadratic_MPa / 3)); };
  double low = -0.1, high = 0.1;  // of the axis' shift: force falls with it
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (integrate(stress, width, thickness, q / length, middle).force > 0.0 ? low : high) = middle;
  }
  const double expected = integrate(stress, width, thickness, q / length, low).moment;
  EXPECT_NEAR(Strip(m, width, thickness, length).at(q).value_Nmm, expected, 1e-6 * expected);
}

TEST(Strip, SlopesAreThoseOfDifferences) {
  const double q = 0.5, step = 1e-6;
  for (const MomentLaw law :
       {MomentLaw::Linear, MomentLaw::SignedTangent, MomentLaw::AbsoluteTangent, MomentLaw::NeutralAxis}) {
    const auto moment = [&](double angle, double thickness) {
      return Strip(tpu(law), 20.0, thickness, 6.0).at(angle).value_Nmm;
    };
    const Strip strip(tpu(law), 20.0, 1.6, 6.0);
    EXPECT_NEAR(strip.at(q).d_angle, (moment(q + step, 1.6) - moment(q - step, 1.6)) / (2 * step), 1e-5);
    EXPECT_NEAR(strip.d_thickness(q), (moment(q, 1.6 + step) - moment(q, 1.6 - step)) / (2 * step), 1e-5);
  }
}

Design three_joints() {
  Design design;
  design.joints = 3;
  design.base_mm = 10.0;
  for (std::size_t j = 0; j < 3; ++j) {
    design.width_mm[j] = 20.0;
    design.link_mm[j] = 30.0;
    design.thickness_mm[j] = 1.4 + 0.2 * static_cast<double>(j);
    design.length_mm[j] = 5.0;
    design.opening_rad[j] = 1.4;
    design.routing_mm[2 * j] = 8.0;
    design.routing_mm[2 * j + 1] = 9.0;
  }
  design.stop.moment_Nmm = 0.0;
  design.angle_smoothing_rad = 0.0;
  return design;
}

TEST(Equilibrium, MomentsBalanceTheTensionInEveryGroove) {
  friction::Model friction;
  friction.law = friction::Law::Capstan;
  friction.coefficients = {0.3};
  friction.radius_mm = 1.0;
  const Design design = three_joints();
  const Finger finger(design, friction);
  const Equilibrium found = solve(finger, Control::PulledLength, 6.0);
  ASSERT_EQ(found.status & kFailure, kOk);
  double pulled = 0.0;
  for (int j = 0; j < 3; ++j) {
    const double q = found.state.angle_rad[static_cast<std::size_t>(j)];
    const Triangle straight(1.4, 0.0, 8.0, 9.0), bent(1.4, q, 8.0, 9.0);
    const double h = 1e-6,
                 arm = -(Triangle(1.4, q + h, 8.0, 9.0).span() - Triangle(1.4, q - h, 8.0, 9.0).span()) / (2 * h);
    const double tension = std::exp(found.log_tension[2 * static_cast<std::size_t>(j) + 1]);
    const Strip strip(design.material, 20.0, design.thickness_mm[static_cast<std::size_t>(j)], 5.0);
    EXPECT_NEAR(strip.at(q).value_Nmm, tension * arm, 1e-6 * tension * arm);
    pulled += straight.span() - bent.span();
  }
  EXPECT_NEAR(pulled, 6.0, 1e-9);
  for (std::size_t i = 0; i < 6; ++i) {  // Euler's formula at every routing point
    EXPECT_NEAR(found.log_tension[i] - found.log_tension[i + 1], 0.3 * std::abs(found.phi_rad[i]), 1e-9);
  }
}

}  // namespace
}  // namespace softgrip::finger
