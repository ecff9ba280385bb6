// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/multigrid_cycle.hpp"

#include <algorithm>
#include <cstdint>

#ifdef _OPENMP
#include <omp.h>
#endif

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/multigrid_cycle.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "softgrip/gdfe/multigrid_rows-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Levels of fewer unknowns are the first thread's alone: meeting at barriers would take longer.
constexpr int kSharedFrom = 4000;

// One thread's share of rows, and its part in the cycle. All threads run it together and meet at the barriers.
template <class T>
class Worker {
 public:
  Worker(const MultigridStore<T>& store, T* work, int thread, int threads)
      : store_(store), thread_(thread), threads_(threads) {
    for (const MultigridLevel<T>& level : store.levels) {
      place(work, level.rows);
    }
    place(work, store.coarsest_size);
  }

  T* right_hand_side() { return vectors_.front().b; }
  const T* solution() const { return vectors_.front().x; }
  int first(int rows) const {
    return alone_ ? 0 : static_cast<int>(static_cast<std::int64_t>(rows) * thread_ / threads_);
  }
  int last(int rows) const {
    return alone_ ? rows : static_cast<int>(static_cast<std::int64_t>(rows) * (thread_ + 1) / threads_);
  }

  void barrier() const {
    if (alone_) return;
#pragma omp barrier
  }

  void cycle(std::size_t index) {
    if (index == store_.levels.size()) return solve_coarsest();
    const MultigridLevel<T>& level = store_.levels[index];
    Vectors& at = vectors_[index];
    const Vectors& next = vectors_[index + 1];
    smooth(level, at, true);
    if (level.blocked.empty()) {
      subtract<1>(level, at, level.rows);
    } else {
      subtract<kRowsAbreast>(level, at, level.blocked.blocks());
    }
    barrier();
    const int coarse = level.restriction.rows();
    for (int i = first(coarse); i < last(coarse); ++i)
      row_product(level.restriction, i, at.y).store(next.b + kAbreast * i);
    barrier();
    descend(index + 1);
    const T* correction = vectors_[index + 1].x;
    const int blocks = level.prolongation.blocks();
    for (int i = first(blocks); i < last(blocks); ++i) correct_block(level.prolongation, i, correction, at.x);
    barrier();
    smooth(level, at, false);
  }

 private:
  struct Vectors {
    T *b, *x, *y, *d;
  };

  void descend(std::size_t index) {
    const int rows = index == store_.levels.size() ? store_.coarsest_size : store_.levels[index].rows;
    if (alone_ || rows >= kSharedFrom) return cycle(index);
    if (thread_ == 0) {
      alone_ = true;
      cycle(index);
      alone_ = false;
    }
    barrier();
  }

  // Beyond both ends of a vector are zeros: a block reads there, where it has no values.
  void place(T*& work, int rows) {
    T* vectors[kLevelVectors];
    const std::size_t beyond = kAbreast * kRowsAbreast, size = vector_length(rows);
    for (T*& vector : vectors) {
      vector = work + beyond;
      work += size;
      if (thread_ > 0) continue;
      std::fill(vector - beyond, vector, T(0));
      std::fill(vector + kAbreast * static_cast<std::size_t>(rows), work, T(0));
    }
    vectors_.push_back({vectors[0], vectors[1], vectors[2], vectors[3]});
  }

  template <int rows>
  HWY_INLINE Rows<T, rows> product(const MultigridLevel<T>& level, int group, const T* x) const {
    if constexpr (rows == 1) {
      return row_product(level.matrix, group, x);
    } else {
      return block_product(level.blocked, group, x);
    }
  }

  // y = b - A x in groups of rows
  template <int rows>
  void subtract(const MultigridLevel<T>& level, const Vectors& at, int groups) const {
    for (int i = first(groups); i < last(groups); ++i) {
      const std::size_t slot = static_cast<std::size_t>(kAbreast * rows) * static_cast<std::size_t>(i);
      Rows<T, rows>::load(at.b + slot).minus(product<rows>(level, i, at.x)).store(at.y + slot);
    }
  }

  // One step of a smoothing: y = x + d, d = keep d + take D^-1 (b - A x)
  template <int rows>
  void smooth_once(const MultigridLevel<T>& level, const Vectors& at, int groups, T keep, T take,
                   bool from_zero) const {
    using Group = Rows<T, rows>;
    for (int i = first(groups); i < last(groups); ++i) {
      const std::size_t slot = static_cast<std::size_t>(kAbreast * rows) * static_cast<std::size_t>(i);
      Group residual = Group::load(at.b + slot);
      if (!from_zero) residual = residual.minus(product<rows>(level, i, at.x));
      Group d = keep == T(0) ? Group::zero() : Group::load(at.d + slot).times(keep);
      d.add(Group::spread(level.inverse_diagonal.data() + static_cast<std::size_t>(rows) * static_cast<std::size_t>(i)),
            residual.times(take));
      if constexpr (kSmoothingDegree > 1) d.store(at.d + slot);
      (from_zero ? d : d.plus(Group::load(at.x + slot))).store(at.y + slot);
    }
  }

