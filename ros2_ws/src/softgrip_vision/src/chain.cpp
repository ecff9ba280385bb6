// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/chain.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace softgrip::vision {

using Eigen::Index;

namespace {

// One standard deviation of where the mount may really be before markers were seen: [m, m, rad].
constexpr double kMountStddev[3] = {2e-3, 2e-3, 2.0 * M_PI / 180.0};
// [rad] ... and of joint angles that nothing is known of.
constexpr double kAngleStddev = 1.0;
// Stop refining a measurement's linearisation below this step [m, m, rad], or after so many steps.
constexpr double kRelineariseStep = 1e-3;
constexpr int kRelineariseLimit = 4;
// [rad] A joint bent backwards further than this is not: fingers rest straight.
constexpr double kNearlyStraight = 3.0 * M_PI / 180.0;

// The rows of a state or covariance after a time: angles moved on by their speeds, speeds decayed.
template <class Rows>
void advance_rows(Rows&& rows, Index joints, double reach, double decay) {
  rows.middleRows(3, joints) += reach * rows.bottomRows(joints);
  rows.bottomRows(joints) *= decay;
}

}  // namespace

Chain::Chain(std::vector<double> link_lengths_m, double base_marker_m)
    : link_lengths_m_(std::move(link_lengths_m)), base_marker_m_(base_marker_m) {}

Points Chain::markers(const Vector& state) const {
  Points points(joints() + 2, 2);
  double x = state[0], y = state[1], heading = state[2];
  points.row(0) << x - base_marker_m_ * std::cos(heading), y - base_marker_m_ * std::sin(heading);
  points.row(1) << x, y;
  for (Index joint = 0; joint < joints(); ++joint) {
    heading -= state[3 + joint];
    x += link_lengths_m_[joint] * std::cos(heading);
    y += link_lengths_m_[joint] * std::sin(heading);
    points.row(joint + 2) << x, y;
  }
  return points;
}

Jacobian Chain::jacobian(const Points& points, Index marker) const {
  Jacobian jacobian = Jacobian::Zero(2, state_size());
  jacobian.leftCols<2>().setIdentity();
  const auto swing = [&](Index joint) {  // counter-clockwise around a joint
    const Vector2 arm = points.row(marker) - points.row(joint + 1);
    return Vector2(-arm.y(), arm.x());
  };
  jacobian.col(2) = swing(0);
  for (Index joint = 0; joint < marker - 1; ++joint) jacobian.col(3 + joint) = -swing(joint);  // closing: clockwise
  return jacobian;
}

Vector Chain::angles(const Points& points) const {
  const Points steps = points.bottomRows(joints() + 1) - points.topRows(joints() + 1);
  Vector angles(joints());
  for (Index joint = 0; joint < joints(); ++joint) {
    const double before = std::atan2(steps(joint, 1), steps(joint, 0));
    const double after = std::atan2(steps(joint + 1, 1), steps(joint + 1, 0));
    angles[joint] = std::remainder(before - after, 2.0 * M_PI);
  }
  return angles;
}

ChainFilter::ChainFilter(Chain chain) : chain_(std::move(chain)) {
  const Index n = chain_.joints();
  state = Vector::Zero(chain_.state_size());
  Vector deviation(chain_.state_size());
  deviation << kMountStddev[0], kMountStddev[1], kMountStddev[2], Vector::Constant(n, kAngleStddev),
      Vector::Constant(n, kSpeedStddev);
  covariance = deviation.array().square().matrix().asDiagonal();
}

void ChainFilter::place(const Points& points) {
  joint_angles() = chain_.angles(points);
}

void ChainFilter::predict(double seconds) {
  const Index n = chain_.joints();
  const double decay = std::exp(-seconds / kSpeedTime_s);
  const double reach = kSpeedTime_s * (1.0 - decay);
  advance_rows(state, n, reach, decay);
  advance_rows(covariance, n, reach, decay);
  advance_rows(covariance.transpose(), n, reach, decay);
  add_process_noise(seconds, decay);
}

