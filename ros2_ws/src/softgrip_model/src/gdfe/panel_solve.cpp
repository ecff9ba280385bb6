// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/panel_solve.hpp"

#include <algorithm>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/panel_solve.cpp"
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

// Rows i .. i + kParts * lanes - 1 of a product, see product(). kTurns sets of sums take columns in turn where few rows
// leave the arithmetic waiting.
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

  Work(T* base, std::size_t size, std::size_t max_rows)
      : x(base), y(x + kAbreast * (size + kPad)), z(y + kAbreast * (max_rows + kPad)) {}
};

// A row of kAbreast values.
template <class T>
HWY_INLINE void copy_row(const T* from, T* to) {
  const hn::CappedTag<T, kAbreast> quad;
  for (std::size_t p = 0; p < kAbreast; p += hn::Lanes(quad)) hn::StoreU(hn::LoadU(quad, from + p), quad, to + p);
}

// to += from
template <class T>
HWY_INLINE void add_row(const T* from, T* to) {
  const hn::CappedTag<T, kAbreast> quad;
  for (std::size_t p = 0; p < kAbreast; p += hn::Lanes(quad))
    hn::StoreU(hn::LoadU(quad, to + p) + hn::LoadU(quad, from + p), quad, to + p);
}

// Columns of the right-hand side, scaled, to rows; those beyond `count` are zero.
template <int count, class T>
HWY_INLINE void load_rows(double* const* columns, const Span& span, double scale, T* rows) {
  const hn::ScalableTag<double> d;
  const hn::Rebind<T, decltype(d)> narrow;
  const auto load = [&](int k, std::int32_t i) HWY_ATTR {
    const auto value = hn::Set(d, scale) * hn::LoadU(d, columns[k] + i);
    if constexpr (std::is_same_v<T, double>) {
      return value;
    } else {
      return hn::DemoteTo(narrow, value);
    }
  };
  std::int32_t i = span.first;
  for (const auto lanes = static_cast<std::int32_t>(hn::Lanes(d)); i + lanes <= span.last; i += lanes) {
    auto x = load(0, i), y = hn::Zero(narrow), z = hn::Zero(narrow);
    if constexpr (count > 1) y = load(1, i);
    if constexpr (count > 2) z = load(2, i);
    hn::StoreInterleaved4(x, y, z, hn::Zero(narrow), narrow, rows + kAbreast * i);
  }
  for (; i < span.last; ++i) {
    for (int k = 0; k < kAbreast; ++k)
      rows[kAbreast * i + k] = k < count ? static_cast<T>(scale * columns[k][i]) : T(0);
  }
}

template <int count, class T>
HWY_INLINE void store_rows(const T* rows, const Span& span, double* const* columns) {
  const hn::ScalableTag<double> d;
  const hn::Rebind<T, decltype(d)> narrow;
  std::int32_t i = span.first;
  for (const auto lanes = static_cast<std::int32_t>(hn::Lanes(d)); i + lanes <= span.last; i += lanes) {
    hn::Vec<decltype(narrow)> values[kAbreast];
    hn::LoadInterleaved4(narrow, rows + kAbreast * i, values[0], values[1], values[2], values[3]);
    for (int k = 0; k < count; ++k) {
      if constexpr (std::is_same_v<T, double>) {
        hn::StoreU(values[k], d, columns[k] + i);
      } else {
        hn::StoreU(hn::PromoteTo(d, values[k]), d, columns[k] + i);
      }
    }
  }
  for (; i < span.last; ++i) {
    for (int k = 0; k < count; ++k) columns[k][i] = static_cast<double>(rows[kAbreast * i + k]);
  }
}

template <int count, class T>
void forward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const Wide<T> d;
  for (const std::int32_t index : panels) {
    const Panel& panel = store.panels[index];
    product<count>(d, &store.up[panel.up], panel.padded, panel.width,
                   work.x + kAbreast * static_cast<std::size_t>(panel.first), work.y);
    const Rows rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i)
      add_row(work.y + kAbreast * i, work.x + kAbreast * static_cast<std::size_t>(rows[i]));
  }
}

