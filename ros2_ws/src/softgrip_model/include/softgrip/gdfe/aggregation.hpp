// SPDX-License-Identifier: Apache-2.0
// The coarse levels of multigrid.cpp: aggregates of near nodes, and the smoothed prolongation from them.
#pragma once

#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"

namespace softgrip::gdfe {

struct Coarsening {
  SparseMatrix prolongation;  // (fine, coarse)
  Eigen::MatrixX3d places;    // mean of each aggregate
};

// matrix: symmetric, both triangles; eigenvalue: largest of D^-1 matrix.
Coarsening coarsen(const SparseMatrix& matrix, const Eigen::MatrixX3d& places, double eigenvalue);

// Largest eigenvalue of D^-1 matrix, from below, to a few percent.
double largest_eigenvalue(const SparseMatrix& matrix);

}  // namespace softgrip::gdfe
