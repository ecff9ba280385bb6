// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/strip.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::plant {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kShearFactor = 5.0 / 6.0;
// A strip is as stiff as ever within this share of the largest energy that it has held.
constexpr double kSofteningSpread = 0.3;
// A root that does not give, for what has to be inverted.
constexpr double kRigid = 1e-5;

// Flexibility of an elastic half space at the foot of a strip (W. J. O'Donnell, J. Appl. Mech. 27 (1960) 461, as quoted
// by R. W. Cornell, J. Mech. Des. 103 (1981) 447, Eq 8): a moment turns it by 16.67/pi, a shear force turns it by
// (1 - 2 nu)/(1 - nu) in plane strain and shifts it by 1.534, a normal force sinks it by 1.534 / (2.4 (1 + nu)).
Eigen::Matrix3d root_stiffness(const StripMake& make, double side, double softness) {
  const double modulus_n_per_m = make.law.tension[0] / (1.0 - make.poisson * make.poisson) * make.width_m;
  const double h = make.thickness_m, nu = make.poisson;
  Eigen::Matrix3d flexibility = Eigen::Matrix3d::Zero();
  flexibility(0, 0) = 1.534 / (2.4 * (1.0 + nu));
  flexibility(1, 1) = 1.534;
  flexibility(1, 2) = flexibility(2, 1) = side * (1.0 - 2.0 * nu) / (1.0 - nu) / h;
  flexibility(2, 2) = 16.67 / kPi / (h * h);
  return (std::max(softness, kRigid) / modulus_n_per_m * flexibility).inverse();
}

}  // namespace

Strip::Strip(const StripMake& make)
    : make_(make),
      section_(make.law, make.thickness_m, make.width_m, 1.0 / (1.0 - make.poisson * make.poisson)),
      near_stiffness_(root_stiffness(make, 1.0, make.near_root)),
      far_stiffness_(root_stiffness(make, -1.0, make.far_root)) {
  const double shear_modulus = make.law.tension[0] / (2.0 * (1.0 + make.poisson));
  shear_flexibility_ = 1.0 / (kShearFactor * shear_modulus * make.width_m * make.thickness_m);
  for (std::size_t i = 0; i < kNodes; ++i) {
    nodes_[i] = {make.length_m * (double(i) / kElements - 0.5), 0.0, 0.0};
  }
  for (std::size_t i = 1; i + 1 < kBonds; ++i) bonds_[i].length_m = make.length_m / kElements;
  measure();
}

// -- strains and their forces ---------------------------------------------------------------------------------------

void Strip::measure() {
  measure_near_root(bonds_.front());
  for (std::size_t i = 0; i < kElements; ++i) measure_element(bonds_[i + 1], nodes_[i], nodes_[i + 1]);
  measure_far_root(bonds_.back());
}

void Strip::measure_near_root(Bond& bond) const {
  const Eigen::Vector3d strain = nodes_.front() + Pose(0.5 * make_.length_m, 0.0, 0.0);
  bond.shape.rightCols<3>().setIdentity();
  bond.tangent = near_stiffness_;
  bond.force = near_stiffness_ * strain;
}

// The strains of a piece of constant curvature: its chord is shorter than its arc by sin(d/2) / (d/2). Shear takes over
// what a moment that varies along the piece would bend it beyond that (the residual bending flexibility, R. H. MacNeal,
// Nucl. Eng. Des. 49 (1978) 225).
void Strip::measure_element(Bond& bond, const Pose& before, const Pose& behind) const {
  const double middle = 0.5 * (before.z() + behind.z()), turn = behind.z() - before.z();
  const double cos = std::cos(middle), sin = std::sin(middle);
  const double along = behind.x() - before.x(), across = behind.y() - before.y();
  const double a = cos * along + sin * across, b = cos * across - sin * along;
  const double chord = 1.0 - turn * turn / 24.0 * (1.0 - turn * turn / 80.0);
  const double chord_by_turn = -turn / 12.0 * (1.0 - turn * turn / 40.0);
  const double size = bond.length_m, stretch = a / (chord * size);

  const SectionForce section = section_.force(stretch - 1.0, turn / size);
  const double bending = std::max(section.by_curvature_nm2, 1e-12);
  const double shear_n = 1.0 / (shear_flexibility_ + size * size / (12.0 * bending));
  bond.force = Eigen::Vector3d(section.normal_n, shear_n * b / size, section.moment_nm);
  bond.energy_j_m =
      0.5 * (section.normal_n * (stretch - 1.0) + shear_n * b * b / (size * size) + section.moment_nm * turn / size);
  bond.tangent << section.by_strain_n, 0.0, section.by_both_nm,  //
      0.0, shear_n, 0.0,                                         //
      section.by_both_nm, 0.0, section.by_curvature_nm2;
  const double by_a = 1.0 / (chord * size), by_turn = -stretch * chord_by_turn / chord;
  bond.shape << -cos * by_a, -sin * by_a, 0.5 * b * by_a - by_turn, cos * by_a, sin * by_a, 0.5 * b * by_a + by_turn,
      sin / size, -cos / size, -0.5 * a / size, -sin / size, cos / size, -0.5 * a / size,  //
      0.0, 0.0, -1.0 / size, 0.0, 0.0, 1.0 / size;
}

