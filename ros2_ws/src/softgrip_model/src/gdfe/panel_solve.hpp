// SPDX-License-Identifier: Apache-2.0
// Forward and backward substitution over dense panels, by SIMD; see factor.hpp.
#pragma once

#include "softgrip/gdfe/factor.hpp"

namespace softgrip::gdfe {

// columns[k] (k < count): in and out. work: at least 3 (size + kPad + 2 (max_below + kPad)) values.
void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_below, float* work);
void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_below, double* work);

}  // namespace softgrip::gdfe
