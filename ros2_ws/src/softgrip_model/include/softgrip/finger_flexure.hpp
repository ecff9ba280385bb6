// SPDX-License-Identifier: Apache-2.0
// One joint of mode F: a strip that bends, shortens and shears between links that give near it. docs/finger.md has the
// model; its numbers come from a finite-element study (FlexureStudy).
//
// Frames: each link carries one frame at either end, its origin in the joint's apex, x along the straight finger. The
// frame beyond a joint is turned by -q and shifted by (u, v) as seen from the frame before it.
// Loads are the compressive force that a cut carries, given by a closing moment M, a compression N and a shear V at a
// point; displacements are their work conjugates: a closing turn, a shift into the link, a shift across it.
#pragma once

#include "softgrip/finger_joint.hpp"
#include "softgrip/jet.hpp"

// Functions of mode F stay functions where all of a closing's is inlined for every processor: it would be compiled
// often.
#if defined(__GNUC__)
#define SOFTGRIP_APART __attribute__((noinline))
#else
#define SOFTGRIP_APART
#endif

namespace softgrip::finger {

// Turns by which the ends of a link lag behind its middle, and what its cable becomes shorter by; all per newton.
template <typename Real>
struct LinkEndOf {
  Real turn{}, along{}, across{}, shortening{};
};

// Symmetric, over (M, N, V).
template <typename Real>
struct ComplianceOf {
  Real mm{}, mn{}, mv{}, nn{}, nv{}, vv{};

  template <typename Load>
  auto turn(const Load& m, const Load& n, const Load& v) const {
    return mm * m + mn * n + mv * v;
  }
  template <typename Load>
  auto along(const Load& m, const Load& n, const Load& v) const {
    return mn * m + nn * n + nv * v;
  }
  template <typename Load>
  auto across(const Load& m, const Load& n, const Load& v) const {
    return mv * m + nv * n + vv * v;
  }
};

// To the thickness and to one routing distance.
using ShapeJet = Jet<2>;

// How much stiffer a strip is for being held across: all of it cannot contract where it is much wider than long.
inline double held_across(const Design& d, int joint) {
  const double share = std::max(0.0, 1.0 - d.study.contraction * d.length_mm[joint] / d.width_mm[joint]);
  return 1.0 + share * d.poisson * d.poisson / (1.0 - d.poisson * d.poisson);
}

// Stress per strain along the flexure of a joint, and of a rectangular section in shear.
inline double flexure_modulus_MPa(const Design& d, int joint) {
  return d.material.constant_MPa * held_across(d, joint);
}
inline double shear_modulus_MPa(const Design& d) {
  constexpr double kShearShare = 5.0 / 6.0;
  return kShearShare * d.material.constant_MPa / (2.0 * (1.0 + d.poisson));
}

// The part of a link near one joint as a beam whose effective depth spreads from the strip into the body.
class LinkSection {
 public:
  LinkSection(const Design& d, int joint, const ShapeJet& thickness)
      : thickness_(thickness),
        half_length_(0.5 * d.length_mm[joint]),
        body_(d.body_mm),
        per_slope_(1.0 / std::tan(0.5 * d.opening_rad[joint])),
        spread_(d.study.spread),
        width_(d.width_mm[joint]),
        modulus_(d.study.link * flexure_modulus_MPa(d, joint)),
        shear_modulus_(shear_modulus_MPa(d)) {}

  // Of the beam between x = `from` and `to` (mm from the apex), held at its far end, loaded at x = `at` on the line of
  // the apexes; a positive shear is one whose closing moment grows with the distance from there.
  ComplianceOf<ShapeJet> compliance(const ShapeJet& from, const ShapeJet& to, double at) const {
    // Gauss-Legendre
    constexpr std::array<double, 6> kPlace = {0.033765242898424, 0.169395306766868, 0.380690406958402,
                                              0.619309593041598, 0.830604693233132, 0.966234757101576};
    constexpr std::array<double, 6> kWeight = {0.085662246189585, 0.180380786524069, 0.233956967286346,
                                               0.233956967286346, 0.180380786524069, 0.085662246189585};
    ComplianceOf<ShapeJet> c;
    const ShapeJet length = to - from;
    for (int i = 0; i < 6; ++i) {
      const ShapeJet x = from + length * kPlace[i], lever = abs(ShapeJet(x - at));
      const ShapeJet below = depth_below(x), depth = below + 0.5 * thickness_;
      const ShapeJet centroid = 0.5 * (0.5 * thickness_ - below);
      const ShapeJet axial = length * kWeight[i] / (modulus_ * width_ * depth);
      const ShapeJet bending = 12.0 * axial / (depth * depth);
      const ShapeJet shear = axial * (modulus_ / shear_modulus_);
      c.mm += bending;
      c.mn += bending * centroid;
      c.mv += bending * lever;
      c.nn += bending * centroid * centroid + axial;
      c.nv += bending * centroid * lever;
      c.vv += bending * lever * lever + shear;
    }
    return c;
  }

