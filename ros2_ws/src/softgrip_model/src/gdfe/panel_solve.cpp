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

// out (kAbreast x tall) = matrix (tall x width, column by column, tall a multiple of kPad) * in (kAbreast x width). Of a lower
// triangle only what is not zero is read.
template <int count, bool triangle, class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void product(D d, const T* matrix, int tall, int width, const T* in, T* out) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto rows = [&](auto parts, int i) {
    constexpr int kParts = decltype(parts)::value;
    V sum[kParts][kAbreast];
    for (int p = 0; p < kParts; ++p) {
      for (int k = 0; k < kAbreast; ++k) sum[p][k] = hn::Zero(d);
    }
    const int columns = triangle ? std::min(width, i + kParts * lanes) : width;
    const T* column = matrix + i;
    for (int j = 0; j < columns; ++j, column += tall) {
      V x[count];
      for (int k = 0; k < count; ++k) x[k] = hn::Set(d, in[kAbreast * j + k]);
      for (int p = 0; p < kParts; ++p) {
        const V m = hn::LoadU(d, column + p * lanes);
        for (int k = 0; k < count; ++k) sum[p][k] = hn::MulAdd(m, x[k], sum[p][k]);
      }
    }
    for (int p = 0; p < kParts; ++p) {
      hn::StoreInterleaved4(sum[p][0], sum[p][1], sum[p][2], sum[p][3], d, out + kAbreast * (i + p * lanes));
    }
  };
  int i = 0;
  for (; i + 2 * lanes <= tall; i += 2 * lanes) rows(std::integral_constant<int, 2>(), i);
  for (; i < tall; i += lanes) rows(std::integral_constant<int, 1>(), i);
}

// Sums over the lanes of four vectors, by halves.
template <class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void sums_of_lanes(D d, const V* v, T* sums) {
#if HWY_TARGET == HWY_SCALAR
  for (int c = 0; c < 4; ++c) sums[c] = hn::GetLane(v[c]);
  (void)d;
#else
  if constexpr (hn::MaxLanes(D()) * sizeof(T) > 16) {
    const hn::Half<D> half;
    hn::Vec<hn::Half<D>> folded[4];
    for (int c = 0; c < 4; ++c) folded[c] = hn::LowerHalf(half, v[c]) + hn::UpperHalf(half, v[c]);
    sums_of_lanes(half, folded, sums);
  } else {
    const V first = hn::InterleaveLower(d, v[0], v[1]) + hn::InterleaveUpper(d, v[0], v[1]);
    const V second = hn::InterleaveLower(d, v[2], v[3]) + hn::InterleaveUpper(d, v[2], v[3]);
    if constexpr (sizeof(T) == 8) {
      hn::StoreU(first, d, sums);
      hn::StoreU(second, d, sums + 2);
    } else {
      hn::StoreU(hn::ConcatLowerLower(d, second, first) + hn::ConcatUpperUpper(d, second, first), d, sums);
    }
  }
#endif
}

// out (kAbreast x width) = or -= matrix^T * in, in[k] (tall) padded with zeros. Of a lower triangle only what is not zero is read.
template <int count, bool triangle, class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void transposed_product(D d, const T* matrix, int tall, int width, T* const* in, T* out) {
  constexpr int kColumns = 4;
  const hn::CappedTag<T, kAbreast> quad;
  const int lanes = static_cast<int>(hn::Lanes(d)), parts = static_cast<int>(hn::Lanes(quad));
  for (int j = 0; j < width; j += kColumns) {
    const int columns = std::min(kColumns, width - j);
    const T* column[kColumns];  // those beyond the last are the last once more
    for (int c = 0; c < kColumns; ++c) column[c] = matrix + static_cast<std::size_t>(j + std::min(c, columns - 1)) * tall;
    V sum[count][kColumns];
    for (int k = 0; k < count; ++k) {
      for (int c = 0; c < kColumns; ++c) sum[k][c] = hn::Zero(d);
    }
    for (int i = triangle ? j / lanes * lanes : 0; i < tall; i += lanes) {
      V x[count];
      for (int k = 0; k < count; ++k) x[k] = hn::LoadU(d, in[k] + i);
      for (int c = 0; c < kColumns; ++c) {
        const V m = hn::LoadU(d, column[c] + i);
        for (int k = 0; k < count; ++k) sum[k][c] = hn::MulAdd(m, x[k], sum[k][c]);
      }
    }
    HWY_ALIGN T totals[kAbreast][kColumns] = {}, beside[kColumns * kAbreast];
    for (int k = 0; k < count; ++k) sums_of_lanes(d, sum[k], totals[k]);
    for (int c = 0; c < kColumns; c += parts) {
      hn::StoreInterleaved4(hn::Load(quad, totals[0] + c), hn::Load(quad, totals[1] + c), hn::Load(quad, totals[2] + c),
                            hn::Load(quad, totals[3] + c), quad, beside + kAbreast * c);
    }
    T* to = out + kAbreast * static_cast<std::size_t>(j);
    for (int v = 0; v < kAbreast * columns; v += parts) {
      const auto total = hn::Load(quad, beside + v);
      hn::StoreU(triangle ? total : hn::LoadU(quad, to + v) - total, quad, to + v);
    }
  }
}

// One thread's working arrays: the unknowns, two panels' rows, and a panel's rows each right-hand side by itself.
template <class T>
struct Work {
  T *x, *y, *z, *alone[3];

  Work(T* base, std::size_t size, std::size_t max_below) {
    const std::size_t rows = max_below + kPad;
    x = base;
    y = x + kAbreast * (size + kPad);
    z = y + kAbreast * rows;
    for (std::size_t k = 0; k < 3; ++k) alone[k] = z + (kAbreast + k) * rows;
  }

