// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/anderson_passes.hpp"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/anderson_passes.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Values worked on at once: all that a chunk needs besides its columns stays in the first cache.
constexpr std::size_t kChunk = 512;

using Wide = hn::ScalableTag<double>;
using Narrow = hn::Rebind<float, Wide>;
using V = hn::Vec<Wide>;

// change and residual of one chunk times `columns` columns.
template <int columns>
HWY_INLINE void chunk_products(const double* change, const double* residual, const float* const* column,
                               std::size_t from, std::size_t count, double* with_change, double* with_residual) {
  const Wide d;
  const Narrow narrow;
  const std::size_t lanes = hn::Lanes(d);
  V a[columns], b[columns];
  for (int k = 0; k < columns; ++k) a[k] = b[k] = hn::Zero(d);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    const V x = hn::LoadU(d, change + i), y = hn::LoadU(d, residual + i);
    for (int k = 0; k < columns; ++k) {
      const V c = hn::PromoteTo(d, hn::LoadU(narrow, column[k] + from + i));
      a[k] = hn::MulAdd(x, c, a[k]);
      b[k] = hn::MulAdd(y, c, b[k]);
    }
  }
  for (int k = 0; k < columns; ++k) {
    double on_change = hn::GetLane(hn::SumOfLanes(d, a[k])), on_residual = hn::GetLane(hn::SumOfLanes(d, b[k]));
    for (std::size_t j = i; j < count; ++j) {
      on_change += change[j] * static_cast<double>(column[k][from + j]);
      on_residual += residual[j] * static_cast<double>(column[k][from + j]);
    }
    with_change[k] += on_change;
    with_residual[k] += on_residual;
  }
}

HWY_INLINE double squared_norm(const double* values, std::size_t count) {
  const Wide d;
  const std::size_t lanes = hn::Lanes(d);
  V sum = hn::Zero(d), also = hn::Zero(d);
  std::size_t i = 0;
  for (; i + 2 * lanes <= count; i += 2 * lanes) {
    const V x = hn::LoadU(d, values + i), y = hn::LoadU(d, values + i + lanes);
    sum = hn::MulAdd(x, x, sum);
    also = hn::MulAdd(y, y, also);
  }
  double square = hn::GetLane(hn::SumOfLanes(d, sum + also));
  for (; i < count; ++i) square += values[i] * values[i];
  return square;
}

void store(const StorePass& pass, std::size_t first, std::size_t last) {
  HWY_ALIGN double change[kChunk];
  for (std::size_t from = first; from < last; from += kChunk) {
    const std::size_t count = std::min(kChunk, last - from);
    const double* residual = pass.residual + from;
    for (std::size_t i = 0; i < count; ++i) {
      const double difference = residual[i] - pass.last_residual[from + i];
      const float rounded = static_cast<float>(difference);
      pass.change[from + i] = rounded;
      change[i] = static_cast<double>(rounded);
      pass.step[from + i] = static_cast<float>((pass.point[from + i] - pass.last_point[from + i]) + difference);
      pass.last_residual[from + i] = residual[i];
      pass.last_point[from + i] = pass.point[from + i];
    }
    *pass.squared += squared_norm(residual, count);
    int k = 0;
    for (; k + 4 <= pass.count; k += 4) {
      chunk_products<4>(change, residual, pass.columns + k, from, count, pass.with_change + k, pass.with_residual + k);
    }
    for (; k < pass.count; ++k) {
      chunk_products<1>(change, residual, pass.columns + k, from, count, pass.with_change + k, pass.with_residual + k);
    }
  }
}

template <int columns>
HWY_INLINE void chunk_combine(const float* const* column, const double* weight, std::size_t from, std::size_t count,
                              double* step) {
  const Wide d;
  const Narrow narrow;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    V sum = hn::LoadU(d, step + from + i);
    for (int k = 0; k < columns; ++k) {
      sum = hn::NegMulAdd(hn::Set(d, weight[k]), hn::PromoteTo(d, hn::LoadU(narrow, column[k] + from + i)), sum);
    }
    hn::StoreU(sum, d, step + from + i);
  }
  for (; i < count; ++i) {
    for (int k = 0; k < columns; ++k) step[from + i] -= weight[k] * static_cast<double>(column[k][from + i]);
  }
}

void combine(const CombinePass& pass, std::size_t first, std::size_t last) {
  for (std::size_t from = first; from < last; from += kChunk) {
    const std::size_t count = std::min(kChunk, last - from);
    std::copy(pass.residual + from, pass.residual + from + count, pass.step + from);
    int k = 0;
    for (; k + 5 <= pass.count; k += 5) chunk_combine<5>(pass.columns + k, pass.weight + k, from, count, pass.step);
    for (; k < pass.count; ++k) chunk_combine<1>(pass.columns + k, pass.weight + k, from, count, pass.step);
    for (std::size_t i = from; pass.point != nullptr && i < from + count; ++i) pass.point[i] += pass.step[i];
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(store);
HWY_EXPORT(combine);

void store_pass(const StorePass& pass, std::size_t first, std::size_t last) {
  HWY_DYNAMIC_DISPATCH(store)(pass, first, last);
}

void combine_pass(const CombinePass& pass, std::size_t first, std::size_t last) {
  HWY_DYNAMIC_DISPATCH(combine)(pass, first, last);
}

}  // namespace softgrip::gdfe
#endif
