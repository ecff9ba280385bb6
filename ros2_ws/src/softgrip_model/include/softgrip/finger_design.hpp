// SPDX-License-Identifier: Apache-2.0
// A tendon-driven finger as the kernel sees it: lengths in mm, forces in N, moduli in MPa, angles in rad.
//
// Joints, links and routing points run from the base to the tip. Joint j sits at the apex of its V groove; the cable
// enters the groove at routing point 2j on the proximal flank and leaves it at 2j+1 on the distal flank.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

namespace softgrip::finger {

inline constexpr int kMaxJoints = 6;
inline constexpr int kMaxPoints = 2 * kMaxJoints;

template <typename T>
using PerJoint = std::array<T, kMaxJoints>;
template <typename T>
using PerPoint = std::array<T, kMaxPoints>;

// How the bending moment follows from the tangent modulus E(e) = a e^2 + b e + c (docs/finger.md compares them).
enum class MomentLaw : std::uint8_t {
  Linear = 0,           // c alone: Eq 3.4
  SignedTangent = 1,    // Eq 4.3 read as a tangent: the odd term b cancels across the strip
  AbsoluteTangent = 2,  // E(|e|): both faces soften; default
  NeutralAxis = 3,      // signed strain, neutral axis where the axial force vanishes
  SignedSecant = 4,     // Eq 4.3 as its text says, M = K q
};

struct Material {
  double quadratic_MPa = 0.0;
  double linear_MPa = 0.0;
  double constant_MPa = 21.89;
  MomentLaw law = MomentLaw::AbsoluteTangent;
  double max_strain = 0.45;  // measured up to here
};

// One-sided stop where the groove flanks meet: moment z^3/(1-z), z = (q - start)/(opening - start), so q < opening.
struct Stop {
  double margin_rad = 0.0873;  // it starts this far before the flanks touch (5 deg)
  double moment_Nmm = 1000.0;  // 0 = no stop
};

// How links and strips move against each other.
enum class JointModel : std::uint8_t {
  Hinge = 0,    // mode P: rigid links turn about the grooves' apexes
  Flexure = 1,  // mode F: the strip bends along an arc, shortens and shears; links give near it
};

// What mode F takes from a finite-element study (softgrip_model.finger.flexure has its numbers and where they are
// from).
struct FlexureStudy {
  double strip = 1.0;       // bending stiffness over that of a beam held across as `contraction` says
  double link = 1.0;        // the same of the links
  double spread = 1.0;      // mm deeper per mm along: how a strip's force spreads into its link
  double attachment = 0.0;  // how far beyond its routing point the cable acts on a link; share of the strip's length
  // of a root, beside a beam
  double root_thickness = 0.0;  // how much more it gives with the strip's thickness over its length
  double root_link = 0.0;       // the same in a shorter link
  double root_lever = 1.0;      // lever of a shear
  // of a strip; e: the strain that bending makes from one face to the other
  double elongation = 0.0;   // of its axis, per e^2
  double softening = 0.0;    // against more bending, per e^2
  double contraction = 0.0;  // how much of a strip is free to contract across, per length over width
};

// Flexures like those that the study's numbers were compared with CalculiX on; beyond them nothing is known.
struct FlexureRange {
  struct Interval {
    double low, high;
    bool holds(double value) const { return value >= low && value <= high; }
  };
  Interval thickness_mm{2.5, 5.0}, routing_mm{5.0, 13.0}, length_mm{7.0, 14.0}, width_mm{10.0, 20.0},
      body_mm{10.0, 14.0}, opening_rad{80.0 * M_PI / 180.0, 100.0 * M_PI / 180.0}, poisson{0.2, 0.45};
};

struct Cable {
  double compliance_per_N = 0.0;  // 1/EA; 0 = inextensible
  double lead_mm = 0.0;           // from the actuator to the finger's base
};

struct Design {
  int joints = 0;
  double base_mm = 0.0;
  PerJoint<double> width_mm{};      // of the bending strip
  PerJoint<double> link_mm{};       // link j runs from joint j to joint j+1, the last one to the tip
  PerJoint<double> thickness_mm{};  // h
  PerJoint<double> length_mm{};     // l, of the bending strip
  PerJoint<double> opening_rad{};
  PerPoint<double> routing_mm{};  // r
  Material material;
  Stop stop;
  Cable cable;
  JointModel joint_model = JointModel::Hinge;
  double body_mm = 12.0;  // depth of the links below the apexes; this and the next two are for mode F alone
  double poisson = 0.3;
  FlexureStudy study;
  double angle_smoothing_rad = 1e-3;  // |phi| is sqrt(phi^2 + this^2), so that gradients exist everywhere
};

// Why an element has no numbers, or what to know about them. The first group leaves NaN, the second does not.
enum Status : std::uint32_t {
  kOk = 0,
  kBadDesign = 1u << 0,       // impossible geometry or material, not finite
  kBadFriction = 1u << 1,     // coefficients outside the law's domain
  kBadTarget = 1u << 2,       // not finite, or negative tension
  kFrictionBlowUp = 1u << 3,  // the printed friction law has no value at the angles and tensions met
  kNotConverged = 1u << 4,    // Newton did not reach an equilibrium
  kOutOfReach = 1u << 5,      // pulled length beyond what the closed grooves leave
  kFailure = (1u << 8) - 1,

