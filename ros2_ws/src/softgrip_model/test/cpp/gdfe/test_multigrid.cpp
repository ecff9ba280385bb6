// SPDX-License-Identifier: Apache-2.0
// Multigrid against a sparse Cholesky factor; its cycle as a symmetric operator that reduces the error.
#include <gtest/gtest.h>

#include <Eigen/SparseCholesky>
#include <stdexcept>

#include "meshes.hpp"
#include "softgrip/gdfe/multigrid.hpp"

namespace softgrip::gdfe {
namespace {

// More unknowns than a coarsest level may have.
class MultigridOnABlock : public ::testing::TestWithParam<bool> {
 protected:
  MultigridOnABlock() : problem_(testing::held_block({12, 8, 8}, {1.0, 1.0, 1.0}, 1.0, 0.3)) {
    const DofMap& map = problem_.maps[0];
    std::vector<Eigen::Triplet<double>> entries;
    const Element element = make_element(corners_of(problem_.rest, problem_.hexes, 0));  // all alike
    for (Eigen::Index e = 0; e < problem_.hexes.rows(); ++e) {
      for (int a = 0; a < 8; ++a) {
        for (int b = 0; b < 8; ++b) {
          const int row = map[static_cast<std::size_t>(problem_.hexes(e, a))],
                    column = map[static_cast<std::size_t>(problem_.hexes(e, b))];
          if (row >= 0 && column >= 0) entries.emplace_back(row, column, element.laplacian(a, b));
        }
      }
    }
    const int size = 1 + *std::max_element(map.begin(), map.end());
    matrix_.resize(size, size);
    matrix_.setFromTriplets(entries.begin(), entries.end());
    places_.resize(size, 3);
    for (std::size_t i = 0; i < map.size(); ++i) {
      if (map[i] >= 0) places_.row(map[i]) = problem_.rest.row(static_cast<Eigen::Index>(i));
    }
    multigrid_ = std::make_unique<Multigrid>(matrix_, places_, GetParam(), 1);
  }

  Eigen::VectorXd cycle(Eigen::VectorXd column) {
    double* data = column.data();
    multigrid_->apply(&data, 1, scratch_);
    return column;
  }

  Problem problem_;
  SparseMatrix matrix_;
  Eigen::MatrixX3d places_;
  std::unique_ptr<Multigrid> multigrid_;
  std::vector<double> scratch_;
};

TEST_P(MultigridOnABlock, SolvesAsACholeskyFactorDoes) {
  Eigen::VectorXd column = Eigen::VectorXd::Random(matrix_.rows());
  const Eigen::VectorXd expected = Eigen::SimplicialLLT<SparseMatrix>(matrix_).solve(column);
  double* data = column.data();
  multigrid_->solve(&data, 1, scratch_);
  EXPECT_LT((column - expected).norm(), 1e-6 * expected.norm());
}

TEST_P(MultigridOnABlock, ACycleIsSymmetricAndPositive) {
  const Eigen::VectorXd a = Eigen::VectorXd::Random(matrix_.rows()), b = Eigen::VectorXd::Random(matrix_.rows());
  const Eigen::VectorXd cycled_a = cycle(a), cycled_b = cycle(b);
  EXPECT_NEAR(a.dot(cycled_b), b.dot(cycled_a), 1e-5 * cycled_a.norm() * b.norm());
  EXPECT_GT(a.dot(cycled_a), 0.0);
}

TEST_P(MultigridOnABlock, ACycleRemovesNearlyAllOfAnyError) {
  Eigen::VectorXd error = Eigen::VectorXd::Random(matrix_.rows());
  double factor = 1.0;
  for (int k = 0; k < 12; ++k) {
    const double before = std::sqrt(error.dot(matrix_ * error));
    error -= cycle(matrix_ * error);
    factor = std::sqrt(error.dot(matrix_ * error)) / before;
  }
  EXPECT_LT(factor, 0.5);  // textbook smoothed aggregation: 0.1 to 0.4 a cycle (Vanek, Mandel, Brezina 1996)
}

INSTANTIATE_TEST_SUITE_P(Precision, MultigridOnABlock, ::testing::Bool());

TEST(Multigrid, RefusesAMatrixThatIsNotPositiveDefinite) {
  SparseMatrix matrix(400, 400);
  matrix.setIdentity();
  matrix.coeffRef(7, 7) = -1.0;
  EXPECT_THROW(Multigrid(matrix, Eigen::MatrixX3d::Random(400, 3), false, 1), std::runtime_error);
}

}  // namespace
}  // namespace softgrip::gdfe
