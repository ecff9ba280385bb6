// SPDX-License-Identifier: Apache-2.0
// Corner forces of a unit cube under an affine deformation F are V0 G P^T: P is read back from them.
#include <gtest/gtest.h>

#include "meshes.hpp"
#include "softgrip/gdfe/local_step.hpp"

namespace softgrip::gdfe {
namespace {

using testing::make_block;
using testing::strided;

// P of one cube under F; omega: the thesis law's shape factor.
Eigen::Matrix3d stress(const Eigen::Matrix3d& f, Law law, VolumeShape shape, const SecantTables& tables,
                       double omega = 1.0) {
  const auto block = make_block({1, 1, 1}, Eigen::Vector3d::Ones());
  const std::vector<Element> elements{make_element(corners_of(block.rest, block.hexes, 0))};
  ElementBlocks blocks(elements, block.hexes, {0}, tables.lame_per_mu, {0.0});
  std::fill(blocks.omega.begin(), blocks.omega.end(), omega);
  std::vector<double> force(kStride * 8, 0.0);
  local_step(blocks, tables, law, shape, strided(block.rest * f.transpose()).data(), force.data(), 0, 1);
  Eigen::Matrix<double, 3, 8> corner_forces;
  for (int c = 0; c < 8; ++c) {
    const double* at = force.data() + kStride * static_cast<std::size_t>(block.hexes(0, c));
    corner_forces.col(c) << at[0], at[1], at[2];
  }
  // G^T X = I on any element: X^T undoes V0 G of a unit cube
  return corner_forces * corners_of(block.rest, block.hexes, 0);
}

Eigen::Matrix3d sheared() {
  Eigen::Matrix3d f;
  f << 1.3, 0.2, -0.1, 0.05, 0.9, 0.15, -0.2, 0.1, 1.1;
  return f;
}

Eigen::Matrix3d polar_rotation(const Eigen::Matrix3d& f) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(f, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

TEST(LocalStep, ThesisLawAimsAtTheMixOfRotationAndScaledVolume) {
  const Eigen::Matrix3d f = sheared(), scaled = f / std::cbrt(f.determinant());
  const double omega = 0.4;
  const Eigen::Matrix3d aim = omega * polar_rotation(f) + (1.0 - omega) * scaled;
  EXPECT_TRUE(stress(f, Law::Thesis, VolumeShape::Scale, testing::hooke(1.0, 0.3), omega).isApprox(f - aim, 1e-9));
}

// F* of det 1 nearest to F in principal axes: t_i - s_i = l / t_i for one l, found by bisection.
Eigen::Matrix3d nearest_of_unit_volume(const Eigen::Matrix3d& f) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(f, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d& s = svd.singularValues();
  const auto stretches = [&](double l) {
    return Eigen::Vector3d(0.5 * (s.array() + (s.array().square() + 4.0 * l).sqrt()));
  };
  double low = -0.25 * s.minCoeff() * s.minCoeff(), high = 100.0;
  for (int i = 0; i < 200; ++i) {
    const double middle = 0.5 * (low + high);
    (stretches(middle).prod() < 1.0 ? low : high) = middle;
  }
  return svd.matrixU() * stretches(high).asDiagonal() * svd.matrixV().transpose();
}

TEST(LocalStep, ThesisLawAimsAtTheNearestShapeOfUnitVolume) {
  const Eigen::Matrix3d f = sheared();
  const double omega = 0.4;
  const Eigen::Matrix3d aim = omega * polar_rotation(f) + (1.0 - omega) * nearest_of_unit_volume(f);
  EXPECT_TRUE(stress(f, Law::Thesis, VolumeShape::Proj, testing::hooke(1.0, 0.3), omega).isApprox(f - aim, 1e-8));
}

TEST(LocalStep, SmallStrainsObeyHookesLaw) {
  const double mu = 3.0, poisson = 0.3, lame = 2.0 * mu * poisson / (1.0 - 2.0 * poisson), size = 1e-6;
  Eigen::Matrix3d strain;
  strain << 1.0, 0.4, -0.2, 0.4, -0.5, 0.3, -0.2, 0.3, 0.7;
  strain *= size;
  const Eigen::Matrix3d expected = 2.0 * mu * strain + lame * strain.trace() * Eigen::Matrix3d::Identity();
  for (const VolumeShape shape : {VolumeShape::Proj, VolumeShape::Scale}) {
    const Eigen::Matrix3d found =
        stress(Eigen::Matrix3d::Identity() + strain, Law::Calibrated, shape, testing::hooke(mu, poisson));
    EXPECT_TRUE(found.isApprox(expected, 10 * size)) << found << "\n\n" << expected;
  }
}

TEST(LocalStep, RotationsCauseNoForce) {
  const Eigen::Matrix3d turned =
      Eigen::AngleAxisd(2.0, Eigen::Vector3d(1.0, 2.0, -1.0).normalized()).toRotationMatrix();
  for (const VolumeShape shape : {VolumeShape::Proj, VolumeShape::Scale}) {
    EXPECT_LT(stress(turned, Law::Calibrated, shape, testing::hooke(1.0, 0.4)).norm(), 1e-12);
  }
}

}  // namespace
}  // namespace softgrip::gdfe