  kReversing = 1u << 8,        // the cable runs backwards at some point while pulling: follow the path instead
  kStopEngaged = 1u << 9,      // a groove is closing on its stop
  kStrainOutside = 1u << 10,   // strip strained beyond the measured modulus
  kTensionOutside = 1u << 11,  // friction used outside the calibrated tensions
  kAngleOutside = 1u << 12,    // friction used above the calibrated wrap angles
  kSlack = 1u << 13,           // nothing pulled: straight finger, no tension
  kFlexureOutside = 1u << 14,  // mode F of a flexure that its study has none like
  kSnapped = 1u << 15,         // no equilibrium nearby was left: the finger jumped off or along an object
};

inline bool finite_positive(double value) {
  return std::isfinite(value) && value > 0.0;
}

// True when the numbers describe a finger; the Python face says which one does not.
inline bool sound(const Design& d) {
  if (d.joints < 1 || d.joints > kMaxJoints) return false;
  if (!finite_positive(d.material.constant_MPa) || !std::isfinite(d.material.quadratic_MPa + d.material.linear_MPa)) {
    return false;
  }
  if (!finite_positive(d.body_mm) || !(d.poisson >= 0.0 && d.poisson < 0.5)) return false;
  if (!(d.cable.compliance_per_N >= 0.0) || !(d.cable.lead_mm >= 0.0) || !(d.base_mm >= 0.0)) return false;
  if (!(d.stop.moment_Nmm >= 0.0) || !finite_positive(d.stop.margin_rad) || !(d.angle_smoothing_rad >= 0.0))
    return false;
  for (int j = 0; j < d.joints; ++j) {
    const bool lengths = finite_positive(d.link_mm[j]) && finite_positive(d.thickness_mm[j]) &&
                         finite_positive(d.length_mm[j]) && finite_positive(d.width_mm[j]) &&
                         finite_positive(d.routing_mm[2 * j]) && finite_positive(d.routing_mm[2 * j + 1]);
    if (!lengths || !(d.opening_rad[j] > d.stop.margin_rad && d.opening_rad[j] < M_PI)) return false;
    const double taken = d.routing_mm[2 * j + 1] * std::sin(0.5 * d.opening_rad[j]) +
                         (j + 1 < d.joints ? d.routing_mm[2 * j + 2] * std::sin(0.5 * d.opening_rad[j + 1]) : 0.0);
    if (taken >= d.link_mm[j]) return false;
  }
  return true;
}

// Whether every flexure of a design is like those of the study.
inline bool within(const FlexureRange& range, const Design& d) {
  bool holds = range.body_mm.holds(d.body_mm) && range.poisson.holds(d.poisson);
  for (int j = 0; j < d.joints; ++j) {
    holds = holds && range.thickness_mm.holds(d.thickness_mm[j]) && range.length_mm.holds(d.length_mm[j]) &&
            range.width_mm.holds(d.width_mm[j]) && range.opening_rad.holds(d.opening_rad[j]) &&
            range.routing_mm.holds(d.routing_mm[2 * j]) && range.routing_mm.holds(d.routing_mm[2 * j + 1]);
  }
  return holds;
}

}  // namespace softgrip::finger
