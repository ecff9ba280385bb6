// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/inverted.hpp"

#include <Eigen/Dense>
#include <algorithm>

namespace softgrip::gdfe {

void rotation_and_volume_of_inverted(const double* f, double* rotation, double* correction) {
  using Matrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  const Eigen::Matrix3d gradient = Eigen::Map<const Matrix>(f);
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(gradient, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  Eigen::Vector3d stretch = svd.singularValues();
  if ((u * svd.matrixV().transpose()).determinant() < 0) {  // the least stretch takes the sign
    u.col(2) = -u.col(2);
    stretch(2) = -stretch(2);
  }
  Eigen::Map<Matrix> r(rotation), d(correction);
  r = u * svd.matrixV().transpose();
  // towards the stretches that the element would have at unit volume were the least one alone to give it
  const double area = std::max(stretch(0) * stretch(1), 1e-3);
  const Eigen::Vector3d change(0, 0, std::min(1.0 / area, 2.0) - stretch(2));
  d = u * change.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace softgrip::gdfe
