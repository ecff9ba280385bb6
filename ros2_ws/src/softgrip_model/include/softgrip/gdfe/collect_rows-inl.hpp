// SPDX-License-Identifier: Apache-2.0
// Rows of nodes side by side in an array. Compiled once per instruction set: the guard is undone for each.
#if defined(SOFTGRIP_GDFE_COLLECT_ROWS) == defined(HWY_TARGET_TOGGLE)
#ifdef SOFTGRIP_GDFE_COLLECT_ROWS
#undef SOFTGRIP_GDFE_COLLECT_ROWS
#else
#define SOFTGRIP_GDFE_COLLECT_ROWS
#endif

#include <hwy/highway.h>

#include "softgrip/gdfe/mesh.hpp"

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// As much of a row of kStride values as a vector holds.
using RowPart = hn::CappedTag<double, kStride>;

// `count` rows, of which row(k, p) is what begins at value p of row k: two abreast where a vector holds them, as a load
// that spans two stores would wait for both.
template <class Row>
HWY_INLINE void collect_rows(std::size_t count, const Row& row, double* to) {
#if HWY_MAX_BYTES >= 64
  const hn::CappedTag<double, 2 * kStride> pair;
#pragma GCC unroll 4
  for (std::size_t k = 0; k < count; k += 2)
    hn::Store(hn::Combine(pair, row(k + 1, 0), row(k, 0)), pair, to + kStride * k);
#else
  const RowPart part;
  for (std::size_t k = 0; k < count; ++k) {
    for (std::size_t p = 0; p < kStride; p += hn::Lanes(part)) hn::Store(row(k, p), part, to + kStride * k + p);
  }
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();
#endif
