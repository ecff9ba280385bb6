// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "src/gdfe/panel_solve.hpp"

#include <algorithm>
#include <cmath>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/panel_solve.cpp"
#ifndef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#endif
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Right-hand sides stand side by side, kAbreast values an unknown: a row number then costs one access, not three.
using Rows = const std::int32_t*;

// At most two paddings wide.
template <class T>
using Wide = hn::CappedTag<T, 2 * kPad>;

// Rows i .. i + kParts * lanes - 1 of a product, see product(). kTurns sets of sums take columns in turn where few rows leave
// the arithmetic waiting.
template <int count, int kParts, int kTurns, class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void product_rows(D d, const T* matrix, int tall, int i, int width, const T* in, T* out) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  V sum[kTurns][kParts][kAbreast];
  for (int t = 0; t < kTurns; ++t) {
    for (int p = 0; p < kParts; ++p) {
      for (int k = 0; k < kAbreast; ++k) sum[t][p][k] = hn::Zero(d);
    }
  }
  const T* column = matrix + i;
  const auto add = [&](int turn, int j) HWY_ATTR {
    V x[count];
    for (int k = 0; k < count; ++k) x[k] = hn::Set(d, in[kAbreast * j + k]);
    for (int p = 0; p < kParts; ++p) {
      const V m = hn::LoadU(d, column + p * lanes);
      for (int k = 0; k < count; ++k) sum[turn][p][k] = hn::MulAdd(m, x[k], sum[turn][p][k]);
    }
    column += tall;
  };
  int j = 0;
  for (; j + kTurns <= width; j += kTurns) {
    for (int t = 0; t < kTurns; ++t) add(t, j + t);
  }
  for (; j < width; ++j) add(0, j);
  for (int p = 0; p < kParts; ++p) {
    for (int t = 1; t < kTurns; ++t) {
      for (int k = 0; k < count; ++k) sum[0][p][k] = sum[0][p][k] + sum[t][p][k];
    }
    hn::StoreInterleaved4(sum[0][p][0], sum[0][p][1], sum[0][p][2], sum[0][p][3], d, out + kAbreast * (i + p * lanes));
  }
}

// out (kAbreast x tall) = matrix (tall x width, column by column, tall a multiple of kPad) * in (kAbreast x width).
template <int count, class D, class T = hn::TFromD<D>>
HWY_INLINE void product(D d, const T* matrix, int tall, int width, const T* in, T* out) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  int i = 0;
  for (; i + 3 * lanes <= tall; i += 3 * lanes) product_rows<count, 3, 1>(d, matrix, tall, i, width, in, out);
  for (; i + 2 * lanes <= tall; i += 2 * lanes) product_rows<count, 2, 2>(d, matrix, tall, i, width, in, out);
  for (; i + lanes <= tall; i += lanes) product_rows<count, 1, 2>(d, matrix, tall, i, width, in, out);
  if constexpr (hn::MaxLanes(D()) > kPad) {
    const hn::CappedTag<T, kPad> narrow;
    if (i < tall) product_rows<count, 1, 2>(narrow, matrix, tall, i, width, in, out);
  }
}

// One thread's working arrays: the unknowns, and twice a panel's rows.
template <class T>
struct Work {
  T *x, *y, *z;

  Work(T* base, std::size_t size, std::size_t max_rows) : x(base), y(x + kAbreast * (size + kPad)), z(y + kAbreast * (max_rows + kPad)) {}
};

template <int count, class T>
void forward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const Wide<T> d;
  const hn::CappedTag<T, kAbreast> quad;
  const int parts = static_cast<int>(hn::Lanes(quad));
  for (const std::int32_t index : panels) {
    const Panel& panel = store.panels[index];
    product<count>(d, &store.up[panel.up], panel.padded, panel.width, work.x + kAbreast * static_cast<std::size_t>(panel.first), work.y);
    const Rows rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i) {
      T* to = work.x + kAbreast * static_cast<std::size_t>(rows[i]);
      for (int p = 0; p < kAbreast; p += parts) {
        hn::StoreU(hn::LoadU(quad, to + p) + hn::LoadU(quad, work.y + kAbreast * i + p), quad, to + p);
      }
    }
  }
}

template <int count, class T>
void backward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const Wide<T> d;
  const hn::CappedTag<T, kAbreast> quad;
  const int parts = static_cast<int>(hn::Lanes(quad));
  for (auto index = panels.rbegin(); index != panels.rend(); ++index) {
    const Panel& panel = store.panels[*index];
    T* own = work.x + kAbreast * static_cast<std::size_t>(panel.first);
    T* below = std::copy(own, own + kAbreast * panel.width, work.z);
    const Rows rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i) {
      const T* from = work.x + kAbreast * static_cast<std::size_t>(rows[i]);
      for (int p = 0; p < kAbreast; p += parts) hn::StoreU(hn::LoadU(quad, from + p), quad, below + kAbreast * i + p);
    }
    product<count>(d, &store.down[panel.down], padded(panel.width), panel.width + panel.below, work.z, work.y);
    std::copy(work.y, work.y + kAbreast * panel.width, own);
  }
}