 private:
  // Below the line of the apexes: what the strip's force has spread to, at most the body between its groove flanks.
  ShapeJet depth_below(const ShapeJet& x) const {
    const ShapeJet spread = 0.5 * thickness_ + spread_ * (x - half_length_);
    const ShapeJet flank = larger(x, ShapeJet(half_length_)) * per_slope_;
    const ShapeJet body = flank.value < body_ ? flank : ShapeJet(body_);
    return spread.value < body.value ? spread : body;
  }

  ShapeJet thickness_;
  double half_length_, body_, per_slope_, spread_, width_, modulus_, shear_modulus_;
};

// One side of a joint: the strip's root in a link, and the rest of the link up to its middle.
struct JointSide {
  ComplianceOf<ShapeJet> root, link;
  double half_sine = 0.0, half_cosine = 1.0;

  JointSide() = default;
  JointSide(const Design& d, int joint, double routing_mm, double link_half_mm)
      : half_sine(std::sin(0.5 * d.opening_rad[joint])), half_cosine(std::cos(0.5 * d.opening_rad[joint])) {
    const LinkSection section(d, joint, ShapeJet::variable(d.thickness_mm[joint], 0));
    const double half_length = 0.5 * d.length_mm[joint];
    const ShapeJet place = half_sine * ShapeJet::variable(routing_mm, 1);
    // the cable pulls at its routing point, or at the strip's end where that hangs in the groove
    const ShapeJet apart = place - half_length;
    constexpr double kRound_mm = 1.0;
    const ShapeJet attached = 0.5 * (place + half_length + sqrt(ShapeJet(apart * apart + kRound_mm * kRound_mm))) +
                              d.study.attachment * d.length_mm[joint];
    root = rooted(d, joint, section.compliance(ShapeJet(half_length), attached, half_length), link_half_mm);
    link = section.compliance(attached, ShapeJet(link_half_mm), 0.0);
  }

 private:
  // A root is too short for a beam: what the study has it give more or less than one.
  static ComplianceOf<ShapeJet> rooted(const Design& d, int joint, const ComplianceOf<ShapeJet>& beam,
                                       double link_half_mm) {
    constexpr double kThickness = 0.375, kLink = 1.35;  // over the strip's length; near the middle of the study's
    const double length = d.length_mm[joint], lever = d.study.root_lever;
    const ShapeJet thickness = ShapeJet::variable(d.thickness_mm[joint], 0) / length;
    const ShapeJet more = 1.0 + d.study.root_thickness * (thickness - kThickness) +
                          d.study.root_link * (kLink * length / link_half_mm - 1.0);
    const ShapeJet sheared = more * lever;
    return {beam.mm * more, beam.mn * more,    beam.mv * sheared,
            beam.nn * more, beam.nv * sheared, beam.vv * (sheared * lever)};
  }
};

// Everything of one joint that the design decides; `Real` may carry derivatives to the design.
template <typename Real>
struct FlexureOf {
  Real entry_mm{}, exit_mm{};
  double half_sine = 0.0, half_cosine = 1.0, half_length_mm = 0.0;
  ComplianceOf<Real> before, beyond;  // of the roots; the first joint's is held
  Real axial_per_N{}, shear_per_N{};  // strains
  Real skew_per_Nmm{};                // turn of the strip's middle, six times, by a moment that grows
  Real strain_per_rad{};              // of a face to the other, by the bend: thickness over length
  double elongation = 0.0, stiffening = 0.0, softening = 0.0;  // FlexureStudy's
};

template <typename Real>
struct PoseOf {
  Real x{}, y{}, cosine{Real(1.0)}, sine{};

