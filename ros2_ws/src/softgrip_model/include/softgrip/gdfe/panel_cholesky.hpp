// SPDX-License-Identifier: Apache-2.0
// A Cholesky factor that is taken again and again, of symmetric matrices of one pattern.
#pragma once

#include <Eigen/Dense>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"
#include "softgrip/gdfe/ordering.hpp"
#include "softgrip/gdfe/panel_factor.hpp"

namespace softgrip::gdfe {

class PanelCholesky {
 public:
  // Takes the factor of a matrix, both triangles; the first one decides the order of elimination, so the others must
  // have entries at its places only. Returns whether it is positive definite.
  bool factorise(const SparseMatrix& matrix);

  // In place: the last matrix' inverse times each column.
  void solve(Eigen::Ref<Eigen::MatrixXd> columns) const;

 private:
  Elimination elimination_;
  std::vector<DensePanel> panels_;
  double scale_ = 1.0;
};

}  // namespace softgrip::gdfe
