// SPDX-License-Identifier: Apache-2.0
// Anderson acceleration of a linear iteration of n unknowns: as GMRES, n + 1 steps with a window of n (Walker and Ni
// 2011).
#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "softgrip/gdfe/anderson.hpp"

namespace softgrip::gdfe {
namespace {

TEST(Anderson, SolvesALinearIterationInAsManyStepsAsUnknowns) {
  constexpr Eigen::Index kSize = 6;
  // x <- x + (b - A x), which plain iteration would need hundreds of steps for
  const Eigen::VectorXd eigenvalues = Eigen::VectorXd::LinSpaced(kSize, 0.05, 0.9);
  const Eigen::MatrixXd turn =
      Eigen::HouseholderQR<Eigen::MatrixXd>(Eigen::MatrixXd::Random(kSize, kSize)).householderQ();
  const Eigen::MatrixXd matrix = turn * eigenvalues.asDiagonal() * turn.transpose();
  const Eigen::VectorXd right = Eigen::VectorXd::Random(kSize), solution = matrix.llt().solve(right);
  const auto error_after = [&](int window, int steps) {
    Anderson anderson({2, 3, 1}, window, 1);
    std::vector<double> x(kSize, 0.0), residual(kSize), step;
    for (int k = 0; k < steps; ++k) {
      Eigen::Map<Eigen::VectorXd>(residual.data(), kSize) =
          right - matrix * Eigen::Map<Eigen::VectorXd>(x.data(), kSize);
      anderson.advance(x, residual, step, true);
    }
    return (Eigen::Map<Eigen::VectorXd>(x.data(), kSize) - solution).norm() / solution.norm();
  };
  EXPECT_LT(error_after(kSize, kSize + 2), 1e-4);  // its history is kept in float
  EXPECT_GT(error_after(0, kSize + 2), 1e-1);
}

TEST(Anderson, ProposesAStepWithoutTakingIt) {
  Anderson anderson({2}, 2, 1);
  std::vector<double> x{1.0, 2.0}, step;
  anderson.advance(x, {0.5, -0.5}, step, false);
  EXPECT_EQ(x, (std::vector<double>{1.0, 2.0}));
  EXPECT_EQ(step, (std::vector<double>{0.5, -0.5}));
}

}  // namespace
}  // namespace softgrip::gdfe
