// SPDX-License-Identifier: Apache-2.0
// z = L^-1 r: the constant matrix L = sum_e k_e K_e of every axis, Dirichlet rows eliminated, and its inverse, made
// once.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

class Preconditioner {
 public:
  // Throws std::runtime_error where a matrix turns out not to be positive definite.
  Preconditioner(const Problem& problem, const std::vector<Element>& elements, const Settings& settings);

  const Unknowns& unknowns() const { return unknowns_; }
  const ConstantInverse& inverse(std::size_t axis) const { return *inverse_[axis]; }

  // The first axis with the same matrix.
  std::size_t shared_dof_map(std::size_t axis) const { return shared_dof_map_[axis]; }

  // In place, of all the mesh's unknowns: a fixed symmetric positive definite matrix close to L^-1.
  void apply(std::vector<double>& residual);

  // In place, of one axis: L^-1 itself.
  void solve(std::size_t axis, double* column) { inverse_[axis]->solve(&column, 1, scratch_); }

 private:
  std::array<std::size_t, 3> shared_dof_map_{};
  std::array<std::shared_ptr<const ConstantInverse>, 3> inverse_;
  Unknowns unknowns_;
  std::vector<double> scratch_;
};

}  // namespace softgrip::gdfe
