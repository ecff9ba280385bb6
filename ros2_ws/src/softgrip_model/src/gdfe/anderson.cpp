// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/anderson.hpp"

#include <algorithm>
#include <numeric>

#include "src/gdfe/anderson_passes.hpp"

namespace softgrip::gdfe {
namespace {

constexpr double kRegularisation = 1e-12;

// A residual that grows this much between two iterations shows a history that no longer fits.
constexpr double kGrowth = 4.0;

// Shorter vectors are one thread's.
constexpr std::size_t kSharedFrom = 6000;

}  // namespace

Anderson::Anderson(std::vector<std::size_t> parts, int window, int threads)
    : parts_(std::move(parts)),
      size_(std::accumulate(parts_.begin(), parts_.end(), std::size_t{0})),
      window_(window),
      threads_(size_ < kSharedFrom ? 1 : threads),
      gram_(window, window),
      projection_(window) {
  residual_changes_.resize(size_ * static_cast<std::size_t>(window));
  steps_.resize(size_ * static_cast<std::size_t>(window));
  last_residual_.resize(size_);
  last_point_.resize(size_);
}

// pass(thread, first, last) of every thread's share of every part.
template <class Pass>
void Anderson::share_out(const Pass& pass) {
#pragma omp parallel for num_threads(threads_) schedule(static, 1) if (threads_ > 1)
  for (int t = 0; t < threads_; ++t) {
    const auto share = static_cast<std::size_t>(t), shares = static_cast<std::size_t>(threads_);
    std::size_t begin = 0;
    for (const std::size_t part : parts_) {
      pass(share, begin + part * share / shares, begin + part * (share + 1) / shares);
      begin += part;
    }
  }
}

void Anderson::advance(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step, bool take) {
  step.resize(size_);
  if (has_last_ && accelerated(point, residual, step, take)) return;
  begin_history(point, residual);
  step = residual;
  for (std::size_t i = 0; take && i < size_; ++i) point[i] += step[i];
}

bool Anderson::accelerated(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step, bool take) {
  const double before = last_squared_;
  store(point, residual);
  if (last_squared_ > kGrowth * kGrowth * before) return false;
  Eigen::MatrixXd gram = gram_.topLeftCorner(stored_, stored_);
  // columns differ by orders of magnitude as the iteration converges: scale before regularising
  const Eigen::VectorXd scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  gram = scale.asDiagonal() * gram * scale.asDiagonal();
  gram.diagonal().array() += kRegularisation;
  const Eigen::VectorXd gamma = scale.asDiagonal() * gram.ldlt().solve(scale.cwiseProduct(projection_.head(stored_)));
  if (!gamma.allFinite()) return false;
  std::vector<const float*> columns;
  for (int k = 0; k < stored_; ++k) columns.push_back(column(steps_, k));
  const CombinePass pass{residual.data(), columns.data(), gamma.data(), stored_, step.data(), take ? point.data() : nullptr};
  share_out([&](std::size_t, std::size_t first, std::size_t last) { combine_pass(pass, first, last); });
  return true;
}

void Anderson::begin_history(const std::vector<double>& point, const std::vector<double>& residual) {
  forget();
  if (window_ == 0) return;
  has_last_ = true;
  last_squared_ = std::inner_product(residual.begin(), residual.end(), residual.begin(), 0.0);
  last_residual_ = residual;
  last_point_ = point;
}

void Anderson::store(const std::vector<double>& point, const std::vector<double>& residual) {
  stored_ = std::max(stored_, next_ + 1);
  std::vector<const float*> columns;
  for (int k = 0; k < stored_; ++k) columns.push_back(column(residual_changes_, k));
  const std::size_t window = static_cast<std::size_t>(window_), width = 2 * window + 1;
  sums_.assign(static_cast<std::size_t>(threads_) * width, 0.0);
  share_out([&](std::size_t thread, std::size_t first, std::size_t last) {
    double* sums = &sums_[thread * width];
    const StorePass pass{point.data(),      residual.data(),  last_point_.data(), last_residual_.data(), column(residual_changes_, next_),
                         column(steps_, next_), columns.data(), stored_,         sums,                  sums + window,
                         sums + 2 * window};
    store_pass(pass, first, last);
  });
  const auto total = [&](std::size_t k) {
    double sum = 0.0;
    for (std::size_t at = k; at < sums_.size(); at += width) sum += sums_[at];  // in order: sums do not depend on timing
    return sum;
  };
  for (int k = 0; k < stored_; ++k) {
    gram_(next_, k) = gram_(k, next_) = total(static_cast<std::size_t>(k));
    projection_(k) = total(window + static_cast<std::size_t>(k));
  }
  last_squared_ = total(2 * window);
  next_ = (next_ + 1) % window_;
}

}  // namespace softgrip::gdfe
