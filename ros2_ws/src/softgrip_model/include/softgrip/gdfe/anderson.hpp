// SPDX-License-Identifier: Apache-2.0
// Anderson acceleration of a fixed-point iteration q <- q + f(q), type II, small window, normal equations.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <vector>

namespace softgrip::gdfe {

class Anderson {
 public:
  Anderson(std::size_t size, int window) : size_(size), window_(window), gram_(window, window) {
    residual_changes_.resize(size * static_cast<std::size_t>(window));
    steps_.resize(size * static_cast<std::size_t>(window));
    last_residual_.resize(size);
    last_point_.resize(size);
  }

  void forget() { stored_ = 0, next_ = 0, has_last_ = false; }

  // residual = f(point); writes the accelerated step into `step`.
  void advance(const std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step) {
    if (has_last_ && window_ > 0) store(point, residual);
    for (std::size_t i = 0; i < size_; ++i) last_residual_[i] = residual[i], last_point_[i] = point[i];
    has_last_ = true;
    step = residual;
    if (stored_ == 0) return;
    Eigen::MatrixXd gram = gram_.topLeftCorner(stored_, stored_);
    Eigen::VectorXd projection(stored_);
    for (int k = 0; k < stored_; ++k) projection(k) = dot(column(residual_changes_, k), residual.data());
    // columns differ by orders of magnitude as the iteration converges: scale before regularising
    const Eigen::VectorXd scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    gram = scale.asDiagonal() * gram * scale.asDiagonal();
    gram.diagonal().array() += kRegularisation;
    const Eigen::VectorXd gamma = scale.asDiagonal() * gram.ldlt().solve(scale.cwiseProduct(projection));
    if (!gamma.allFinite()) {
      forget();
      return;
    }
    for (int k = 0; k < stored_; ++k) {
      const double* direction = column(steps_, k);
      const double weight = gamma(k);
      for (std::size_t i = 0; i < size_; ++i) step[i] -= weight * direction[i];
    }
  }

 private:
  static constexpr double kRegularisation = 1e-12;

  const double* column(const std::vector<double>& all, int k) const { return &all[static_cast<std::size_t>(k) * size_]; }
  double* column(std::vector<double>& all, int k) { return &all[static_cast<std::size_t>(k) * size_]; }

  double dot(const double* a, const double* b) const {
    return Eigen::Map<const Eigen::VectorXd>(a, static_cast<Eigen::Index>(size_))
        .dot(Eigen::Map<const Eigen::VectorXd>(b, static_cast<Eigen::Index>(size_)));
  }

  void store(const std::vector<double>& point, const std::vector<double>& residual) {
    double* change = column(residual_changes_, next_);
    double* step = column(steps_, next_);
    for (std::size_t i = 0; i < size_; ++i) {
      change[i] = residual[i] - last_residual_[i];
      step[i] = (point[i] - last_point_[i]) + change[i];
    }
    stored_ = stored_ < window_ ? stored_ + 1 : window_;
    for (int k = 0; k < stored_; ++k) {
      gram_(next_, k) = gram_(k, next_) = dot(change, column(residual_changes_, k));
    }
    next_ = (next_ + 1) % window_;
  }

  std::size_t size_;
  int window_, stored_ = 0, next_ = 0;
  bool has_last_ = false;
  Eigen::MatrixXd gram_;
  std::vector<double> residual_changes_, steps_, last_residual_, last_point_;
};

}  // namespace softgrip::gdfe
