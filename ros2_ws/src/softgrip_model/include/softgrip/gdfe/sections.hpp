// SPDX-License-Identifier: Apache-2.0
// A second level for slender meshes: cross-sections that move as rigid bodies.
//
// The constant matrix answers the turning of all that lies beyond a hinge as if it stretched the material, and that by
// orders of magnitude too stiffly: such motions need many iterations. Nodes equally far from the support, in elements,
// are a section, unless the problem says which nodes are. Sections have six motions each, Z; the elements' tangent K on
// them is measured at one state by differences of forces. Only neighbours meet in an element, so three colours of
// sections times six motions measure it all, and Z^T K Z is block tridiagonal. With r the out-of-balance force and L
// the constant matrix a step is
//   a = (Z^T K Z)^-1 Z^T r,   Z a + L^-1 (r - K Z a),
// the operator A-DEF1 of Tang, Nabben, Vuik and Erlangga, J. Sci. Comput. 39 (2009) 340.
#pragma once

#include <Eigen/Dense>
#include <functional>
#include <vector>

#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

class Sections {
 public:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  // Positions [node][kStride] -> force on every unknown, axis by axis.
  using Forces = std::function<void(const std::vector<double>& position, std::vector<double>& force)>;

  // node_of: unknown -> its node, the same on every axis; the other nodes are the support. section_of: of every node,
  // from 0, those of the support are not looked at; empty: counted in elements from the support. Throws
  // std::invalid_argument where other than neighbours meet in an element, or a section has no node.
  Sections(const Hexes& hexes, std::size_t nodes, std::vector<std::int32_t> node_of,
           const std::vector<std::int32_t>& section_of = {});

  std::size_t count() const { return count_; }

  // Takes the tangent at a state, by differences over `step` [length]; false where it is singular.
  bool measure(const std::vector<double>& position, double step, const Forces& forces);

  // Z^T r, one row for each of 6 * count() motions; a single force on one unknown's node likewise, added.
  Eigen::VectorXd restricted(const std::vector<double>& residual) const;
  void add_force(std::size_t unknown, const Eigen::Vector3d& force, Eigen::Ref<Eigen::VectorXd> sum) const;

  // Forces -stiffness (W^T Z a) on what moves by W^T Z a belong to K as well; given Z^T W, a row for each motion.
  bool couple(const Eigen::MatrixXd& reach, const Eigen::MatrixXd& stiffness);

  // right <- (Z^T K Z)^-1 right
  void solve(Eigen::MatrixXd& right) const;

  // [rad]
  double largest_turn(const Eigen::VectorXd& amounts) const;

  // motion = Z a; residual -= K Z a, without what is coupled
  void move(const Eigen::VectorXd& amounts, std::vector<double>& motion, std::vector<double>& residual) const;

 private:
  // Motions of the section and its two neighbours, and the values of one motion on one node.
  static constexpr std::size_t kReach = 18, kLanes = 4;

  std::size_t neighbour(std::size_t unknown, std::size_t colour) const;
  void place_arms(const std::vector<double>& position);
  bool factor(std::vector<std::array<Matrix6, 3>> blocks);
  void solve_blocks(Eigen::MatrixXd& right) const;

  std::vector<std::int32_t> node_of_;
  std::vector<std::int32_t> section_;  // of every unknown
  std::size_t count_ = 0;
  std::vector<Eigen::Vector3d> arm_;  // from the middle of its section to every unknown's node, where measured
  std::vector<float> tangent_;        // K Z: [unknown][kReach][kLanes]
  std::vector<Eigen::PartialPivLU<Matrix6>> diagonal_;  // of the eliminated blocks
  std::vector<Matrix6> lower_, upper_;                  // below the diagonal; above it, divided by it
  Eigen::MatrixXd reach_, answer_;  // Z^T W; what the blocks answer to it, times what the coupling makes of W^T Z a
};

}  // namespace softgrip::gdfe
