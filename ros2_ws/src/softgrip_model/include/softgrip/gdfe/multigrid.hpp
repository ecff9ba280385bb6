// SPDX-License-Identifier: Apache-2.0
// One V-cycle of smoothed aggregation (Vanek, Mandel, Brezina 1996) in place of a factor: bytes and time per
// application grow with the mesh, not faster.
//
// L is a weighted scalar Laplacian on every axis, so its near kernel is the constant alone, and the columns of the
// three axes go through one hierarchy together. Aggregates follow distances between nodes, not entries of L: those of
// trilinear hexahedra say little about what is strongly coupled (face neighbours of a cube have none at all). Smoothing
// is by Chebyshev polynomials of D^-1 L, the same before and after, so that the cycle is symmetric and does not depend
// on the number of threads.
#pragma once

#include <cstdint>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"

namespace softgrip::gdfe {

template <class T>
struct SparseRows {
  std::vector<std::int32_t> start, column;
  std::vector<T> value;

  int rows() const { return static_cast<int>(start.size()) - 1; }
  std::size_t bytes() const {
    return value.size() * (sizeof(T) + sizeof(std::int32_t)) + start.size() * sizeof(std::int32_t);
  }
};

// Consecutive rows that are worked on together.
inline constexpr int kRowsAbreast = 4;

constexpr int whole_blocks(int rows) {
  return (rows + kRowsAbreast - 1) / kRowsAbreast * kRowsAbreast;
}

// Blocks of kRowsAbreast rows that share how far their columns are from the row, as along the lines of a grid: an entry
// is one distance and a value for each row, zero where a row has none. Equal blocks are kept once: in a regular grid
// all that is left of the matrix stays in the cache.
template <class T>
struct BlockedRows {
  std::vector<std::int32_t> start;     // of each distinct block's entries
  std::vector<std::int32_t> distinct;  // of each block
  std::vector<std::int32_t> distance;  // of each entry: column less row
  std::vector<T> value;                // [entry][kRowsAbreast]

  bool empty() const { return distinct.empty(); }
  int blocks() const { return static_cast<int>(distinct.size()); }
  std::size_t bytes() const {
    return value.size() * sizeof(T) + (start.size() + distinct.size() + distance.size()) * sizeof(std::int32_t);
  }
};

// Blocks of kRowsAbreast rows that share columns: an entry is one column and a value for each row.
template <class T>
struct SharedColumns {
  std::vector<std::int32_t> start, column;
  std::vector<T> value;  // [entry][kRowsAbreast]

  int blocks() const { return static_cast<int>(start.size()) - 1; }
  std::size_t bytes() const { return value.size() * sizeof(T) + (start.size() + column.size()) * sizeof(std::int32_t); }
};

template <class T>
struct MultigridLevel {
  int rows = 0;
  SparseRows<T> matrix;  // one of the two is empty
  BlockedRows<T> blocked;
  SharedColumns<T> prolongation;    // from the next level
  SparseRows<T> restriction;        // to it
  std::vector<T> inverse_diagonal;  // zero beyond the last row
  std::size_t entries = 0;          // of the matrix
  double largest_eigenvalue = 0.0;  // of D^-1 matrix, a little above it
};

template <class T>
struct MultigridStore {
  std::vector<MultigridLevel<T>> levels;  // finest first, without the coarsest
  std::vector<T> coarsest_inverse;        // dense, row by row
  int coarsest_size = 0;
  double scale = 1.0;  // of a right-hand side
};

// Matrix-vector products of one smoothing with the finest matrix, plus one: the degree of the polynomial.
inline constexpr int kSmoothingDegree = 1;

class Multigrid final : public ConstantInverse {
 public:
  // matrix: symmetric positive definite, both triangles. places: where each unknown is, (size, 3).
  // Throws std::runtime_error when the matrix is not positive definite.
  Multigrid(const SparseMatrix& matrix, const Eigen::MatrixX3d& places, bool single_precision, int threads);

  int size() const override { return static_cast<int>(matrix_.rows()); }
  std::size_t nonzeros() const override { return nonzeros_; }
  std::size_t bytes() const override { return bytes_; }
  const std::vector<int>& position() const override { return position_; }
  void apply(double* const* columns, int count, std::vector<double>& scratch) const override;

  // Conjugate gradients preconditioned by apply(); throws std::runtime_error when they do not converge.
  void solve(double* const* columns, int count, std::vector<double>& scratch) const override;

  // Steps that solve() takes for this right-hand side.
  int solve_steps(Eigen::Ref<Eigen::VectorXd> column, std::vector<double>& scratch) const;

  // Unknowns of every level, finest first.
  const std::vector<int>& level_sizes() const { return level_sizes_; }

 private:
  SparseMatrix matrix_;
  int threads_;
  bool single_;
  std::vector<int> position_, level_sizes_;
  std::size_t nonzeros_ = 0, bytes_ = 0;
  MultigridStore<float> float_;
  MultigridStore<double> double_;
};

}  // namespace softgrip::gdfe
