// SPDX-License-Identifier: Apache-2.0
// Solver for the constant matrix L of the outer iteration: a direct factor, or multigrid.
#pragma once

#include <Eigen/Sparse>
#include <cmath>
#include <cstddef>
#include <vector>

namespace softgrip::gdfe {

using SparseMatrix = Eigen::SparseMatrix<double, Eigen::ColMajor, int>;

// About the largest entry of the diagonal. A right-hand side divided by it has the size of displacements, whatever the
// unit of force: float neither overflows nor loses it. A power of four: to divide by it, or by its root, rounds
// nothing.
inline double magnitude_of(const SparseMatrix& matrix) {
  const double largest = matrix.rows() > 0 ? Eigen::VectorXd(matrix.diagonal()).maxCoeff() : 0.0;
  return largest > 0.0 ? std::ldexp(1.0, 2 * (std::ilogb(largest) / 2)) : 1.0;
}

class ConstantInverse {
 public:
  ConstantInverse() = default;
  ConstantInverse(const ConstantInverse&) = delete;
  ConstantInverse& operator=(const ConstantInverse&) = delete;
  virtual ~ConstantInverse() = default;

  virtual int size() const = 0;
  virtual std::size_t nonzeros() const = 0;

  // That one application must at least read.
  virtual std::size_t bytes() const = 0;

  // position[i] = place of unknown i in the order that apply() and solve() work in.
  virtual const std::vector<int>& position() const = 0;

  // columns[k], k < count <= 3: right-hand side in, M^-1 of it out, M a fixed symmetric positive definite matrix close
  // to L (L itself for a factor). scratch grows as needed.
  virtual void apply(double* const* columns, int count, std::vector<double>& scratch) const = 0;

  // The same with L itself, to about 1e-6 of the solution or better.
  virtual void solve(double* const* columns, int count, std::vector<double>& scratch) const = 0;
};

}  // namespace softgrip::gdfe
