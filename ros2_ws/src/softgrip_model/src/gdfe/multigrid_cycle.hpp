// SPDX-License-Identifier: Apache-2.0
// The V-cycle of multigrid.hpp, by SIMD.
#pragma once

#include "softgrip/gdfe/multigrid.hpp"

namespace softgrip::gdfe {

// Columns that go through the cycle abreast, interleaved; the last one is filled with zeros.
inline constexpr int kAbreast = 4;

// Vectors that each level works with.
inline constexpr int kLevelVectors = 4;

// columns[k], k < count <= 3: in and out. work: kAbreast * kLevelVectors values for each unknown of each level.
void multigrid_cycle_float(const MultigridStore<float>& store, double* const* columns, int count, int threads, float* work);
void multigrid_cycle_double(const MultigridStore<double>& store, double* const* columns, int count, int threads, double* work);

}  // namespace softgrip::gdfe
