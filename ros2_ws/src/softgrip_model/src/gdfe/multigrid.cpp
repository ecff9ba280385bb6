// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/multigrid.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <numeric>
#include <stdexcept>

#include "softgrip/gdfe/aggregation.hpp"
#include "softgrip/gdfe/blocked_rows.hpp"
#include "softgrip/gdfe/multigrid_cycle.hpp"

namespace softgrip::gdfe {
namespace {

// A matrix of this size is inverted.
constexpr int kCoarsest = 300;

// Coarsening that leaves more than this share of the unknowns is no use: what is left is inverted.
constexpr double kPoorCoarsening = 0.7;

// Reciprocal condition of a coarsest matrix that has a rigid motion.
constexpr double kSingular = 1e-11;

// The power iteration stays below the largest eigenvalue.
constexpr double kEigenvalueMargin = 1.1;

constexpr double kSolveTolerance = 1e-8;
constexpr int kMaxSolveSteps = 500;

using RowMajor = Eigen::SparseMatrix<double, Eigen::RowMajor, int>;

template <class T>
SparseRows<T> pack(const RowMajor& matrix) {
  SparseRows<T> rows;
  const auto entries = static_cast<std::size_t>(matrix.nonZeros());
  rows.start.assign(matrix.outerIndexPtr(), matrix.outerIndexPtr() + matrix.rows() + 1);
  rows.column.assign(matrix.innerIndexPtr(), matrix.innerIndexPtr() + entries);
  rows.value.assign(matrix.valuePtr(), matrix.valuePtr() + entries);
  return rows;
}

template <class T>
MultigridStore<T> build(SparseMatrix matrix, Eigen::MatrixX3d places, std::vector<int>& sizes) {
  MultigridStore<T> store;
  store.scale = 1.0 / magnitude_of(matrix);
  matrix *= store.scale;
  sizes.push_back(static_cast<int>(matrix.rows()));
  while (matrix.rows() > kCoarsest) {
    const Eigen::VectorXd diagonal = matrix.diagonal();
    if (diagonal.minCoeff() <= 0.0) throw std::runtime_error("the constant matrix is not positive definite");
    const double eigenvalue = largest_eigenvalue(matrix);
    Coarsening coarse = coarsen(matrix, places, eigenvalue);
    const SparseMatrix& p = coarse.prolongation;
    if (static_cast<double>(p.cols()) > kPoorCoarsening * static_cast<double>(p.rows())) break;
    MultigridLevel<T> level;
    level.rows = static_cast<int>(matrix.rows());
    level.entries = static_cast<std::size_t>(matrix.nonZeros());
    level.blocked = blocked_rows<T>(matrix);
    if (level.blocked.empty()) level.matrix = pack<T>(matrix);  // symmetric
    level.prolongation = shared_columns<T>(RowMajor(p));
    level.restriction = pack<T>(RowMajor(p.transpose()));
    level.inverse_diagonal.resize(static_cast<std::size_t>(whole_blocks(level.rows)));
    for (Eigen::Index i = 0; i < diagonal.size(); ++i)
      level.inverse_diagonal[static_cast<std::size_t>(i)] = static_cast<T>(1.0 / diagonal(i));
    level.largest_eigenvalue = kEigenvalueMargin * eigenvalue;
    store.levels.push_back(std::move(level));
    const SparseMatrix product = matrix * p;
    matrix = p.transpose() * product;
    places = std::move(coarse.places);
    sizes.push_back(static_cast<int>(matrix.rows()));
  }
  const Eigen::LLT<Eigen::MatrixXd> factor{Eigen::MatrixXd(matrix)};
  if (factor.info() != Eigen::Success || factor.rcond() < kSingular) {
    throw std::runtime_error("the constant matrix is not positive definite: some part of the mesh is not held");
  }
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(matrix.rows(), matrix.rows()));
  store.coarsest_size = static_cast<int>(matrix.rows());
  store.coarsest_inverse.assign(inverse.data(), inverse.data() + inverse.size());
  return store;
}

// Products with the matrix per cycle: both smoothings but for the first from zero, and the residual between them.
constexpr std::size_t kProducts = 2 * kSmoothingDegree;

template <class T>
std::size_t bytes_of(const MultigridStore<T>& store) {
  std::size_t bytes = store.coarsest_inverse.size() * sizeof(T);
  for (const MultigridLevel<T>& level : store.levels) {
    bytes += kProducts * (level.matrix.bytes() + level.blocked.bytes()) + level.prolongation.bytes() +
             level.restriction.bytes();
  }
  return bytes;
}

}  // namespace

Multigrid::Multigrid(const SparseMatrix& matrix, const Eigen::MatrixX3d& places, bool single_precision, int threads)
    : matrix_(matrix),
      threads_(threads),
      single_(single_precision),
      position_(static_cast<std::size_t>(matrix.rows())) {
  std::iota(position_.begin(), position_.end(), 0);
  if (single_) {
    float_ = build<float>(matrix, places, level_sizes_);
  } else {
    double_ = build<double>(matrix, places, level_sizes_);
  }
  bytes_ = single_ ? bytes_of(float_) : bytes_of(double_);
  for (const auto& level : float_.levels) nonzeros_ += level.entries;
  for (const auto& level : double_.levels) nonzeros_ += level.entries;
}

void Multigrid::apply(double* const* columns, int count, std::vector<double>& scratch) const {
  std::size_t needed = kWorkAlignment / sizeof(double);
  for (const int size : level_sizes_) needed += kLevelVectors * vector_length(size);
  if (scratch.size() < needed) scratch.resize(needed);
  if (single_) {
    multigrid_cycle_float(float_, columns, count, threads_, reinterpret_cast<float*>(scratch.data()));
  } else {
    multigrid_cycle_double(double_, columns, count, threads_, scratch.data());
  }
}

void Multigrid::solve(double* const* columns, int count, std::vector<double>& scratch) const {
  for (int k = 0; k < count; ++k) solve_steps(Eigen::Map<Eigen::VectorXd>(columns[k], size()), scratch);
}

int Multigrid::solve_steps(Eigen::Ref<Eigen::VectorXd> column, std::vector<double>& scratch) const {
  const double target = kSolveTolerance * column.norm();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(column.size()), residual = column, direction, product;
  double energy = 0.0;
  for (int step = 0; step < kMaxSolveSteps; ++step) {
    if (residual.norm() <= target) {
      column = x;
      return step;
    }
    Eigen::VectorXd z = residual;
    double* data = z.data();
    apply(&data, 1, scratch);
    const double next = residual.dot(z);
    direction = step == 0 ? z : Eigen::VectorXd(z + next / energy * direction);
    energy = next;
    product = matrix_.selfadjointView<Eigen::Lower>() * direction;
    const double length = energy / direction.dot(product);
    x += length * direction;
    residual -= length * product;
  }
  throw std::runtime_error(
      "conjugate gradients with multigrid did not converge: elements of the mesh are very distorted");
}

}  // namespace softgrip::gdfe
