// SPDX-License-Identifier: Apache-2.0
// Least-squares fit of a friction law within bounds, from several starts.
#pragma once

#include <Eigen/Dense>

#include "softgrip/friction.hpp"

namespace softgrip::friction {

// Relative: residual ln Rf_model - ln Rf. Absolute: Rf_model - Rf.
enum class Loss : std::uint8_t { Relative = 0, Absolute = 1 };

struct Data {
  Eigen::Map<const Eigen::VectorXd> angle_rad;
  Eigen::Map<const Eigen::VectorXd> tension_N;
  Eigen::Map<const Eigen::VectorXd> ratio;
  Eigen::Map<const Eigen::VectorXd> weight;  // residuals are multiplied by it
  Eigen::Index size() const { return angle_rad.size(); }
};

struct Bounds {
  Coefficients lower;
  Coefficients upper;
};

struct Fit {
  Coefficients coefficients{};
  double cost = std::numeric_limits<double>::infinity();  // half the sum of squared weighted residuals
  int iterations = 0;                                     // of the start that won
  bool converged = false;
};

// One local minimum, from one start (Levenberg-Marquardt with an active set for the bounds).
Fit fit_from(const Model& model, const Data& data, Loss loss, const Bounds& bounds, const Coefficients& start);

// The best local minimum over a ladder of n; each rung starts from the linear solution of the K -> 0 law at that n.
Fit fit(const Model& model, const Data& data, Loss loss, const Bounds& bounds);

}  // namespace softgrip::friction