  static PoseOf turned(const Real& angle, const Real& x, const Real& y) {
    PoseOf p;
    p.x = x, p.y = y;
    sine_cosine(angle, p.sine, p.cosine);
    return p;
  }
  PoseOf after(const PoseOf& next) const {
    PoseOf p;
    p.x = x + cosine * next.x - sine * next.y;
    p.y = y + sine * next.x + cosine * next.y;
    p.cosine = cosine * next.cosine - sine * next.sine;
    p.sine = sine * next.cosine + cosine * next.sine;
    return p;
  }
  PoseOf inverse() const {
    PoseOf p;
    p.cosine = cosine, p.sine = -sine;
    p.x = -(cosine * x + sine * y);
    p.y = sine * x - cosine * y;
    return p;
  }
};

// x with J x = right, J the slopes of three residuals to their first three variables (Cramer's rule).
template <typename Residual, typename Right>
std::array<Right, 3> solved(const std::array<Residual, 3>& residual, const std::array<Right, 3>& right) {
  const auto &a = residual[0].d, &b = residual[1].d, &c = residual[2].d;
  const double x = b[1] * c[2] - b[2] * c[1], y = b[2] * c[0] - b[0] * c[2], z = b[0] * c[1] - b[1] * c[0];
  const double per = 1.0 / (a[0] * x + a[1] * y + a[2] * z);
  return {per * (x * right[0] + (a[2] * c[1] - a[1] * c[2]) * right[1] + (a[1] * b[2] - a[2] * b[1]) * right[2]),
          per * (y * right[0] + (a[0] * c[2] - a[2] * c[0]) * right[1] + (a[2] * b[0] - a[0] * b[2]) * right[2]),
          per * (z * right[0] + (a[1] * c[0] - a[0] * c[1]) * right[1] + (a[0] * b[1] - a[1] * b[0]) * right[2])};
}

// What objects add to the load that a strip carries, in the frame before its joint: a compressive force (the one that
// pushes the finger beyond back) and its closing moment about the apex.
template <typename Real>
struct ObjectLoad {
  Real force_x{}, force_y{}, moment{};

  Real with_x(const Real& cable) const { return cable + force_x; }
  Real with_y(const Real& cable) const { return cable + force_y; }
  Real with_moment(const Real& cable, const Real& x, const Real& y) const {
    return cable + moment - x * force_y + y * force_x;
  }
};

// A free finger's.
struct NoObject {
  template <typename Real>
  Real with_x(const Real& cable) const {
    return cable;
  }
  template <typename Real>
  Real with_y(const Real& cable) const {
    return cable;
  }
  template <typename Real>
  Real with_moment(const Real& cable, const Real&, const Real&) const {
    return cable;
  }
};

// A joint at one state. `Real` carries the derivatives, `Shape` those of the design (or none).
template <typename Real, typename Shape>
struct FlexureState {
  Real span_mm, direction_rad;   // of the cable across the groove; the direction in the frame before the joint
  Real bend_rad;                 // of the strip itself
  std::array<Real, 3> residual;  // [N mm], [mm], [mm]

  FlexureState(const FlexureOf<Shape>& f, const Real& q, const Real& u, const Real& v) : f_(f), q_(q), u_(u), v_(v) {
    sine_cosine(q, sine_, cosine_);  // the frame beyond: x axis (cos, -sin)
    const Real out_x = f.exit_mm * f.half_sine, out_y = -1.0 * f.half_cosine * f.exit_mm;
    const Real dx = u + cosine_ * out_x + sine_ * out_y + f.half_sine * f.entry_mm;
    const Real dy = v - sine_ * out_x + cosine_ * out_y + f.half_cosine * f.entry_mm;
    span_mm = sqrt(Real(dx * dx + dy * dy));
    along_x_ = dx / span_mm;
    along_y_ = dy / span_mm;
    direction_rad = direction_of(dy, dx);
  }