  // Chebyshev's polynomial on the upper part of the spectrum of D^-1 A (Saad, Iterative Methods, alg. 12.1).
  void smooth(const MultigridLevel<T>& level, Vectors& at, bool from_zero) {
    const double upper = level.largest_eigenvalue, lower = upper / kSmoothedPart;
    const double centre = 0.5 * (upper + lower), radius = 0.5 * (upper - lower), sigma = centre / radius;
    double rho = 1.0 / sigma;
    for (int degree = 0; degree < kSmoothingDegree; ++degree) {
      const bool begins = degree == 0;
      double keep = 0.0, take = 1.0 / centre;
      if (!begins) {
        const double next = 1.0 / (2.0 * sigma - rho);
        keep = next * rho;
        take = 2.0 * next / radius;
        rho = next;
      }
      if (level.blocked.empty()) {
        smooth_once<1>(level, at, level.rows, static_cast<T>(keep), static_cast<T>(take), begins && from_zero);
      } else {
        smooth_once<kRowsAbreast>(level, at, level.blocked.blocks(), static_cast<T>(keep), static_cast<T>(take),
                                  begins && from_zero);
      }
      std::swap(at.x, at.y);  // every thread keeps its own pair of pointers; a cycle swaps it an even number of times
      barrier();
    }
  }

  void solve_coarsest() {
    const int n = store_.coarsest_size;
    const Vectors& at = vectors_.back();
    for (int i = first(n); i < last(n); ++i) {
      const T* row = store_.coarsest_inverse.data() + static_cast<std::size_t>(i) * n;
      Row<T> even = Row<T>::zero(), odd = Row<T>::zero();
      int j = 0;
      for (; j + 2 <= n; j += 2) {
        even.add(row[j], Row<T>::load(at.b + kAbreast * j));
        odd.add(row[j + 1], Row<T>::load(at.b + kAbreast * (j + 1)));
      }
      if (j < n) even.add(row[j], Row<T>::load(at.b + kAbreast * j));
      even.plus(odd).store(at.x + kAbreast * i);
    }
    barrier();
  }

  // Eigenvalues down to this part of the largest are the smoother's, those below the next level's.
  static constexpr double kSmoothedPart = 6.0;

  const MultigridStore<T>& store_;
  int thread_, threads_;
  bool alone_ = false;
  std::vector<Vectors> vectors_;
};

// Columns to interleaved values, times scale.
template <class T>
void interleave(const double* const* columns, int count, double scale, int first, int last, T* values) {
  const hn::ScalableTag<double> wide;
  const hn::Rebind<T, decltype(wide)> d;
  const auto zero = hn::Zero(d);
  const auto part = [&](int k, int i) HWY_ATTR {
    const auto value = hn::LoadU(wide, columns[k] + i) * hn::Set(wide, scale);
    if constexpr (sizeof(T) < sizeof(double)) {
      return hn::DemoteTo(d, value);
    } else {
      return value;
    }
  };
  const int lanes = static_cast<int>(hn::Lanes(wide));
  int i = first;
  for (; i + lanes <= last; i += lanes) {
    hn::StoreInterleaved4(part(0, i), count > 1 ? part(1, i) : zero, count > 2 ? part(2, i) : zero, zero, d,
                          values + kAbreast * i);
  }
  for (; i < last; ++i) {
    for (int k = 0; k < kAbreast; ++k)
      values[kAbreast * i + k] = k < count ? static_cast<T>(columns[k][i] * scale) : T(0);
  }
}

template <class T>
void separate(const T* values, int count, int first, int last, double* const* columns) {
  const hn::ScalableTag<double> wide;
  const hn::Rebind<T, decltype(wide)> d;
  const int lanes = static_cast<int>(hn::Lanes(wide));
  const auto put = [&](int k, int i, hn::Vec<decltype(d)> value) HWY_ATTR {
    if (k >= count) return;
    if constexpr (sizeof(T) < sizeof(double)) {
      hn::StoreU(hn::PromoteTo(wide, value), wide, columns[k] + i);
    } else {
      hn::StoreU(value, wide, columns[k] + i);
    }
  };
  int i = first;
  for (; i + lanes <= last; i += lanes) {
    auto x = hn::Zero(d), y = x, z = x, unused = x;
    hn::LoadInterleaved4(d, values + kAbreast * i, x, y, z, unused);
    put(0, i, x);
    put(1, i, y);
    put(2, i, z);
  }
  for (; i < last; ++i) {
    for (int k = 0; k < count; ++k) columns[k][i] = static_cast<double>(values[kAbreast * i + k]);
  }
}

template <class T>
void run(const MultigridStore<T>& store, double* const* columns, int count, int threads, T* work) {
  const std::size_t beyond = reinterpret_cast<std::uintptr_t>(work) % kWorkAlignment;
  const std::size_t skipped = (kWorkAlignment - beyond) % kWorkAlignment / sizeof(T);
  work += skipped;
  const int size = store.levels.empty() ? store.coarsest_size : store.levels.front().rows;
  if (size < kSharedFrom) threads = 1;
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#ifdef _OPENMP
    Worker<T> worker(store, work, omp_get_thread_num(), omp_get_num_threads());
#else
    Worker<T> worker(store, work, 0, 1);
#endif
    interleave(columns, count, store.scale, worker.first(size), worker.last(size), worker.right_hand_side());
    worker.barrier();
    worker.cycle(0);
    separate(worker.solution(), count, worker.first(size), worker.last(size), columns);
  }
}

void cycle_float(const MultigridStore<float>& store, double* const* columns, int count, int threads, float* work) {
  run(store, columns, count, threads, work);
}

void cycle_double(const MultigridStore<double>& store, double* const* columns, int count, int threads, double* work) {
  run(store, columns, count, threads, work);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(cycle_float);
HWY_EXPORT(cycle_double);

void multigrid_cycle_float(const MultigridStore<float>& store, double* const* columns, int count, int threads,
                           float* work) {
  HWY_DYNAMIC_DISPATCH(cycle_float)(store, columns, count, threads, work);
}

void multigrid_cycle_double(const MultigridStore<double>& store, double* const* columns, int count, int threads,
                            double* work) {
  HWY_DYNAMIC_DISPATCH(cycle_double)(store, columns, count, threads, work);
}

}  // namespace softgrip::gdfe
#endif
