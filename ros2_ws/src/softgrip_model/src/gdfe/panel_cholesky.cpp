// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/panel_cholesky.hpp"

#include <stdexcept>

#include "softgrip/gdfe/factor.hpp"

namespace softgrip::gdfe {
namespace {

#ifdef SOFTGRIP_HAVE_METIS
constexpr bool kHasMetis = true;
#else
constexpr bool kHasMetis = false;
#endif

}  // namespace

bool PanelCholesky::factorise(const SparseMatrix& matrix) {
  if (elimination_.position.empty()) elimination_ = eliminate(matrix, kHasMetis && matrix.rows() > kMetisAbove);
  scale_ = 1.0 / magnitude_of(matrix);
  try {
    panels_ = factor_panels(matrix, scale_, elimination_);
  } catch (const std::runtime_error&) {
    return false;
  }
  return true;
}

void PanelCholesky::solve(Eigen::Ref<Eigen::MatrixXd> columns) const {
  const std::vector<int>& position = elimination_.position;
  Eigen::MatrixXd x(columns.rows(), columns.cols());
  for (Eigen::Index i = 0; i < x.rows(); ++i) x.row(position[static_cast<std::size_t>(i)]) = scale_ * columns.row(i);
  Eigen::MatrixXd below;
  for (const DensePanel& panel : panels_) {
    const Eigen::Index width = panel.values.cols();
    auto own = x.middleRows(panel.first, width);
    panel.values.topRows(width).triangularView<Eigen::Lower>().solveInPlace(own);
    below.noalias() = panel.values.bottomRows(panel.values.rows() - width) * own;
    for (Eigen::Index k = 0; k < below.rows(); ++k) x.row(panel.rows[static_cast<std::size_t>(k)]) -= below.row(k);
  }
  for (auto panel = panels_.rbegin(); panel != panels_.rend(); ++panel) {
    const Eigen::Index width = panel->values.cols();
    auto own = x.middleRows(panel->first, width);
    below.resize(panel->values.rows() - width, x.cols());
    for (Eigen::Index k = 0; k < below.rows(); ++k) below.row(k) = x.row(panel->rows[static_cast<std::size_t>(k)]);
    own.noalias() -= panel->values.bottomRows(below.rows()).transpose() * below;
    panel->values.topRows(width).triangularView<Eigen::Lower>().transpose().solveInPlace(own);
  }
  for (Eigen::Index i = 0; i < x.rows(); ++i) columns.row(i) = x.row(position[static_cast<std::size_t>(i)]);
}

}  // namespace softgrip::gdfe
