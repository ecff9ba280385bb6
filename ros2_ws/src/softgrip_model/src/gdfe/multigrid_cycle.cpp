// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "src/gdfe/multigrid_cycle.hpp"

#include <algorithm>

#ifdef _OPENMP
#include <omp.h>
#endif

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/multigrid_cycle.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The interleaved values of one unknown.
template <class T>
struct Quad {
  using D = hn::CappedTag<T, kAbreast>;
  using V = hn::Vec<D>;
  static constexpr int kParts = kAbreast / static_cast<int>(hn::MaxLanes(D()));
  V v[kParts];

  HWY_INLINE Quad() {}  // the implicit one would not be of this instruction set: GCC refuses it for NEON
  static HWY_INLINE Quad zero() {
    Quad q;
    for (V& part : q.v) part = hn::Zero(D());
    return q;
  }
  static HWY_INLINE Quad load(const T* from) {
    Quad q;
    for (int p = 0; p < kParts; ++p) q.v[p] = hn::LoadU(D(), from + p * (kAbreast / kParts));
    return q;
  }
  HWY_INLINE void store(T* to) const {
    for (int p = 0; p < kParts; ++p) hn::StoreU(v[p], D(), to + p * (kAbreast / kParts));
  }
  // this += factor * other
  HWY_INLINE void add(T factor, const Quad& other) {
    const V f = hn::Set(D(), factor);
    for (int p = 0; p < kParts; ++p) v[p] = hn::MulAdd(f, other.v[p], v[p]);
  }
  HWY_INLINE Quad plus(const Quad& other) const {
    Quad q;
    for (int p = 0; p < kParts; ++p) q.v[p] = v[p] + other.v[p];
    return q;
  }
  HWY_INLINE Quad minus(const Quad& other) const {
    Quad q;
    for (int p = 0; p < kParts; ++p) q.v[p] = v[p] - other.v[p];
    return q;
  }
};

// Row `row` of the matrix times x.
template <class T>
HWY_INLINE Quad<T> row_product(const SparseRows<T>& matrix, int row, const T* x) {
  Quad<T> even = Quad<T>::zero(), odd = Quad<T>::zero(), third = Quad<T>::zero();
  std::int32_t k = matrix.start[row];
  const std::int32_t end = matrix.start[row + 1];
  const std::int32_t* column = matrix.column.data();
  const T* value = matrix.value.data();
  for (; k + 3 <= end; k += 3) {
    even.add(value[k], Quad<T>::load(x + kAbreast * static_cast<std::size_t>(column[k])));
    odd.add(value[k + 1], Quad<T>::load(x + kAbreast * static_cast<std::size_t>(column[k + 1])));
    third.add(value[k + 2], Quad<T>::load(x + kAbreast * static_cast<std::size_t>(column[k + 2])));
  }
  for (; k < end; ++k) even.add(value[k], Quad<T>::load(x + kAbreast * static_cast<std::size_t>(column[k])));
  return even.plus(odd).plus(third);
}

// Levels of fewer unknowns are the first thread's alone: meeting at barriers would take longer.
constexpr int kSharedFrom = 4000;

// One thread's share of rows, and its part in the cycle. All threads run it together and meet at the barriers.
template <class T>
class Worker {
 public:
  Worker(const MultigridStore<T>& store, T* work, int thread, int threads) : store_(store), thread_(thread), threads_(threads) {
    for (const MultigridLevel<T>& level : store.levels) {
      place(work, level.matrix.rows());
    }
    place(work, store.coarsest_size);
  }