// The exact discrete noise of an Ornstein-Uhlenbeck speed and its integral, and the mount's drift.
void ChainFilter::add_process_noise(double seconds, double decay) {
  const Index n = chain_.joints();
  const double tau = kSpeedTime_s, spectral = 2.0 * kSpeedStddev * kSpeedStddev / tau;
  const double angle = spectral * tau * tau * (seconds - 2 * tau * (1 - decay) + tau / 2 * (1 - decay * decay));
  const double cross = spectral * tau * tau / 2 * (1 - decay) * (1 - decay);
  const double speed = spectral * tau / 2 * (1 - decay * decay);
  for (Index i = 0; i < 3; ++i) covariance(i, i) += kMountDrift[i] * kMountDrift[i] * seconds;
  for (Index i = 3; i < 3 + n; ++i) {
    covariance(i, i) += angle;
    covariance(i, i + n) += cross;
    covariance(i + n, i) += cross;
    covariance(i + n, i + n) += speed;
  }
}

std::pair<Vector2, Matrix2> ChainFilter::expect(Index marker) const {
  const Points points = chain_.markers(state);
  const Jacobian jacobian = chain_.jacobian(points, marker);
  return {points.row(marker), jacobian * covariance * jacobian.transpose()};
}

void ChainFilter::update(Index marker, const Vector2& position, const Matrix2& noise) {
  const Vector prior = state;
  Jacobian jacobian;
  Eigen::Matrix<double, Eigen::Dynamic, 2> gain;
  for (int step = 0; step < kRelineariseLimit; ++step) {
    const Points points = chain_.markers(state);
    jacobian = chain_.jacobian(points, marker);
    const Eigen::Matrix<double, Eigen::Dynamic, 2> spread = covariance * jacobian.transpose();
    const Matrix2 innovation_spread = jacobian * spread + noise;
    gain = spread * innovation_spread.inverse();
    const Vector2 innovation = position - points.row(marker).transpose() - jacobian * (prior - state);
    const Vector refined = prior + gain * innovation;
    const double change = (refined - state).head(3 + chain_.joints()).cwiseAbs().maxCoeff();
    state = refined;
    if (change < kRelineariseStep) break;
  }
  const Matrix updated = covariance - gain * (jacobian * covariance);
  covariance = (updated + updated.transpose()) / 2;
}

Vector ChainFilter::settle_hidden(const std::vector<bool>& hidden) {
  Vector unknown = Vector::Zero(chain_.joints());
  for (Index marker = 2; marker <= chain_.joints(); ++marker) {
    if (!hidden[marker]) continue;
    // A hidden joint touches its own angle and those of its neighbours.
    const Index first = marker - 2, count = std::min<Index>(3, chain_.joints() - first);
    auto around = unknown.segment(first, count);
    if (hidden[marker + 1] || hidden[marker - 1]) {
      around.setConstant(M_PI);
      continue;
    }
    const double& angle = state[3 + marker - 1];
    if (angle < -kNearlyStraight) {
      Points points = chain_.markers(state);
      const Vector2 chord = points.row(marker + 1) - points.row(marker - 1);
      const Vector2 offset = points.row(marker) - points.row(marker - 1);
      const Vector2 mirrored = 2.0 * offset.dot(chord) / chord.squaredNorm() * chord - offset;
      points.row(marker) = points.row(marker - 1) + mirrored.transpose();
      place(points);
    }
    if (angle < kNearlyStraight) around = around.cwiseMax(std::abs(angle));
  }
  return unknown;
}

Vector ChainFilter::angles_stddev() const {
  return covariance.diagonal().segment(3, chain_.joints()).cwiseSqrt();
}

std::pair<Vector2, Vector2> ChainFilter::tip() const {
  Vector from_mount = state;
  from_mount.head<3>().setZero();
  const Points points = chain_.markers(from_mount);
  Jacobian jacobian = chain_.jacobian(points, points.rows() - 1);
  jacobian.leftCols<3>().setZero();
  const Matrix2 spread = jacobian * covariance * jacobian.transpose();
  return {points.bottomRows<1>(), spread.diagonal().cwiseSqrt()};
}

}  // namespace softgrip::vision
