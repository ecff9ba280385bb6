// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/mesh.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace softgrip::gdfe {

Corners shape_slopes(double xi, double eta, double zeta) {
  Corners slopes;
  for (int a = 0; a < 8; ++a) {
    const double sx = kCornerSigns[a][0], sy = kCornerSigns[a][1], sz = kCornerSigns[a][2];
    slopes(a, 0) = sx * (1 + sy * eta) * (1 + sz * zeta) / 8;
    slopes(a, 1) = sy * (1 + sx * xi) * (1 + sz * zeta) / 8;
    slopes(a, 2) = sz * (1 + sx * xi) * (1 + sy * eta) / 8;
  }
  return slopes;
}

namespace {

Eigen::Matrix<double, 8, 4> hourglass_patterns() {
  Eigen::Matrix<double, 8, 4> patterns;
  for (int a = 0; a < 8; ++a) {
    const double x = kCornerSigns[a][0], y = kCornerSigns[a][1], z = kCornerSigns[a][2];
    patterns.row(a) << y * z, x * z, x * y, x * y * z;
  }
  return patterns;
}

// Of the shape functions at the eight points a share `reach` of the way from the middle to the corners.
std::array<Corners, 8> slopes_at(double reach) {
  std::array<Corners, 8> slopes;
  for (std::size_t a = 0; a < 8; ++a) {
    const auto& sign = kCornerSigns[a];
    slopes[a] = shape_slopes(sign[0] * reach, sign[1] * reach, sign[2] * reach);
  }
  return slopes;
}

const std::array<Corners, 8>& gauss_slopes() {
  static const std::array<Corners, 8> slopes = slopes_at(1.0 / std::sqrt(3.0));
  return slopes;
}

const std::array<Corners, 8>& corner_slopes() {
  static const std::array<Corners, 8> slopes = slopes_at(1.0);
  return slopes;
}

}  // namespace

double min_jacobian(const Corners& rest) {
  double lowest = std::numeric_limits<double>::infinity();
  for (const auto* points : {&gauss_slopes(), &corner_slopes()}) {
    for (const Corners& slopes : *points)
      lowest = std::min(lowest, Eigen::Matrix3d(rest.transpose() * slopes).determinant());
  }
  return lowest;
}

Element make_element(const Corners& rest, Metric metric) {
  Element element;
  element.volume = 0.0;
  element.gradient.setZero();
  element.laplacian.setZero();
  for (const Corners& slopes : gauss_slopes()) {
    const Eigen::Matrix3d map = rest.transpose() * slopes;
    const double weight = map.determinant();
    const Corners gradient = slopes * map.inverse();
    element.volume += weight;
    element.gradient += weight * gradient;
    element.laplacian += weight * gradient * gradient.transpose();
  }
  element.gradient /= element.volume;
  const Eigen::Matrix<double, 8, 4> patterns = hourglass_patterns();
  element.hourglass_rest = patterns.transpose() * rest;
  const Eigen::Matrix<double, 8, 4> gamma = patterns - element.gradient * element.hourglass_rest.transpose();
  const Eigen::Matrix4d inverse = (gamma.transpose() * gamma).inverse();
  const Matrix8 beyond_affine = element.laplacian - element.volume * element.gradient * element.gradient.transpose();
  element.hourglass_stiffness = inverse * (gamma.transpose() * beyond_affine * gamma) * inverse;
  if (metric == Metric::Centring) {
    // Omega (I - 1 1^T / 8) on the patterns; Omega = V0 tr(G^T G) / 3 makes both metrics agree on a cube's affine
    // motions
    const double omega = element.volume * element.gradient.squaredNorm() / 3.0;
    element.hourglass_stiffness = omega * inverse;
    element.laplacian = element.volume * element.gradient * element.gradient.transpose() +
                        gamma * element.hourglass_stiffness * gamma.transpose();
  }
  return element;
}

}  // namespace softgrip::gdfe