  // The strip under the cable's tension and what objects add; `moment(bend)` bends it, `stop` is the groove's stop's.
  template <typename BendingMoment, typename Object>
  void load(const Real& tension, const BendingMoment& moment, const Real& stop, const Object& object) {
    const double half = f_.half_length_mm, length = 2.0 * half;
    const Real force_x = object.with_x(Real(tension * along_x_)), force_y = object.with_y(Real(tension * along_y_));
    auto closing = [&](const Real& x, const Real& y) { return object.with_moment(Real(tension * arm(x, y)), x, y); };
    const Real end_x = u_ + half * cosine_, end_y = v_ - half * sine_;
    const Real m_start = closing(Real(-half), Real(0.0)), m_end = closing(end_x, end_y);
    const Real n_end = force_x * cosine_ - force_y * sine_;
    const Real v_end = -1.0 * (force_x * sine_ + force_y * cosine_);  // seen from the link beyond
    const Real turn_start = f_.before.turn(m_start, force_x, force_y);
    const Real turn_end = f_.beyond.turn(m_end, n_end, v_end);
    bend_rad = q_ - turn_start - turn_end;

    // curvature: as great in the mean as the bend has it, growing by the skew, and by a parabola as the moment sags
    const Real skew = (m_end - m_start) * f_.skew_per_Nmm;
    Real s, c;
    const Real heading = -1.0 * turn_start - 0.5 * bend_rad + skew * (1.0 / 6);  // of the strip, in the mean
    sine_cosine(heading, s, c);
    const Real n_middle = force_x * c + force_y * s, v_middle = force_y * c - force_x * s;
    const Real b2 = bend_rad * bend_rad, s2 = skew * skew, softer = f_.shear_per_N - f_.axial_per_N;
    // bending moment: linear between the ends but for what the middle, bowed away from the cable, adds
    const Real bow = (0.125 * length) * bend_rad * (1.0 - b2 * (1.0 / 48) + n_middle * softer);
    const Real sag = (bow * n_middle - (length / 192) * bend_rad * skew * v_middle) *
                     (1.0 + (length / 24) * f_.skew_per_Nmm * n_middle);
    const Real curl = (-2.0 / 3) * f_.skew_per_Nmm * sag;
    const Real strain2 = f_.strain_per_rad * f_.strain_per_rad;
    const Real stiffer = (1.0 + f_.stiffening * f_.axial_per_N * n_middle) / (1.0 + f_.softening * strain2 * (b2 + s2));
    residual[0] = moment(bend_rad) * stiffer + stop - 0.5 * (m_start + m_end) - (2.0 / 3) * sag;

    // axis: its chord, bent; what force takes from it along and across, which turn with it
    const Real elongated = length * (1.0 + f_.elongation * strain2 * (b2 + s2 * (1.0 / 3)));
    const Real chord =
        elongated * (1.0 - b2 * (1.0 / 24 - b2 * (1.0 / 1920)) - s2 * (1.0 / 360) + bend_rad * curl * (1.0 / 30));
    const Real turned = softer * b2 * (1.0 / 12 - b2 * (1.0 / 240));
    const Real ahead = chord - length * n_middle * (f_.axial_per_N + turned);
    const Real aside = length * (b2 * skew * (1.0 / 360) - v_middle * (f_.shear_per_N - turned));
    const Real x = -half - f_.before.along(m_start, force_x, force_y) + ahead * c - aside * s;
    const Real y = -1.0 * f_.before.across(m_start, force_x, force_y) + ahead * s + aside * c;
    const Real root_x = half + f_.beyond.along(m_end, n_end, v_end);
    const Real root_y = -1.0 * f_.beyond.across(m_end, n_end, v_end);
    residual[1] = u_ - (x - cosine_ * root_x - sine_ * root_y);
    residual[2] = v_ - (y + sine_ * root_x - cosine_ * root_y);
  }

 private:
  // Of the cable's line about a point in the frame before the joint, positive where it closes.
  Real arm(const Real& x, const Real& y) const {
    return (f_.half_cosine * f_.entry_mm + y) * along_x_ - (f_.half_sine * f_.entry_mm + x) * along_y_;
  }

