// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

namespace softgrip::vision {

// Quantiles of grey levels: a histogram tells which level the wanted one has, and only values of that level are
// ordered.
class Quantile {
 public:
  // The element below which a share 0 .. 1 of some values, at least one and none of them NaN, lies.
  float operator()(const std::vector<float>& values, double share) {
    const auto share_of = static_cast<std::size_t>(share * static_cast<double>(values.size()));
    std::size_t rank = std::min(values.size() - 1, share_of);
    counts_.fill(0);
    for (const float value : values) ++counts_[bin(value)];
    std::size_t level = 0;
    while (rank >= counts_[level]) rank -= counts_[level++];
    same_level_.clear();
    for (const float value : values) {
      if (bin(value) == level) same_level_.push_back(value);
    }
    const auto at = same_level_.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(same_level_.begin(), at, same_level_.end());
    return *at;
  }

 private:
  // One a grey level; what lies beyond is in the first or the last.
  static constexpr int kBins = 1024;
  static constexpr int kBinOfZero = kBins / 2;
  static std::size_t bin(float value) {
    return static_cast<std::size_t>(std::clamp(value + kBinOfZero, 0.0F, kBins - 1.0F));
  }

  std::array<unsigned, kBins> counts_;
  std::vector<float> same_level_;
};

}  // namespace softgrip::vision
