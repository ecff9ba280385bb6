// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/stream.hpp"

#include <algorithm>
#include <chrono>
#include <limits>
#include <vector>

namespace softgrip::gdfe {

double read_bandwidth(std::size_t bytes, int threads, int repeats) {
  const std::size_t count = std::max<std::size_t>(bytes / sizeof(double), 64);
  const std::vector<double> values(count, 1.0);
  std::vector<double> sums(static_cast<std::size_t>(threads) * 8, 0.0);
  double best = std::numeric_limits<double>::infinity();
  for (int repeat = 0; repeat < repeats; ++repeat) {
    const auto started = std::chrono::steady_clock::now();
#pragma omp parallel for num_threads(threads) schedule(static, 1) if (threads > 1)
    for (int t = 0; t < threads; ++t) {
      const std::size_t first = count * static_cast<std::size_t>(t) / static_cast<std::size_t>(threads);
      const std::size_t last = count * (static_cast<std::size_t>(t) + 1) / static_cast<std::size_t>(threads);
      double lanes[64] = {};  // independent sums: the loads are the only limit
      std::size_t i = first;
      for (; i + 64 <= last; i += 64) {
        for (std::size_t k = 0; k < 64; ++k) lanes[k] += values[i + k];
      }
      double sum = 0.0;
      for (const double lane : lanes) sum += lane;
      sums[static_cast<std::size_t>(t) * 8] += sum;
    }
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - started;
    best = std::min(best, taken.count());
  }
  // the sums are read so that no compiler leaves the loops out
  return sums[0] >= 0.0 ? static_cast<double>(count) * sizeof(double) / best : 0.0;
}

}  // namespace softgrip::gdfe