  const FlexureOf<Shape>& f_;
  Real q_, u_, v_, sine_, cosine_;
  Real along_x_, along_y_;  // of the cable across the groove
};

// A design's joints and links of mode F, in the numbers that `Real` tells about them.
template <typename Real>
struct FlexuresOf {
  PerJoint<FlexureOf<Real>> joint;
  PerJoint<LinkEndOf<Real>> exit_end, entry_end;  // of link j: behind joint j, before joint j+1 (or at the tip)
  PerJoint<Real> straight_span_mm{}, thickness_mm{};
  std::array<Real, kMaxJoints + 1> slope_rad{}, link_span_mm{};  // of the cable inside link k-1
  Real softness{};                                               // 1 over a factor on all moduli

  // Bends of the cable at joint j against the links' ends, which turn with the tension.
  template <typename Number>
  Number exit_bend(int j, const Number& span_rad, const Number& q, const Number& link_tension) const {
    return span_rad - slope_rad[j + 1] + q + exit_end[j].turn * link_tension;
  }
  template <typename Number>
  Number entry_bend(int j, const Number& span_rad, const Number& tension) const {
    const Real turn = j > 0 ? entry_end[j - 1].turn : Real(0.0);
    return slope_rad[j] - span_rad + turn * tension;
  }
  // By which the link behind joint j becomes shorter under its cable, per newton.
  Real link_shortening(int j) const { return exit_end[j].shortening + entry_end[j].shortening; }
};

// What takes integrals of the design: once for each finger.
struct FlexureSides {
  PerJoint<JointSide> entry, exit;
  ComplianceOf<ShapeJet> tip;  // of the last link's outer half