  // Takes rows (kAbreast x tall) apart.
  void separate(const T* rows, int tall) {
    const hn::CappedTag<T, kPad> d;
    for (int i = 0; i < tall; i += static_cast<int>(hn::Lanes(d))) {
      hn::Vec<decltype(d)> a, b, c, unused;
      hn::LoadInterleaved4(d, rows + kAbreast * i, a, b, c, unused);
      hn::StoreU(a, d, alone[0] + i);
      hn::StoreU(b, d, alone[1] + i);
      hn::StoreU(c, d, alone[2] + i);
    }
  }
};

template <int count, class T>
void forward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const hn::CappedTag<T, kPad> d;
  const hn::CappedTag<T, kAbreast> quad;
  const int parts = static_cast<int>(hn::Lanes(quad));
  for (const std::int32_t index : panels) {
    const Panel& panel = store.panels[index];
    const int tall = (panel.width + kPad - 1) / kPad * kPad;
    T* head = work.x + kAbreast * static_cast<std::size_t>(panel.first);
    product<count, true>(d, &store.inverse[panel.inverse], tall, panel.width, head, work.y);
    std::copy(work.y, work.y + kAbreast * panel.width, head);
    if (panel.below == 0) continue;
    product<count, false>(d, &store.values[panel.values], panel.padded, panel.width, work.y, work.z);
    const Rows rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i) {
      T* to = work.x + kAbreast * static_cast<std::size_t>(rows[i]);
      for (int p = 0; p < kAbreast; p += parts) {
        hn::StoreU(hn::LoadU(quad, to + p) - hn::LoadU(quad, work.z + kAbreast * i + p), quad, to + p);
      }
    }
  }
}

template <int count, class T>
void backward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const hn::CappedTag<T, kPad> d;
  const hn::CappedTag<T, kAbreast> quad;
  const int parts = static_cast<int>(hn::Lanes(quad));
  for (auto index = panels.rbegin(); index != panels.rend(); ++index) {
    const Panel& panel = store.panels[*index];
    const int tall = (panel.width + kPad - 1) / kPad * kPad;
    T* head = work.x + kAbreast * static_cast<std::size_t>(panel.first);
    if (panel.below > 0) {
      const Rows rows = &store.rows[panel.rows];
      for (int i = 0; i < panel.below; ++i) {
        const T* from = work.x + kAbreast * static_cast<std::size_t>(rows[i]);
        for (int p = 0; p < kAbreast; p += parts) hn::StoreU(hn::LoadU(quad, from + p), quad, work.z + kAbreast * i + p);
      }
      std::fill(work.z + kAbreast * panel.below, work.z + kAbreast * panel.padded, T(0));
      work.separate(work.z, panel.padded);
      transposed_product<count, false>(d, &store.values[panel.values], panel.padded, panel.width, work.alone, head);
    }
    std::copy(head, head + kAbreast * panel.width, work.y);
    std::fill(work.y + kAbreast * panel.width, work.y + kAbreast * tall, T(0));
    work.separate(work.y, tall);
    transposed_product<count, true>(d, &store.inverse[panel.inverse], tall, panel.width, work.alone, head);
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
void substitute(const PanelStore<T>& store, double* const* columns, std::size_t size, std::size_t max_below, T* base) {
  const Schedule& schedule = store.schedule;
  const int threads = static_cast<int>(schedule.panels.size());
  const std::size_t stride = panel_work_size(static_cast<int>(size), static_cast<int>(max_below));
  // right-hand sides of any unit: scaled to 1 so that float neither overflows nor loses them
  double scale[count], inverse[count];
  for (int k = 0; k < count; ++k) {
    const double largest = largest_magnitude(columns[k], size);
    scale[k] = largest > 0.0 ? largest : 1.0;
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
  Work<T> first(base, size, max_below);
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
      for (const std::int32_t i : schedule.columns[t]) load(work, i, true);
      for (const std::int32_t i : schedule.top_columns) load(work, i, t == 0);
      forward<count>(store, schedule.panels[t], work);
    }
#pragma omp single
    {
      for (int t = 1; t < threads; ++t) {
        const Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
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
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
      if (t > 0) {
        for (const std::int32_t i : schedule.top_columns) {
          const std::size_t at = kAbreast * static_cast<std::size_t>(i);
          std::copy(first.x + at, first.x + at + kAbreast, work.x + at);
        }
      }
      backward<count>(store, schedule.panels[t], work);
      for (const std::int32_t i : schedule.columns[t]) store_back(work, i);
    }
  }
  for (const std::int32_t i : schedule.top_columns) store_back(first, i);
}

template <class T>
void solve(const PanelStore<T>& store, double* const* columns, int count, std::size_t size, std::size_t max_below, T* work) {
  if (count == 3) substitute<3>(store, columns, size, max_below, work);
  if (count == 2) substitute<2>(store, columns, size, max_below, work);
  if (count == 1) substitute<1>(store, columns, size, max_below, work);
}

void SolveFloat(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                std::size_t max_below, float* work) {
  solve(store, columns, count, size, max_below, work);
}

void SolveDouble(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                 std::size_t max_below, double* work) {
  solve(store, columns, count, size, max_below, work);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(SolveFloat);
HWY_EXPORT(SolveDouble);

void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_below, float* work) {
  HWY_DYNAMIC_DISPATCH(SolveFloat)(store, columns, count, size, max_below, work);
}

void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_below, double* work) {
  HWY_DYNAMIC_DISPATCH(SolveDouble)(store, columns, count, size, max_below, work);
}

}  // namespace softgrip::gdfe
#endif
