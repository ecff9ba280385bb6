// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/anderson.hpp"

#include <algorithm>

#include "src/gdfe/anderson_passes.hpp"

namespace softgrip::gdfe {
namespace {

constexpr double kRegularisation = 1e-12;

// Shorter vectors are one thread's.
constexpr std::size_t kSharedFrom = 6000;

}  // namespace

Anderson::Anderson(std::size_t size, int window, int threads)
    : size_(size), window_(window), threads_(size < kSharedFrom ? 1 : threads), gram_(window, window), projection_(window) {
  residual_changes_.resize(size * static_cast<std::size_t>(window));
  steps_.resize(size * static_cast<std::size_t>(window));
  last_residual_.resize(size);
  last_point_.resize(size);
  sums_.resize(2 * static_cast<std::size_t>(threads_) * static_cast<std::size_t>(window));
}

void Anderson::advance(const std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step) {
  if (window_ == 0 || !has_last_) {
    last_residual_ = residual;
    last_point_ = point;
    has_last_ = true;
    step = residual;
    return;
  }
  store(point, residual);
  Eigen::MatrixXd gram = gram_.topLeftCorner(stored_, stored_);
  // columns differ by orders of magnitude as the iteration converges: scale before regularising
  const Eigen::VectorXd scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  gram = scale.asDiagonal() * gram * scale.asDiagonal();
  gram.diagonal().array() += kRegularisation;
  const Eigen::VectorXd gamma = scale.asDiagonal() * gram.ldlt().solve(scale.cwiseProduct(projection_.head(stored_)));
  if (!gamma.allFinite()) {
    forget();
    step = residual;
    return;
  }
  std::vector<const float*> columns;
  for (int k = 0; k < stored_; ++k) columns.push_back(column(steps_, k));
  step.resize(size_);
  const CombinePass pass{residual.data(), columns.data(), gamma.data(), stored_, step.data()};
#pragma omp parallel for num_threads(threads_) schedule(static, 1) if (threads_ > 1)
  for (int t = 0; t < threads_; ++t) {
    combine_pass(pass, size_ * static_cast<std::size_t>(t) / static_cast<std::size_t>(threads_),
                 size_ * (static_cast<std::size_t>(t) + 1) / static_cast<std::size_t>(threads_));
  }
}

void Anderson::store(const std::vector<double>& point, const std::vector<double>& residual) {
  stored_ = std::max(stored_, next_ + 1);
  std::vector<const float*> columns;
  for (int k = 0; k < stored_; ++k) columns.push_back(column(residual_changes_, k));
  std::fill(sums_.begin(), sums_.end(), 0.0);
#pragma omp parallel for num_threads(threads_) schedule(static, 1) if (threads_ > 1)
  for (int t = 0; t < threads_; ++t) {
    double* sums = &sums_[2 * static_cast<std::size_t>(t) * static_cast<std::size_t>(window_)];
    const StorePass pass{point.data(),      residual.data(),  last_point_.data(), last_residual_.data(), column(residual_changes_, next_),
                         column(steps_, next_), columns.data(), stored_,         sums,                  sums + window_};
    store_pass(pass, size_ * static_cast<std::size_t>(t) / static_cast<std::size_t>(threads_),
               size_ * (static_cast<std::size_t>(t) + 1) / static_cast<std::size_t>(threads_));
  }
  for (int k = 0; k < stored_; ++k) {
    double on_change = 0.0, on_residual = 0.0;
    for (int t = 0; t < threads_; ++t) {  // in order, so that sums do not depend on timing
      const double* sums = &sums_[2 * static_cast<std::size_t>(t) * static_cast<std::size_t>(window_)];
      on_change += sums[k];
      on_residual += sums[window_ + k];
    }
    gram_(next_, k) = gram_(k, next_) = on_change;
    projection_(k) = on_residual;
  }
  next_ = (next_ + 1) % window_;
}

}  // namespace softgrip::gdfe
