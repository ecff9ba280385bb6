// SPDX-License-Identifier: Apache-2.0
// The V-cycle of multigrid.hpp, by SIMD.
#pragma once

#include "softgrip/gdfe/multigrid.hpp"

namespace softgrip::gdfe {

// Columns that go through the cycle abreast, interleaved; the last one is filled with zeros.
inline constexpr int kAbreast = 4;

// Vectors that each level works with.
inline constexpr int kLevelVectors = 4;

// Bytes: vectors begin on lines of the cache.
inline constexpr std::size_t kWorkAlignment = 64;

// Values of a vector of a level: blocks of rows read beyond both ends.
constexpr std::size_t vector_length(int rows) {
  return static_cast<std::size_t>(kAbreast) * (whole_blocks(rows) + 2 * kRowsAbreast);
}

// columns[k], k < count <= 3: in and out. work: kLevelVectors vectors of each level, and what its alignment takes.
void multigrid_cycle_float(const MultigridStore<float>& store, double* const* columns, int count, int threads,
                           float* work);
void multigrid_cycle_double(const MultigridStore<double>& store, double* const* columns, int count, int threads,
                            double* work);

}  // namespace softgrip::gdfe
