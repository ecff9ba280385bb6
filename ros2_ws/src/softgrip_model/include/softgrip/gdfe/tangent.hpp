// SPDX-License-Identifier: Apache-2.0
// The rigorous law's own tangent in place of the constant matrix: where a material hardly gives way in volume, the
// constant matrix answers shape as stiffly as volume, and needs thousands of iterations.
//
// With K the elements' tangent, S how the cables' forces fall as their points move and P what these hang on, it is
// A = K + P S P^T. Friction makes S unsymmetric: its symmetric part is factored with K, the rest N answers by
// Woodbury's identity, A^-1 = B^-1 - B^-1 P (1 + N P^T B^-1 P)^-1 N P^T B^-1 with B = K + P (S + S^T)/2 P^T.
//
// A factor is kept as long as steps with it, accelerated, shrink the residual well. Its pivots say how many motions
// lower the energy: an equilibrium with any is not stable (Sylvester's law of inertia).
#pragma once

#include <Eigen/LU>
#include <vector>

#include "softgrip/gdfe/cable_system.hpp"
#include "softgrip/gdfe/force_assembly.hpp"
#include "softgrip/gdfe/panel_cholesky.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

class Tangent {
 public:
  // Whether it may stand in: the rigorous law, nothing but cables on the mesh whose forces depend on the state, not too
  // large.
  static bool is_fit_for(const Problem& problem, const Settings& settings, const Unknowns& unknowns);

  Tangent(const Problem& problem, const Settings& settings, const Unknowns& unknowns, const ForceAssembly& forces,
          const CableSystem& cables);

  // A solve begins: no factor yet.
  void restart();

  // Looks at the residual before iteration k and takes another factor at the positions of the last forces if one is
  // due. Returns whether steps are of another kind than before.
  bool follow(int k, double residual, const Task& task, const std::vector<double>& x);

  // Whether the last step, one with the factor, led away from the equilibrium: then it is to be taken back, and the
  // factor is not used for a while.
  bool has_overshot(double residual, bool is_sound);

  // The factor is there and positive definite: without that its steps may lead to a saddle.
  bool is_usable() const { return is_usable_; }

  // In place: the factor's answer to a residual on the mesh.
  void apply(std::vector<double>& residual) const;

  // Its answer to forces on the points of a cable.
  Eigen::VectorXd answer(std::size_t cable, const Eigen::Matrix3Xd& force) const;

  // How many independent motions lower the energy at the positions of the last forces; -1 where no factor exists, or
  // with cables: friction has no energy.
  int count_unstable_modes(const Task& task, const std::vector<double>& x);

 private:
  void refuse(double residual);
  bool factorise(const Task& task, const std::vector<double>& x);
  bool assemble(const Task& task, const std::vector<double>& x);
  std::vector<Eigen::Triplet<double>> element_entries() const;
  Eigen::MatrixXd cable_stiffness(const Task& task, const std::vector<double>& x) const;

  const Hexes hexes_;
  const Unknowns& unknowns_;
  const ForceAssembly& forces_;
  const CableSystem& cables_;
  const Eigen::SparseMatrix<double> reach_;  // P
  const int first_iteration_;
  SparseMatrix matrix_;  // B
  PanelCholesky factor_;
  Eigen::MatrixXd columns_, point_answer_;         // B^-1 P, P^T B^-1 P
  Eigen::MatrixXd unsymmetric_;                    // N
  Eigen::PartialPivLU<Eigen::MatrixXd> coupling_;  // of 1 + N P^T B^-1 P
  bool is_usable_ = false;
  int wait_ = 0;
  double last_residual_ = 0.0, refused_residual_ = 0.0;
};

}  // namespace softgrip::gdfe
