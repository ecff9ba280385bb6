// SPDX-License-Identifier: Apache-2.0
// Between a finger's plane [m] and the image [px], through homography and lens (softgrip_vision.calibration).
#pragma once

#include <Eigen/Core>
#include <array>

namespace softgrip::vision {

// OpenCV's pinhole: x to the right, y down; a ray is (x, y) at distance 1.
class Lens {
 public:
  // Camera matrix [px] and k1 k2 p1 p2 k3 k4 k5 k6.
  Lens(const Eigen::Matrix3d& matrix, const std::array<double, 8>& distortion);

  // Pixel as the lens shows an undistorted one; `derivative`, unless null, is that of the one by the other.
  Eigen::Vector2d distort(const Eigen::Vector2d& undistorted_px, Eigen::Matrix2d* derivative = nullptr) const;
  // The inverse.
  Eigen::Vector2d undistort(const Eigen::Vector2d& pixel) const;

 private:
  Eigen::Array2d focal_px_;
  Eigen::Array2d centre_px_;
  std::array<double, 8> k_;
};

struct PlanePoint {
  Eigen::Vector2d point_m;
  Eigen::Matrix2d by_pixel;  // [m/px] its derivative
};

class PlaneMap {
 public:
  // The homography takes (x, y, 1) [m] to undistorted pixels.
  PlaneMap(const Lens& lens, const Eigen::Matrix3d& homography);

  Eigen::Vector2d to_pixel(const Eigen::Vector2d& point_m) const;
  PlanePoint to_plane(const Eigen::Vector2d& pixel) const;

 private:
  Lens lens_;
  Eigen::Matrix3d to_image_;
  Eigen::Matrix3d to_plane_;
};

}  // namespace softgrip::vision
