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
  // parts: how many values of each kind follow one another in a vector. A thread's share of a vector is its share of
  // every part, as wherever else threads share parts: values then stay in its cache.
  Anderson(std::vector<std::size_t> parts, int window, int threads);

  void forget() { stored_ = 0, next_ = 0, has_last_ = false; }

  // residual = f(point); writes the accelerated step into `step` and, where told to, adds it to the point. Where the
  // residual has grown a lot the history no longer fits and is forgotten. Bits depend on the number of threads, not on
  // their timing.
  void advance(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step, bool take);

 private:
  // The small system of the weights of the history. Every thread keeps and solves its own, of the same values: they
  // meet once less.
  struct System {
    Eigen::MatrixXd gram;
    Eigen::VectorXd weight;
    double squared = 0.0;  // |residual|^2
    bool fits = false;     // the history fits the residual
  };

  float* column(std::vector<float>& all, int k) { return &all[static_cast<std::size_t>(k) * size_]; }
  template <class Pass>
  void each_part(int thread, const Pass& pass) const;
  void complete(System& system) const;
  void begin_history(const std::vector<double>& point, const std::vector<double>& residual);
  bool accelerated(std::vector<double>& point, const std::vector<double>& residual, std::vector<double>& step,
                   bool take);

  std::vector<std::size_t> parts_;
  std::size_t size_;
  int window_, threads_, stored_ = 0, next_ = 0;
  bool has_last_ = false;
  double last_squared_ = 0.0;    // |last residual|^2
  std::vector<System> systems_;  // per thread
  std::vector<float> residual_changes_, steps_;
  std::vector<double> last_residual_, last_point_;
  std::vector<double> sums_;  // [thread][2 * window + 1]: of StorePass
};

}  // namespace softgrip::gdfe
