// SPDX-License-Identifier: Apache-2.0
// Forward and backward substitution over dense panels, by SIMD; see factor.hpp.
#pragma once

#include "softgrip/gdfe/factor.hpp"

namespace softgrip::gdfe {

// Values kept side by side for one unknown: three right-hand sides and a zero.
inline constexpr int kAbreast = 4;

// Values that one thread needs; see Work.
inline std::size_t panel_work_size(int size, int max_rows) {
  return kAbreast * (static_cast<std::size_t>(size) + 2 * static_cast<std::size_t>(max_rows) + 3 * kPad);
}

// columns[k] (k < count): in and out. work: panel_work_size() values for each thread of the schedule.
void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_rows, float* work);
void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_rows, double* work);

}  // namespace softgrip::gdfe
