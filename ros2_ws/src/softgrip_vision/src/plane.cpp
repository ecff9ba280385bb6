// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/plane.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace softgrip::vision {

using Eigen::Array2d;
using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;

namespace {

// [px] Newton's method on the lens ends with a step below this, or after so many steps outside of what it can show.
constexpr double kUndistortStep_px = 1e-9;
constexpr int kUndistortLimit = 20;

Vector2d apply(const Matrix3d& homography, const Vector2d& point) {
  return (homography * point.homogeneous()).hnormalized();
}

}  // namespace

Lens::Lens(const Matrix3d& matrix, const std::array<double, 8>& distortion)
    : focal_px_(matrix(0, 0), matrix(1, 1)), centre_px_(matrix(0, 2), matrix(1, 2)), k_(distortion) {}

Vector2d Lens::distort(const Vector2d& undistorted_px, Matrix2d* derivative) const {
  const auto [k1, k2, p1, p2, k3, k4, k5, k6] = k_;
  const Array2d ray = (undistorted_px.array() - centre_px_) / focal_px_;
  const double x = ray[0], y = ray[1], rr = x * x + y * y;
  // OpenCV, camera calibration, detailed description: radial (rational), then tangential
  const double above = 1.0 + rr * (k1 + rr * (k2 + rr * k3)), below = 1.0 + rr * (k4 + rr * (k5 + rr * k6));
  const double radial = above / below;
  const Array2d bent(x * radial + 2.0 * p1 * x * y + p2 * (rr + 2.0 * x * x),
                     y * radial + p1 * (rr + 2.0 * y * y) + 2.0 * p2 * x * y);
  if (derivative != nullptr) {
    const double above_by_rr = k1 + rr * (2.0 * k2 + rr * 3.0 * k3), below_by_rr = k4 + rr * (2.0 * k5 + rr * 3.0 * k6);
    const double steepness = 2.0 * (above_by_rr - radial * below_by_rr) / below;
    const double mixed = steepness * x * y + 2.0 * (p1 * x + p2 * y);
    *derivative << radial + steepness * x * x + 2.0 * p1 * y + 6.0 * p2 * x, mixed * focal_px_[0] / focal_px_[1],
        mixed * focal_px_[1] / focal_px_[0], radial + steepness * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
  }
  return (bent * focal_px_ + centre_px_).matrix();
}

Vector2d Lens::undistort(const Vector2d& pixel) const {
  Vector2d found = pixel;
  Matrix2d derivative;
  for (int i = 0; i < kUndistortLimit; ++i) {
    const Vector2d off = distort(found, &derivative) - pixel;
    const Vector2d step = derivative.inverse() * off;
    found -= step;
    if (step.cwiseAbs().maxCoeff() < kUndistortStep_px) break;
  }
  return found;
}

PlaneMap::PlaneMap(const Lens& lens, const Matrix3d& homography)
    : lens_(lens), to_image_(homography), to_plane_(homography.inverse()) {}

Vector2d PlaneMap::to_pixel(const Vector2d& point_m) const {
  return lens_.distort(apply(to_image_, point_m));
}

PlanePoint PlaneMap::to_plane(const Vector2d& pixel) const {
  const Vector2d undistorted_px = lens_.undistort(pixel);
  const Vector2d point = apply(to_plane_, undistorted_px);
  const double depth = to_plane_.row(2) * undistorted_px.homogeneous();
  const Matrix2d by_undistorted =
      (to_plane_.topLeftCorner<2, 2>() - point * to_plane_.bottomLeftCorner<1, 2>()) / depth;
  Matrix2d distortion;
  lens_.distort(undistorted_px, &distortion);
  return {point, by_undistorted * distortion.inverse()};
}

}  // namespace softgrip::vision
