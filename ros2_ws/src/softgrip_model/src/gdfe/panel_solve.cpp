// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "src/gdfe/panel_solve.hpp"

#include <algorithm>
#include <cmath>

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

// out[k][0..tall) = matrix (tall x width, column by column, tall a multiple of kPad) * in[k][0..width)
template <int count, class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void product(D d, const T* matrix, int tall, int width, T* const* in, T* const* out) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  int i = 0;
  for (; i + 2 * lanes <= tall; i += 2 * lanes) {
    V sum[2][count];
    for (int k = 0; k < count; ++k) sum[0][k] = sum[1][k] = hn::Zero(d);
    const T* column = matrix + i;
    for (int j = 0; j < width; ++j, column += tall) {
      const V m0 = hn::LoadU(d, column), m1 = hn::LoadU(d, column + lanes);
      for (int k = 0; k < count; ++k) {
        const V x = hn::Set(d, in[k][j]);
        sum[0][k] = hn::MulAdd(m0, x, sum[0][k]);
        sum[1][k] = hn::MulAdd(m1, x, sum[1][k]);
      }
    }
    for (int k = 0; k < count; ++k) {
      hn::StoreU(sum[0][k], d, out[k] + i);
      hn::StoreU(sum[1][k], d, out[k] + i + lanes);
    }
  }
  for (; i < tall; i += lanes) {
    V sum[count];
    for (int k = 0; k < count; ++k) sum[k] = hn::Zero(d);
    const T* column = matrix + i;
    for (int j = 0; j < width; ++j, column += tall) {
      const V m = hn::LoadU(d, column);
      for (int k = 0; k < count; ++k) sum[k] = hn::MulAdd(m, hn::Set(d, in[k][j]), sum[k]);
    }
    for (int k = 0; k < count; ++k) hn::StoreU(sum[k], d, out[k] + i);
  }
}

// out[k][j] (+)= column j of matrix . in[k], in padded with zeros to tall
template <bool add, int count, class D, class T = hn::TFromD<D>, class V = hn::Vec<D>>
HWY_INLINE void transposed_product(D d, const T* matrix, int tall, int width, T* const* in, T* const* out) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  constexpr int kColumns = 4;
  int j = 0;
  for (; j + kColumns <= width; j += kColumns) {
    V sum[kColumns][count];
    for (int c = 0; c < kColumns; ++c) {
      for (int k = 0; k < count; ++k) sum[c][k] = hn::Zero(d);
    }
    const T* column = matrix + static_cast<std::size_t>(j) * tall;
    for (int i = 0; i < tall; i += lanes) {
      V x[count];
      for (int k = 0; k < count; ++k) x[k] = hn::LoadU(d, in[k] + i);
      for (int c = 0; c < kColumns; ++c) {
        const V m = hn::LoadU(d, column + static_cast<std::size_t>(c) * tall + i);
        for (int k = 0; k < count; ++k) sum[c][k] = hn::MulAdd(m, x[k], sum[c][k]);
      }
    }
    for (int c = 0; c < kColumns; ++c) {
      for (int k = 0; k < count; ++k) {
        const T total = hn::GetLane(hn::SumOfLanes(d, sum[c][k]));
        out[k][j + c] = add ? out[k][j + c] + total : total;
      }
    }
  }
  for (; j < width; ++j) {
    const T* column = matrix + static_cast<std::size_t>(j) * tall;
    for (int k = 0; k < count; ++k) {
      V sum = hn::Zero(d);
      for (int i = 0; i < tall; i += lanes) sum = hn::MulAdd(hn::LoadU(d, column + i), hn::LoadU(d, in[k] + i), sum);
      const T total = hn::GetLane(hn::SumOfLanes(d, sum));
      out[k][j] = add ? out[k][j] + total : total;
    }
  }
}

// One thread's working arrays.
template <int count, class T>
struct Work {
  T *x[count], *y[count], *z[count];

