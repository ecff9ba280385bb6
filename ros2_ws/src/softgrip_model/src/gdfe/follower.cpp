// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/follower.hpp"

#include <cmath>

namespace softgrip::gdfe {
namespace {

constexpr std::array<std::array<double, 2>, 4> kQuadSigns{{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};

Eigen::Vector3d at(const double* position, std::int32_t node) {
  const double* p = position + kStride * static_cast<std::size_t>(node);
  return {p[0], p[1], p[2]};
}

}  // namespace

void add_pressure(const PressedSurface& surface, double pressure, const double* position, double* load) {
  // the integrand N_a x,xi x x,eta is quadratic in xi and in eta: 2 x 2 Gauss points are exact
  const double point = 1.0 / std::sqrt(3.0);
  for (const auto& face : surface) {
    Eigen::Matrix<double, 4, 3> corners;
    for (int a = 0; a < 4; ++a) corners.row(a) = at(position, face[static_cast<std::size_t>(a)]);
    for (const auto& gauss : kQuadSigns) {
      const double xi = gauss[0] * point, eta = gauss[1] * point;
      Eigen::Vector4d shape, along_xi, along_eta;
      for (int a = 0; a < 4; ++a) {
        const auto& sign = kQuadSigns[static_cast<std::size_t>(a)];
        shape(a) = 0.25 * (1 + sign[0] * xi) * (1 + sign[1] * eta);
        along_xi(a) = 0.25 * sign[0] * (1 + sign[1] * eta);
        along_eta(a) = 0.25 * sign[1] * (1 + sign[0] * xi);
      }
      const Eigen::Vector3d tangent_xi = corners.transpose() * along_xi, tangent_eta = corners.transpose() * along_eta;
      const Eigen::Vector3d area = tangent_xi.cross(tangent_eta);
      for (int a = 0; a < 4; ++a) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
          load[kStride * static_cast<std::size_t>(face[static_cast<std::size_t>(a)]) + axis] -=
              pressure * shape(a) * area[static_cast<Eigen::Index>(axis)];
        }
      }
    }
  }
}

void add_follower_force(const FollowerPatch& patch, const Eigen::Vector3d& force, const Nodes& rest,
                        const double* position, double* load) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero(), rest_centre = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < patch.nodes.size(); ++k) {
    centre += patch.shares[k] * at(position, patch.nodes[k]);
    rest_centre += patch.shares[k] * rest.row(patch.nodes[k]).transpose();
  }
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (std::size_t k = 0; k < patch.nodes.size(); ++k) {
    spread += patch.shares[k] * (at(position, patch.nodes[k]) - centre) *
              (rest.row(patch.nodes[k]).transpose() - rest_centre).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(spread, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  if ((u * svd.matrixV().transpose()).determinant() < 0.0)
    u.col(2) *= -1.0;  // a flat patch leaves the third column open
  const Eigen::Vector3d turned = u * svd.matrixV().transpose() * force;
  for (std::size_t k = 0; k < patch.nodes.size(); ++k) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      load[kStride * static_cast<std::size_t>(patch.nodes[k]) + axis] +=
          patch.shares[k] * turned[static_cast<Eigen::Index>(axis)];
    }
  }
}

}  // namespace softgrip::gdfe
