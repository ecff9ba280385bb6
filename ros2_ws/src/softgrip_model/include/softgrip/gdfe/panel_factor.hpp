// SPDX-License-Identifier: Apache-2.0
// The Cholesky factor of a sparse matrix, in dense panels.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"
#include "softgrip/gdfe/ordering.hpp"

namespace softgrip::gdfe {

// Columns from `first` that have (nearly) the same rows.
struct DensePanel {
  int first = 0;
  std::vector<std::int32_t> rows;  // below its own, ascending
  Eigen::MatrixXd values;          // (own and other rows, columns), zero above the diagonal
};

// C with C C^T = scale * matrix in the order of elimination. matrix: symmetric; its lower triangle is read. Throws
// std::runtime_error when it is not positive definite.
std::vector<DensePanel> factor_panels(const SparseMatrix& matrix, double scale, const Elimination& elimination);

}  // namespace softgrip::gdfe
