// SPDX-License-Identifier: Apache-2.0
// Unknowns to rows of nodes ([node][kStride]) and back, by SIMD, where an unknown is a node, the same on every axis.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace softgrip::gdfe {

// Forces that one thread sums: zero but on nodes first .. last - 1.
struct ForceShare {
  double* force;  // [node][kStride]
  std::size_t first, last;
};

// Of all threads, in order: sums do not depend on timing.
inline double total_force(const std::vector<ForceShare>& shares, std::size_t node, std::size_t at) {
  double sum = 0.0;
  for (const ForceShare& share : shares) {
    if (node >= share.first && node < share.last) sum += share.force[at];
  }
  return sum;
}

// Unknowns first .. last - 1 of columns x, y, z; nodes[u]: that of unknown u.

// position = base + column
void expand_rows(const std::int32_t* nodes, const std::array<const double*, 3>& columns, std::size_t first,
                 std::size_t last, const double* base, double* position);

// column = load - force; returns its square
double gather_rows(const std::int32_t* nodes, const std::array<double*, 3>& columns, std::size_t first,
                   std::size_t last, const double* load, const std::vector<ForceShare>& shares);

}  // namespace softgrip::gdfe