  T* right_hand_side() { return vectors_.front().b; }
  const T* solution() const { return vectors_.front().x; }
  int first(int rows) const { return alone_ ? 0 : static_cast<int>(static_cast<std::int64_t>(rows) * thread_ / threads_); }
  int last(int rows) const { return alone_ ? rows : static_cast<int>(static_cast<std::int64_t>(rows) * (thread_ + 1) / threads_); }

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
    const int rows = level.matrix.rows();
    for (int i = first(rows); i < last(rows); ++i) {
      Quad<T>::load(at.b + kAbreast * i).minus(row_product(level.matrix, i, at.x)).store(at.y + kAbreast * i);
    }
    barrier();
    const int coarse = level.restriction.rows();
    for (int i = first(coarse); i < last(coarse); ++i) row_product(level.restriction, i, at.y).store(next.b + kAbreast * i);
    barrier();
    descend(index + 1);
    const T* correction = vectors_[index + 1].x;
    for (int i = first(rows); i < last(rows); ++i) {
      Quad<T>::load(at.x + kAbreast * i).plus(row_product(level.prolongation, i, correction)).store(at.x + kAbreast * i);
    }
    barrier();
    smooth(level, at, false);
  }

 private:
  struct Vectors {
    T *b, *x, *y, *d;
  };

  void descend(std::size_t index) {
    const int rows = index == store_.levels.size() ? store_.coarsest_size : store_.levels[index].matrix.rows();
    if (alone_ || rows >= kSharedFrom) return cycle(index);
    if (thread_ == 0) {
      alone_ = true;
      cycle(index);
      alone_ = false;
    }
    barrier();
  }

  void place(T*& work, int rows) {
    const std::size_t size = kAbreast * static_cast<std::size_t>(rows);
    vectors_.push_back({work, work + size, work + 2 * size, work + 3 * size});
    work += kLevelVectors * size;
  }

  // Chebyshev's polynomial on the upper part of the spectrum of D^-1 A (Saad, Iterative Methods, alg. 12.1).
  void smooth(const MultigridLevel<T>& level, Vectors& at, bool from_zero) {
    const double upper = level.largest_eigenvalue, lower = upper / kSmoothedPart;
    const double centre = 0.5 * (upper + lower), radius = 0.5 * (upper - lower), sigma = centre / radius;
    double rho = 1.0 / sigma;
    const int rows = level.matrix.rows();
    for (int degree = 0; degree < kSmoothingDegree; ++degree) {
      const bool begins = degree == 0;
      double keep = 0.0, take = 1.0 / centre;
      if (!begins) {
        const double next = 1.0 / (2.0 * sigma - rho);
        keep = next * rho;
        take = 2.0 * next / radius;
        rho = next;
      }
      for (int i = first(rows); i < last(rows); ++i) {
        const std::size_t slot = kAbreast * static_cast<std::size_t>(i);
        Quad<T> residual = Quad<T>::load(at.b + slot);
        if (!begins || !from_zero) residual = residual.minus(row_product(level.matrix, i, at.x));
        Quad<T> d = Quad<T>::zero();
        if (!begins) d.add(static_cast<T>(keep), Quad<T>::load(at.d + slot));
        d.add(static_cast<T>(take) * level.inverse_diagonal[i], residual);
        d.store(at.d + slot);
        (begins && from_zero ? d : d.plus(Quad<T>::load(at.x + slot))).store(at.y + slot);
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
      Quad<T> even = Quad<T>::zero(), odd = Quad<T>::zero();
      int j = 0;
      for (; j + 2 <= n; j += 2) {
        even.add(row[j], Quad<T>::load(at.b + kAbreast * j));
        odd.add(row[j + 1], Quad<T>::load(at.b + kAbreast * (j + 1)));
      }
      if (j < n) even.add(row[j], Quad<T>::load(at.b + kAbreast * j));
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

template <class T>
void run(const MultigridStore<T>& store, double* const* columns, int count, int threads, T* work) {
  const int size = store.levels.empty() ? store.coarsest_size : store.levels.front().matrix.rows();
  if (size < kSharedFrom) threads = 1;
#pragma omp parallel num_threads(threads) if (threads > 1)
  {
#ifdef _OPENMP
    Worker<T> worker(store, work, omp_get_thread_num(), omp_get_num_threads());
#else
    Worker<T> worker(store, work, 0, 1);
#endif
    T* b = worker.right_hand_side();
    for (int i = worker.first(size); i < worker.last(size); ++i) {
      for (int k = 0; k < kAbreast; ++k) b[kAbreast * i + k] = k < count ? static_cast<T>(columns[k][i] * store.scale) : T(0);
    }
    worker.barrier();
    worker.cycle(0);
    const T* x = worker.solution();
    for (int k = 0; k < count; ++k) {
      for (int i = worker.first(size); i < worker.last(size); ++i) columns[k][i] = static_cast<double>(x[kAbreast * i + k]);
    }
  }
}

void CycleFloat(const MultigridStore<float>& store, double* const* columns, int count, int threads, float* work) {
  run(store, columns, count, threads, work);
}

void CycleDouble(const MultigridStore<double>& store, double* const* columns, int count, int threads, double* work) {
  run(store, columns, count, threads, work);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(CycleFloat);
HWY_EXPORT(CycleDouble);

void multigrid_cycle_float(const MultigridStore<float>& store, double* const* columns, int count, int threads, float* work) {
  HWY_DYNAMIC_DISPATCH(CycleFloat)(store, columns, count, threads, work);
}

void multigrid_cycle_double(const MultigridStore<double>& store, double* const* columns, int count, int threads, double* work) {
  HWY_DYNAMIC_DISPATCH(CycleDouble)(store, columns, count, threads, work);
}

}  // namespace softgrip::gdfe
#endif
