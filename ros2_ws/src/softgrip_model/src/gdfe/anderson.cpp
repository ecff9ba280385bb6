// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/anderson.hpp"

#include <algorithm>
#include <numeric>

#include "softgrip/gdfe/anderson_passes.hpp"

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
      systems_(static_cast<std::size_t>(threads_)) {
  for (System& system : systems_) system.gram.resize(window, window);
  residual_changes_.resize(size_ * static_cast<std::size_t>(window));
  steps_.resize(size_ * static_cast<std::size_t>(window));
  last_residual_.resize(size_);
  last_point_.resize(size_);
}

// pass(first, last) of a thread's share of every part.
template <class Pass>
void Anderson::each_part(int thread, const Pass& pass) const {
  const auto share = static_cast<std::size_t>(thread), shares = static_cast<std::size_t>(threads_);
  std::size_t begin = 0;
  for (const std::size_t part : parts_) {
    pass(begin + part * share / shares, begin + part * (share + 1) / shares);
    begin += part;
  }
}

void Anderson::advance(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step,
                       bool take) {
  step.resize(size_);
  if (has_last_ && accelerated(point, residual, step, take)) return;
  begin_history(point, residual);
  step = residual;
  for (std::size_t i = 0; take && i < size_; ++i) point[i] += step[i];
}

bool Anderson::accelerated(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step,
                           bool take) {
  stored_ = std::max(stored_, next_ + 1);
  std::vector<const float*> changes, steps;
  for (int k = 0; k < stored_; ++k) {
    changes.push_back(column(residual_changes_, k));
    steps.push_back(column(steps_, k));
  }
  const std::size_t window = static_cast<std::size_t>(window_), width = 2 * window + 1;
  sums_.assign(static_cast<std::size_t>(threads_) * width, 0.0);
#pragma omp parallel num_threads(threads_) if (threads_ > 1)
  {
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads_; ++t) {
      double* sums = &sums_[static_cast<std::size_t>(t) * width];
      const StorePass pass{point.data(),
                           residual.data(),
                           last_point_.data(),
                           last_residual_.data(),
                           column(residual_changes_, next_),
                           column(steps_, next_),
                           changes.data(),
                           stored_,
                           sums,
                           sums + window,
                           sums + 2 * window};
      each_part(t, [&](std::size_t first, std::size_t last) { store_pass(pass, first, last); });
    }
#pragma omp for schedule(static, 1) nowait
    for (int t = 0; t < threads_; ++t) {
      System& system = systems_[static_cast<std::size_t>(t)];
      complete(system);
      if (!system.fits) continue;
      const CombinePass pass{residual.data(), steps.data(), system.weight.data(),
                             stored_,         step.data(),  take ? point.data() : nullptr};
      each_part(t, [&](std::size_t first, std::size_t last) { combine_pass(pass, first, last); });
    }
  }
  last_squared_ = systems_.front().squared;
  next_ = (next_ + 1) % window_;
  return systems_.front().fits;
}

// The weights, from what the threads' passes have summed.
void Anderson::complete(System& system) const {
  const std::size_t window = static_cast<std::size_t>(window_), width = 2 * window + 1;
  const auto total = [&](std::size_t k) {
    double sum = 0.0;
    for (std::size_t at = k; at < sums_.size(); at += width)
      sum += sums_[at];  // in order: sums do not depend on timing
    return sum;
  };
  Eigen::VectorXd projection(stored_);  // of the residual on the columns of its changes
  for (int k = 0; k < stored_; ++k) {
    system.gram(next_, k) = system.gram(k, next_) = total(static_cast<std::size_t>(k));
    projection(k) = total(window + static_cast<std::size_t>(k));
  }
  system.squared = total(2 * window);
  system.fits = system.squared <= kGrowth * kGrowth * last_squared_;
  if (!system.fits) return;
  Eigen::MatrixXd gram = system.gram.topLeftCorner(stored_, stored_);
  // columns differ by orders of magnitude as the iteration converges: scale before regularising
  const Eigen::VectorXd scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  gram = scale.asDiagonal() * gram * scale.asDiagonal();
  gram.diagonal().array() += kRegularisation;
  system.weight = scale.asDiagonal() * gram.ldlt().solve(scale.cwiseProduct(projection));
  system.fits = system.weight.allFinite();
}

void Anderson::begin_history(const std::vector<double>& point, const std::vector<double>& residual) {
  forget();
  if (window_ == 0) return;
  has_last_ = true;
  last_squared_ = std::inner_product(residual.begin(), residual.end(), residual.begin(), 0.0);
  last_residual_ = residual;
  last_point_ = point;
}

}  // namespace softgrip::gdfe