inline double largest_magnitude(const double* values, std::size_t size) {
  const hn::ScalableTag<double> d;
  const std::size_t lanes = hn::Lanes(d);
  auto most = hn::Zero(d), also = hn::Zero(d);
  std::size_t i = 0;
  for (; i + 2 * lanes <= size; i += 2 * lanes) {
    most = hn::Max(most, hn::Abs(hn::LoadU(d, values + i)));
    also = hn::Max(also, hn::Abs(hn::LoadU(d, values + i + lanes)));
  }
  double largest = hn::GetLane(hn::MaxOfLanes(d, hn::Max(most, also)));
  for (; i < size; ++i) largest = std::max(largest, std::abs(values[i]));
  return largest;
}

// Every thread carries its subtrees up in arrays of its own, the top is solved by one, and each carries it down again.
template <int count, class T>
void substitute(const PanelStore<T>& store, double* const* columns, std::size_t size, std::size_t max_rows, T* base) {
  const Schedule& schedule = store.schedule;
  const int threads = static_cast<int>(schedule.panels.size());
  const std::size_t stride = panel_work_size(static_cast<int>(size), static_cast<int>(max_rows));
  std::vector<double> largest(static_cast<std::size_t>(threads * count));
  const auto begin_of = [&](int t) { return size * static_cast<std::size_t>(t) / static_cast<std::size_t>(threads); };
  Work<T> first(base, size, max_rows);
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      for (int k = 0; k < count; ++k) largest[t * count + k] = largest_magnitude(columns[k] + begin_of(t), begin_of(t + 1) - begin_of(t));
    }
    // right-hand sides of any unit: scaled to 1 so that float neither overflows nor loses them
    double scale[count], inverse[count];
    for (int k = 0; k < count; ++k) {
      scale[k] = 0.0;
      for (int t = 0; t < threads; ++t) scale[k] = std::max(scale[k], largest[t * count + k]);
      if (!(scale[k] > 0.0)) scale[k] = 1.0;
      inverse[k] = 1.0 / scale[k];
    }
    const auto load = [&](Work<T>& work, std::int32_t i, bool own) {
      T* to = work.x + kAbreast * static_cast<std::size_t>(i);
      for (int k = 0; k < kAbreast; ++k) to[k] = k < count && own ? static_cast<T>(columns[k][i] * inverse[k]) : T(0);
    };
    const auto store_back = [&](const Work<T>& work, std::int32_t i) {
      const T* from = work.x + kAbreast * static_cast<std::size_t>(i);
      for (int k = 0; k < count; ++k) columns[k][i] = scale[k] * static_cast<double>(from[k]);
    };
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
      for (const std::int32_t i : schedule.columns[t]) load(work, i, true);
      for (const std::int32_t i : schedule.top_columns) load(work, i, t == 0);
      forward<count>(store, schedule.panels[t], work);
    }
#pragma omp single
    {
      for (int t = 1; t < threads; ++t) {
        const Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
        for (const std::int32_t i : schedule.top_columns) {
          const std::size_t at = kAbreast * static_cast<std::size_t>(i);
          for (std::size_t k = at; k < at + kAbreast; ++k) first.x[k] += work.x[k];
        }
      }
      forward<count>(store, schedule.top_panels, first);
      backward<count>(store, schedule.top_panels, first);
    }
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
      for (const std::int32_t i : schedule.top_columns) {
        const std::size_t at = kAbreast * static_cast<std::size_t>(i);
        if (t > 0) std::copy(first.x + at, first.x + at + kAbreast, work.x + at);
        if (t == 0) store_back(first, i);
      }
      backward<count>(store, schedule.panels[t], work);
      for (const std::int32_t i : schedule.columns[t]) store_back(work, i);
    }
  }
}

template <class T>
void solve(const PanelStore<T>& store, double* const* columns, int count, std::size_t size, std::size_t max_rows, T* work) {
  if (count == 3) substitute<3>(store, columns, size, max_rows, work);
  if (count == 2) substitute<2>(store, columns, size, max_rows, work);
  if (count == 1) substitute<1>(store, columns, size, max_rows, work);
}

void SolveFloat(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                std::size_t max_rows, float* work) {
  solve(store, columns, count, size, max_rows, work);
}

void SolveDouble(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                 std::size_t max_rows, double* work) {
  solve(store, columns, count, size, max_rows, work);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(SolveFloat);
HWY_EXPORT(SolveDouble);

void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_rows, float* work) {
  HWY_DYNAMIC_DISPATCH(SolveFloat)(store, columns, count, size, max_rows, work);
}

void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_rows, double* work) {
  HWY_DYNAMIC_DISPATCH(SolveDouble)(store, columns, count, size, max_rows, work);
}

}  // namespace softgrip::gdfe
#endif