void Strip::measure_far_root(Bond& bond) const {
  const Pose& node = nodes_.back();
  const double cos = std::cos(far_.z()), sin = std::sin(far_.z()), half = 0.5 * make_.length_m;
  // From where the far link's end is, in that link's axes.
  const double along = node.x() - far_.x() - half * cos, across = node.y() - far_.y() - half * sin;
  const double a = cos * along + sin * across, b = cos * across - sin * along;
  bond.tangent = far_stiffness_;
  bond.force = far_stiffness_ * Eigen::Vector3d(a, b, node.z() - far_.z());
  bond.shape << cos, sin, 0.0, -cos, -sin, b,  //
      -sin, cos, 0.0, sin, -cos, -a - half,    //
      0.0, 0.0, 1.0, 0.0, 0.0, -1.0;
}

// -- one step -------------------------------------------------------------------------------------------------------

// What running in has left of an element's stiffness at the strain it has now: a pseudo-elastic material that has been
// strained further before (R. W. Ogden and D. G. Roxburgh, Proc. R. Soc. A 455 (1999) 2861).
double Strip::intact(const Bond& bond) const {
  if (make_.softening <= 0.0 || bond.largest_j_m <= 0.0) return 1.0;
  const double below = std::max(bond.largest_j_m - bond.energy_j_m, 0.0);
  return 1.0 - make_.softening * std::erf(below / (kSofteningSpread * bond.largest_j_m));
}

StripForce Strip::condense(double dt_s, const Room& room) {
  const double viscous = 1.0 + make_.damping_s / dt_s;
  // Forces against the motion of a node, and the tangent on it, from the bonds before it.
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  Eigen::Matrix3d tangent = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < kBonds; ++i) {
    const Bond& bond = bonds_[i];
    const double kept = intact(bond), size = bond.length_m * room.stiffness;
    Eigen::Vector3d pull = kept * bond.force;
    for (const Eigen::Vector3d& relaxed : bond.relaxed) pull -= relaxed;
    pull *= size;
    const Eigen::Matrix3d stiff = (size * kept * viscous) * bond.tangent;
    const auto left = bond.shape.leftCols<3>(), right = bond.shape.rightCols<3>();
    const Eigen::Matrix3d stiff_right = stiff * right;
    if (i == 0) {
      force = right.transpose() * pull;
      tangent = right.transpose() * stiff_right;
      continue;
    }
    // The node before this bond: eliminated.
    const Eigen::Matrix3d across = left.transpose() * stiff_right;
    force += left.transpose() * pull;
    tangent += left.transpose() * stiff * left;
    const Eigen::Matrix3d inverse = tangent.inverse();
    own_[i - 1] = -inverse * force;
    with_next_[i - 1] = -inverse * across;
    force = right.transpose() * pull + across.transpose() * own_[i - 1];
    tangent = right.transpose() * stiff_right + across.transpose() * with_next_[i - 1];
  }
  return {force, tangent};
}

void Strip::move(const Pose& change, double share, double dt_s, const Room& room) {
  Pose behind = change;
  far_ += change;
  for (std::size_t i = kNodes; i-- > 0;) {
    behind = share * own_[i] + with_next_[i] * behind;
    nodes_[i] += behind;
  }
  measure();
  for (Bond& bond : bonds_) {
    bond.largest_j_m = std::max(bond.largest_j_m, bond.energy_j_m);
    const double kept = intact(bond);
    for (std::size_t k = 0; k < kRelaxations; ++k) {
      const double relaxing = std::min(1.0, room.pace * dt_s / make_.relaxing_time_s[k]);
      bond.relaxed[k] += relaxing * (make_.relaxing_share[k] * kept * bond.force - bond.relaxed[k]);
    }
  }
}

void Strip::restore(const double* energy_j_m) {
  for (std::size_t i = 0; i < kElements; ++i) bonds_[i + 1].largest_j_m = energy_j_m[i];
}

void Strip::recall(double* energy_j_m) const {
  for (std::size_t i = 0; i < kElements; ++i) energy_j_m[i] = bonds_[i + 1].largest_j_m;
}

}  // namespace softgrip::plant
