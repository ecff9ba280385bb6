// SPDX-License-Identifier: Apache-2.0
// Matrices of multigrid.hpp in blocks of rows that are worked on together.
#pragma once

#include "softgrip/gdfe/multigrid.hpp"

namespace softgrip::gdfe {

// Of a symmetric matrix; entries that rounding to T loses beside the diagonal are left out. Empty where rows that
// follow one another share so few distances that rows by themselves take less room.
template <class T>
BlockedRows<T> blocked_rows(const SparseMatrix& matrix);

template <class T>
SharedColumns<T> shared_columns(const Eigen::SparseMatrix<double, Eigen::RowMajor, int>& matrix);

}  // namespace softgrip::gdfe
