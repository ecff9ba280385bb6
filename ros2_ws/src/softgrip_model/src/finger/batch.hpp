// SPDX-License-Identifier: Apache-2.0
// Many designs along many targets, on several threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "softgrip/finger_solver.hpp"

namespace softgrip::finger {

// Row-major arrays over (design, target, ...); joints = the most any design has, the rest is NaN.
struct BatchOut {
  double* angle_rad;  // (m, k, n)
  double* tension_N;  // (m, k, 2n+1)
  double* phi_rad;    // (m, k, 2n)
  double* pull_rate;  // (m, k, n)
  double* tip_mm;     // (m, k, 2)
  double* pulled_mm;  // (m, k)
  double* gradient;   // (m, k, rows, columns) or null
  std::uint32_t* status;
  int* iterations;
  int joints;
};

// Each design is one piece of work: with march its targets are followed in order, else each is solved from nothing.
void solve_batch(const std::vector<Design>& designs, const std::vector<friction::Model>& frictions,
                 const double* targets, std::size_t targets_per_design, Control control, bool march, int threads,
                 const BatchOut& out);

}  // namespace softgrip::finger
