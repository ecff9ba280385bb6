// SPDX-License-Identifier: Apache-2.0
// The rigorous law's own tangent in place of the constant matrix: where a material hardly gives way in volume, the
// constant matrix answers shape as stiffly as volume, and needs thousands of iterations.
//
// A factor is kept as long as steps with it, accelerated, shrink the residual well. Its pivots say how many motions
// lower the energy: an equilibrium with any is not stable (Sylvester's law of inertia).
#pragma once

#include <Eigen/SparseCholesky>
#include <vector>

#include "softgrip/gdfe/force_assembly.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

class Tangent {
 public:
  // Whether it may stand in: the rigorous law, nothing else on the mesh whose forces depend on the state, not too
  // large.
  static bool is_fit_for(const Problem& problem, const Settings& settings, const Unknowns& unknowns);

  Tangent(const Problem& problem, const Unknowns& unknowns, const ForceAssembly& forces);

  // A solve begins: no factor yet.
  void restart();

  // Looks at the residual of the next iteration and takes another factor at the positions of the last forces if one is
  // due. Returns whether steps are of another kind than before.
  bool follow(double residual);

  // The factor is there and positive definite: without that its steps may lead to a saddle.
  bool is_usable() const { return is_usable_; }

  // In place: the factor's answer to a residual.
  void apply(std::vector<double>& residual) const;

  // How many independent motions lower the energy at the positions of the last forces; -1 where no factor exists.
  int count_unstable_modes();

 private:
  bool factorise();

  const Hexes hexes_;
  const Unknowns& unknowns_;
  const ForceAssembly& forces_;
  Eigen::SparseMatrix<double> matrix_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Lower> factor_;
  bool is_usable_ = false, has_pattern_ = false;
  int wait_ = 0;
  double last_residual_ = 0.0;
};

}  // namespace softgrip::gdfe
