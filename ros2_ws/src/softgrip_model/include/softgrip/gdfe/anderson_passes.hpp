// SPDX-License-Identifier: Apache-2.0
// The passes of anderson.hpp over its vectors, by SIMD.
#pragma once

#include <cstddef>

namespace softgrip::gdfe {

// One thread's share first .. last-1 of the vectors. Stores
//   change = residual - last_residual, step = (point - last_point) + change, last_* = *,
// and adds change . columns[k] to with_change[k], residual . columns[k] to with_residual[k], k < count, residual .
// residual to *squared; `change` may be one of the columns, and is rounded to float before it is used.
struct StorePass {
  const double *point, *residual;
  double *last_point, *last_residual;
  float *change, *step;
  const float* const* columns;
  int count;
  double *with_change, *with_residual, *squared;
};
void store_pass(const StorePass& pass, std::size_t first, std::size_t last);

// step = residual - sum weight[k] columns[k], and point += step where there is one
struct CombinePass {
  const double* residual;
  const float* const* columns;
  const double* weight;
  int count;
  double *step, *point;
};
void combine_pass(const CombinePass& pass, std::size_t first, std::size_t last);

}  // namespace softgrip::gdfe
