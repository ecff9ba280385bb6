// SPDX-License-Identifier: Apache-2.0
// The factor of a constant matrix against a dense Cholesky factor.
#include <gtest/gtest.h>

#include <numeric>
#include <stdexcept>

#include "meshes.hpp"
#include "softgrip/gdfe/factor.hpp"
#include "softgrip/gdfe/panel_cholesky.hpp"

namespace softgrip::gdfe {
namespace {

Eigen::MatrixXd laplacian() {
  return testing::dense_laplacian(testing::held_block({7, 4, 3}, {1.0, 0.7, 1.3}, 2.0, 0.3), 0);
}

SparseMatrix sparse(const Eigen::MatrixXd& dense) {
  return dense.sparseView();
}

struct Variant {
  bool is_single;
  Ordering ordering;
  int threads;
  double tolerance;
};

class FactorVariants : public ::testing::TestWithParam<Variant> {};

TEST_P(FactorVariants, SolvesAsADenseFactorDoes) {
  const Variant variant = GetParam();
  const Eigen::MatrixXd matrix = laplacian();
  const Factor factor(sparse(matrix), variant.is_single, variant.ordering, variant.threads);
  ASSERT_EQ(factor.size(), matrix.rows());
  const std::vector<int>& position = factor.position();
  std::vector<int> sorted = position, all(position.size());
  std::sort(sorted.begin(), sorted.end());
  std::iota(all.begin(), all.end(), 0);
  EXPECT_EQ(sorted, all);  // a permutation
  for (int count = 1; count <= 3; ++count) {
    const Eigen::MatrixXd right = Eigen::MatrixXd::Random(matrix.rows(), count);
    const Eigen::MatrixXd expected = matrix.llt().solve(right);
    Eigen::MatrixXd columns(right.rows(), count);
    for (Eigen::Index i = 0; i < right.rows(); ++i) columns.row(position[static_cast<std::size_t>(i)]) = right.row(i);
    std::array<double*, 3> pointers{};
    for (int k = 0; k < count; ++k) pointers[static_cast<std::size_t>(k)] = columns.col(k).data();
    std::vector<double> scratch;
    factor.solve(pointers.data(), count, scratch);
    Eigen::MatrixXd found(right.rows(), count);
    for (Eigen::Index i = 0; i < right.rows(); ++i) found.row(i) = columns.row(position[static_cast<std::size_t>(i)]);
    EXPECT_LT((found - expected).norm(), variant.tolerance * expected.norm()) << count << " columns";
  }
}

INSTANTIATE_TEST_SUITE_P(PrecisionOrderingThreads, FactorVariants,
                         ::testing::Values(Variant{false, Ordering::Amd, 1, 1e-12},
                                           Variant{false, Ordering::Automatic, 2, 1e-12},
                                           Variant{true, Ordering::Amd, 1, 1e-5},
                                           Variant{true, Ordering::Automatic, 2, 1e-5}));

TEST(Factor, RefusesAMatrixThatIsNotPositiveDefinite) {
  Eigen::MatrixXd matrix = laplacian();
  matrix(3, 3) = -1.0;
  EXPECT_THROW(Factor(sparse(matrix), false, Ordering::Amd), std::runtime_error);
}

TEST(PanelCholesky, IsTakenAgainOfAMatrixOfThatPattern) {
  Eigen::MatrixXd matrix = laplacian();
  PanelCholesky factor;
  for (const double shift : {0.0, 3.0}) {
    matrix.diagonal().array() += shift;
    ASSERT_TRUE(factor.factorise(sparse(matrix)));
    const Eigen::MatrixXd right = Eigen::MatrixXd::Random(matrix.rows(), 5);
    Eigen::MatrixXd columns = right;
    factor.solve(columns);
    EXPECT_LT((matrix * columns - right).norm(), 1e-12 * right.norm());
  }
  matrix.diagonal().array() -= 100.0;
  EXPECT_FALSE(factor.factorise(sparse(matrix)));
}

}  // namespace
}  // namespace softgrip::gdfe
