// SPDX-License-Identifier: Apache-2.0
// Where a finger's markers can be: a planar chain, filtered from frame to frame (softgrip_vision.chain).
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <utility>
#include <vector>

namespace softgrip::vision {

using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using Vector2 = Eigen::Vector2d;
using Matrix2 = Eigen::Matrix2d;
using Points = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
using Jacobian = Eigen::Matrix<double, 2, Eigen::Dynamic>;

// Random walk of the mount [m/sqrt(s), m/sqrt(s), rad/sqrt(s)]: it is screwed down.
constexpr double kMountDrift[3] = {2e-5, 2e-5, 0.02 * M_PI / 180.0};
// [rad/s] one standard deviation of a joint's speed, and [s] how long it keeps a speed (Singer's model, first order).
constexpr double kSpeedStddev = 5.0, kSpeedTime_s = 0.15;

// n joints, n + 2 markers: 0 the base marker, 1 .. n the joints, n + 1 the tip. A state is (3 + 2 n): the mount's
// [x, y, heading] [m, m, rad], n joint angles [rad], n joint speeds [rad/s].
class Chain {
 public:
  Chain(std::vector<double> link_lengths_m, double base_marker_m);

  Eigen::Index joints() const { return static_cast<Eigen::Index>(link_lengths_m_.size()); }
  Eigen::Index state_size() const { return 3 + 2 * joints(); }

  // (n + 2, 2) [m] at the first 3 + n entries of a state.
  Points markers(const Vector& state) const;
  // (2, 3 + 2 n) derivative of one marker's position by the state, at the (n + 2, 2) positions.
  Jacobian jacobian(const Points& points, Eigen::Index marker) const;
  // (n) [rad] of (n + 2, 2) positions.
  Vector angles(const Points& points) const;

 private:
  std::vector<double> link_lengths_m_;
  double base_marker_m_;
};

// Extended Kalman filter over one chain.
class ChainFilter {
 public:
  explicit ChainFilter(Chain chain);

  const Chain& chain() const { return chain_; }
  Vector state;
  Matrix covariance;

  // Start from marker positions [m] found by a search.
  void place(const Points& points);
  // Advance by a time [s] > 0.
  void predict(double seconds);
  // Position [m] of a marker as expected, and its covariance [m^2].
  std::pair<Vector2, Matrix2> expect(Eigen::Index marker) const;
  // [rad] where a link points as expected; 0 is the mount, 1 .. n the links.
  double heading(Eigen::Index link) const { return state[2] - state.segment(3, link).sum(); }
  // Take in a marker's position [m] with its covariance [m^2] (iterated EKF).
  void update(Eigen::Index marker, const Vector2& position, const Matrix2& noise);
  // Put hidden joints on the side that fingers bend to; (n) [rad] what stays unknown beside the filter.
  Vector settle_hidden(const std::vector<bool>& hidden);
  // Standard deviations (n) [rad] of the joint angles.
  Vector angles_stddev() const;
  // The tip [m] from the mount, and its standard deviations [m].
  std::pair<Vector2, Vector2> tip() const;

 private:
  auto joint_angles() { return state.segment(3, chain_.joints()); }
  void add_process_noise(double seconds, double decay);

  Chain chain_;
};

}  // namespace softgrip::vision
