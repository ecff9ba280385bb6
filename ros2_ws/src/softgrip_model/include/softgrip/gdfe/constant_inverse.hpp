// SPDX-License-Identifier: Apache-2.0
// What undoes the constant matrix L in the outer iteration: a direct factor, or multigrid.
#pragma once

#include <Eigen/Sparse>
#include <cstddef>
#include <vector>

namespace softgrip::gdfe {

using SparseMatrix = Eigen::SparseMatrix<double, Eigen::ColMajor, int>;

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

  // columns[k], k < count <= 3: right-hand side in, M^-1 of it out, M a fixed symmetric positive definite matrix close to L
  // (L itself for a factor). scratch grows as needed.
  virtual void apply(double* const* columns, int count, std::vector<double>& scratch) const = 0;

  // The same with L itself, to about 1e-6 of the solution or better.
  virtual void solve(double* const* columns, int count, std::vector<double>& scratch) const = 0;
};

}  // namespace softgrip::gdfe