template <int count, class T>
void backward(const PanelStore<T>& store, const std::vector<std::int32_t>& panels, Work<T>& work) {
  const Wide<T> d;
  for (auto index = panels.rbegin(); index != panels.rend(); ++index) {
    const Panel& panel = store.panels[*index];
    T* own = work.x + kAbreast * static_cast<std::size_t>(panel.first);
    T* below = work.z + kAbreast * panel.width;
    for (int i = 0; i < panel.width; ++i) copy_row(own + kAbreast * i, work.z + kAbreast * i);
    const Rows rows = &store.rows[panel.rows];
    for (int i = 0; i < panel.below; ++i)
      copy_row(work.x + kAbreast * static_cast<std::size_t>(rows[i]), below + kAbreast * i);
    product<count>(d, &store.down[panel.down], padded(panel.width), panel.width + panel.below, work.z, work.y);
    for (int i = 0; i < panel.width; ++i) copy_row(work.y + kAbreast * i, own + kAbreast * i);
  }
}

// Every thread carries its subtrees up in arrays of its own, the top is solved by one, and each carries it down again.
template <int count, class T>
void substitute(const PanelStore<T>& store, double* const* columns, std::size_t size, std::size_t max_rows, T* base) {
  const Schedule& schedule = store.schedule;
  const int threads = static_cast<int>(schedule.panels.size());
  const std::size_t stride = panel_work_size(static_cast<int>(size), static_cast<int>(max_rows));
  Work<T> first(base, size, max_rows);
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#pragma omp for schedule(static, 1)
    for (int t = 0; t < threads; ++t) {
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
      for (const Span& span : schedule.columns[t]) load_rows<count>(columns, span, store.scale, work.x);
      for (const Span& span : schedule.top_columns) {
        if (t == 0) load_rows<count>(columns, span, store.scale, work.x);
        if (t > 0) std::fill(work.x + kAbreast * span.first, work.x + kAbreast * span.last, T(0));
      }
      forward<count>(store, schedule.panels[t], work);
    }
#pragma omp single
    {
      for (int t = 1; t < threads; ++t) {
        const Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
        for (const Span& span : schedule.top_columns) {
          for (std::int32_t i = span.first; i < span.last; ++i) add_row(work.x + kAbreast * i, first.x + kAbreast * i);
        }
      }
      forward<count>(store, schedule.top_panels, first);
      backward<count>(store, schedule.top_panels, first);
    }
#pragma omp for schedule(static, 1) nowait
    for (int t = 0; t < threads; ++t) {
      Work<T> work(base + static_cast<std::size_t>(t) * stride, size, max_rows);
      for (const Span& span : schedule.top_columns) {
        if (t > 0)
          std::copy(first.x + kAbreast * span.first, first.x + kAbreast * span.last, work.x + kAbreast * span.first);
        if (t == 0) store_rows<count>(first.x, span, columns);
      }
      backward<count>(store, schedule.panels[t], work);
      for (const Span& span : schedule.columns[t]) store_rows<count>(work.x, span, columns);
    }
  }
}

template <class T>
void solve(const PanelStore<T>& store, double* const* columns, int count, std::size_t size, std::size_t max_rows,
           T* work) {
  if (count == 3) substitute<3>(store, columns, size, max_rows, work);
  if (count == 2) substitute<2>(store, columns, size, max_rows, work);
  if (count == 1) substitute<1>(store, columns, size, max_rows, work);
}

void solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                 std::size_t max_rows, float* work) {
  solve(store, columns, count, size, max_rows, work);
}

void solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                  std::size_t max_rows, double* work) {
  solve(store, columns, count, size, max_rows, work);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(solve_float);
HWY_EXPORT(solve_double);

void panel_solve_float(const PanelStore<float>& store, double* const* columns, int count, std::size_t size,
                       std::size_t max_rows, float* work) {
  HWY_DYNAMIC_DISPATCH(solve_float)(store, columns, count, size, max_rows, work);
}

void panel_solve_double(const PanelStore<double>& store, double* const* columns, int count, std::size_t size,
                        std::size_t max_rows, double* work) {
  HWY_DYNAMIC_DISPATCH(solve_double)(store, columns, count, size, max_rows, work);
}

}  // namespace softgrip::gdfe
#endif