  Work(T* base, std::size_t size, std::size_t max_below) {
    for (int k = 0; k < count; ++k) {
      x[k] = base + static_cast<std::size_t>(k) * (size + kPad);
      y[k] = base + 3 * (size + kPad) + static_cast<std::size_t>(k) * (max_below + kPad);
      z[k] = y[k] + 3 * (max_below + kPad);
    }
  }
};

template <int count, class T>
void forward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<count, T>& work) {
  const hn::CappedTag<T, kPad> d;
  for (const std::int32_t index : panels) {
    const Panel& panel = store.panels[index];
    const int tall = (panel.width + kPad - 1) / kPad * kPad;
    T* head[count];
    for (int k = 0; k < count; ++k) head[k] = work.x[k] + panel.first;
    product<count>(d, &store.inverse[panel.inverse], tall, panel.width, head, work.y);
    for (int k = 0; k < count; ++k) std::copy(work.y[k], work.y[k] + panel.width, head[k]);
    if (panel.below == 0) continue;
    product<count>(d, &store.values[panel.values], panel.padded, panel.width, work.y, work.z);
    const std::int32_t* rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i) {
      for (int k = 0; k < count; ++k) work.x[k][rows[i]] -= work.z[k][i];
    }
  }
}

template <int count, class T>
void backward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<count, T>& work) {
  const hn::CappedTag<T, kPad> d;
  for (auto index = panels.rbegin(); index != panels.rend(); ++index) {
    const Panel& panel = store.panels[*index];
    const int tall = (panel.width + kPad - 1) / kPad * kPad;
    T* head[count];
    for (int k = 0; k < count; ++k) {
      head[k] = work.x[k] + panel.first;
      std::fill(work.y[k] + panel.width, work.y[k] + tall, T(0));
    }
    if (panel.below > 0) {
      const std::int32_t* rows = &store.rows[panel.rows];
      for (int i = 0; i < panel.below; ++i) {
        for (int k = 0; k < count; ++k) work.z[k][i] = -work.x[k][rows[i]];
      }
      for (int k = 0; k < count; ++k) std::fill(work.z[k] + panel.below, work.z[k] + panel.padded, T(0));
      transposed_product<true, count>(d, &store.values[panel.values], panel.padded, panel.width, work.z, head);
    }
    for (int k = 0; k < count; ++k) std::copy(head[k], head[k] + panel.width, work.y[k]);
    transposed_product<false, count>(d, &store.inverse[panel.inverse], tall, panel.width, work.y, head);
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
  Work<count, T> first(base, size, max_below);
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<count, T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
      for (int k = 0; k < count; ++k) {
        for (const std::int32_t i : schedule.columns[t]) work.x[k][i] = static_cast<T>(columns[k][i] * inverse[k]);
        for (const std::int32_t i : schedule.top_columns) {
          work.x[k][i] = t == 0 ? static_cast<T>(columns[k][i] * inverse[k]) : T(0);
        }
      }
      forward<count>(store, schedule.panels[t], work);
    }
#pragma omp single
    {
      for (int t = 1; t < threads; ++t) {
        const Work<count, T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
        for (int k = 0; k < count; ++k) {
          for (const std::int32_t i : schedule.top_columns) first.x[k][i] += work.x[k][i];
        }
      }
      forward<count>(store, schedule.top_panels, first);
      backward<count>(store, schedule.top_panels, first);
    }
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<count, T> work(base + static_cast<std::size_t>(t) * stride, size, max_below);
      for (int k = 0; k < count && t > 0; ++k) {
        for (const std::int32_t i : schedule.top_columns) work.x[k][i] = first.x[k][i];
      }
      backward<count>(store, schedule.panels[t], work);
      for (int k = 0; k < count; ++k) {
        for (const std::int32_t i : schedule.columns[t]) columns[k][i] = scale[k] * static_cast<double>(work.x[k][i]);
      }
    }
  }
  for (int k = 0; k < count; ++k) {
    for (const std::int32_t i : schedule.top_columns) columns[k][i] = scale[k] * static_cast<double>(first.x[k][i]);
  }
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