  FlexureSides() = default;
  explicit FlexureSides(const Design& d) {
    for (int j = 0; j < d.joints; ++j) {
      const double before =
          j > 0 ? 0.5 * d.link_mm[j - 1] : d.routing_mm[0] + d.length_mm[0];  // held: of no consequence
      entry[j] = JointSide(d, j, d.routing_mm[2 * j], before);
      exit[j] = JointSide(d, j, d.routing_mm[2 * j + 1], 0.5 * d.link_mm[j]);
    }
    const int last = d.joints - 1;
    const double length = d.link_mm[last];
    const LinkSection section(d, last, ShapeJet::variable(d.thickness_mm[last], 0));
    tip = section.compliance(ShapeJet(0.5 * length), ShapeJet(length), length);
  }
};

// Joints and links from the integrals. `lift(x, joint, point)` takes a ShapeJet of a joint's thickness and a point's
// routing to a Real; `softness` divides all moduli.
template <typename Real, typename Lift>
FlexuresOf<Real> flexures_of(const Design& d, const FlexureSides& sides, const PerJoint<Real>& thickness_mm,
                             const PerPoint<Real>& routing_mm, const Real& softness, const Lift& lift) {
  auto lifted = [&](const ComplianceOf<ShapeJet>& c, int joint, int point) {
    auto to = [&](const ShapeJet& x) { return lift(x, joint, point) * softness; };
    return ComplianceOf<Real>{to(c.mm), to(c.mn), to(c.mv), to(c.nn), to(c.nv), to(c.vv)};
  };
  auto end = [](const ComplianceOf<Real>& c, const Real& m, const Real& n, const Real& v) {
    const LinkEndOf<Real> found{c.turn(m, n, v), c.along(m, n, v), c.across(m, n, v), Real(0.0)};
    return LinkEndOf<Real>{found.turn, found.along, found.across, m * found.turn + n * found.along + v * found.across};
  };
  FlexuresOf<Real> out;
  const int n = d.joints;
  out.thickness_mm = thickness_mm;
  out.softness = softness;
  out.link_span_mm[0] = Real(d.cable.lead_mm + d.base_mm);
  for (int j = 0; j < n; ++j) {
    const JointSide& entry = sides.entry[j];
    const JointSide& exit = sides.exit[j];
    FlexureOf<Real>& f = out.joint[j];
    f.entry_mm = routing_mm[2 * j];
    f.exit_mm = routing_mm[2 * j + 1];
    f.half_sine = exit.half_sine;
    f.half_cosine = exit.half_cosine;
    f.half_length_mm = 0.5 * d.length_mm[j];
    if (j > 0) f.before = lifted(entry.root, j, 2 * j);
    f.beyond = lifted(exit.root, j, 2 * j + 1);
    const double length = d.length_mm[j], modulus = flexure_modulus_MPa(d, j);
    const Real area_softness = softness / (thickness_mm[j] * d.width_mm[j]);
    f.axial_per_N = area_softness * (1.0 / modulus);
    f.shear_per_N = area_softness * (1.0 / shear_modulus_MPa(d));
    f.skew_per_Nmm = area_softness * (6.0 * length / (d.study.strip * modulus)) / (thickness_mm[j] * thickness_mm[j]);
    f.strain_per_rad = thickness_mm[j] * (1.0 / length);
    f.elongation = d.study.elongation;
    f.stiffening = 24.0 * d.study.elongation;  // reciprocity: bending does to the axis what compression does to bending
    f.softening = d.study.softening;
    out.straight_span_mm[j] = FlexureState<Real, Real>(f, Real(0.0), Real(0.0), Real(0.0)).span_mm;

    // the link behind the joint: its cable runs from (x, y) by (dx, dy), seen from the joint's apex
    const Real x = f.half_sine * f.exit_mm, depth = f.half_cosine * f.exit_mm;
    const ComplianceOf<Real> inner = lifted(exit.link, j, 2 * j + 1);
    if (j + 1 == n) {
      out.exit_end[j] = end(inner, depth, Real(1.0), Real(0.0));
      out.entry_end[j] = end(lifted(sides.tip, j, 2 * j + 1), depth, Real(1.0), Real(0.0));
      out.link_span_mm[n] = d.link_mm[j] - x;
      continue;
    }
    const JointSide& next = sides.entry[j + 1];
    const Real next_x = next.half_sine * routing_mm[2 * j + 2], next_depth = next.half_cosine * routing_mm[2 * j + 2];
    const Real dx = d.link_mm[j] - x - next_x, deeper = next_depth - depth;
    const Real span = sqrt(Real(dx * dx + deeper * deeper)), per_span = 1.0 / span;
    out.link_span_mm[j + 1] = span;
    out.slope_rad[j + 1] = direction_of(Real(-1.0 * deeper), dx);
    const Real along = dx * per_span, across = deeper * per_span;
    out.exit_end[j] = end(inner, along * depth - across * x, along, across);
    out.entry_end[j] =
        end(lifted(next.link, j + 1, 2 * j + 2), along * next_depth + across * next_x, along, -1.0 * across);
  }
  return out;
}

// A link's middle at a tension, seen from the frame at its near end; and the frame at its far end, seen from the
// middle. The middle's origin is where the near end was before the link gave.
template <typename Real, typename Shape>
PoseOf<Real> link_middle(const LinkEndOf<Shape>& exit, const Real& tension) {
  return PoseOf<Real>::turned(exit.turn * tension, exit.along * tension, -1.0 * exit.across * tension).inverse();
}
template <typename Real, typename Shape>
PoseOf<Real> link_far_end(double length_mm, const LinkEndOf<Shape>& entry, const Real& tension) {
  return PoseOf<Real>::turned(-1.0 * entry.turn * tension, length_mm - entry.along * tension,
                              -1.0 * entry.across * tension);
}

// Where a finger's links are, from the states of its joints and the tensions in its links.
template <typename Real, typename Shape>
struct FlexurePosture {
  PerJoint<Real> angle_rad{};  // from the middle of one link to that of the next
  Real x_mm{}, y_mm{};         // of the tip

  FlexurePosture(const Design& d, const FlexuresOf<Shape>& f, const PerJoint<Real>& q,
                 const PerJoint<std::array<Real, 2>>& shift_mm, const PerJoint<Real>& link_tension) {
    PoseOf<Real> at;
    for (int j = 0; j < d.joints; ++j) {
      const LinkEndOf<Shape>&exit = f.exit_end[j], &entry = f.entry_end[j];
      const Real& tension = link_tension[j];
      angle_rad[j] += q[j] + exit.turn * tension;
      if (j + 1 < d.joints) angle_rad[j + 1] += entry.turn * tension;
      at = at.after(PoseOf<Real>::turned(-1.0 * q[j], shift_mm[j][0], shift_mm[j][1]));
      at = at.after(link_middle<Real>(exit, tension)).after(link_far_end<Real>(d.link_mm[j], entry, tension));
    }
    x_mm = at.x;
    y_mm = at.y;
  }
};

}  // namespace softgrip::finger
