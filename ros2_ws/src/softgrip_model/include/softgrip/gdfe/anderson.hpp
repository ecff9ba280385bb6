// SPDX-License-Identifier: Apache-2.0
// Anderson acceleration of a fixed-point iteration q <- q + f(q), type II, small window, normal equations.
//
// The history is kept in float and summed in double: it proposes steps only, and half the bytes are half the time.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <vector>

namespace softgrip::gdfe {

class Anderson {
 public:
  Anderson(std::size_t size, int window, int threads);

  void forget() { stored_ = 0, next_ = 0, has_last_ = false; }

  // residual = f(point); writes the accelerated step into `step`. Bits depend on the number of threads, not on their timing.
  void advance(const std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step);

 private:
  float* column(std::vector<float>& all, int k) { return &all[static_cast<std::size_t>(k) * size_]; }
  void store(const std::vector<double>& point, const std::vector<double>& residual);

  std::size_t size_;
  int window_, threads_, stored_ = 0, next_ = 0;
  bool has_last_ = false;
  Eigen::MatrixXd gram_;
  Eigen::VectorXd projection_;  // of the residual on the columns of its changes
  std::vector<float> residual_changes_, steps_;
  std::vector<double> last_residual_, last_point_;
  std::vector<double> sums_;  // [thread][2][window]
};

}  // namespace softgrip::gdfe
