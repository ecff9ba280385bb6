// SPDX-License-Identifier: Apache-2.0
// Forward and backward substitution over dense panels, by SIMD; see factor.hpp.
#pragma once

#include "softgrip/gdfe/factor.hpp"

namespace softgrip::gdfe {

// Values that one thread needs: three columns padded behind, and two panels' rows of three columns.
inline std::size_t panel_work_size(int size, int max_below) {
  return 3 * (static_cast<std::size_t>(size) + kPad + 2 * (static_cast<std::size_t>(max_below) + kPad));
}

// columns[k] (k < count): in and out. work: panel_work_size() values for each thread of the schedule.
void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_below, float* work);
void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_below, double* work);

}  // namespace softgrip::gdfe
