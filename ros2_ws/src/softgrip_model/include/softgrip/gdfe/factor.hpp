// SPDX-License-Identifier: Apache-2.0
// L = P^T C C^T P of the constant matrix, and its solves for one to three right-hand sides at once.
//
// Supernodal: columns of C with (nearly) the same rows form a panel. With S the Schur complement of a panel's block and
// R the rows below it, W = R S^-1: the forward pass is x_below -= W x_own, the backward pass x_own = S^-1 x_own - W^T
// x_below, one small dense product each, without a chain of divisions. The backward pass has W transposed, so that both
// are products of columns: none ends in sums over lanes. Panels may be kept in float: the factor only preconditions a
// residual that is computed in double.
#pragma once

#include <cstdint>
#include <new>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"

namespace softgrip::gdfe {

enum class Ordering : std::uint8_t { Automatic = 0, Amd = 1, Metis = 2 };

// Matrices above this size are ordered by METIS where it is built in.
inline constexpr int kMetisAbove = 6000;

// One dense panel: `width` columns from `first`; below them `below` rows (padded to kPad in memory).
struct Panel {
  std::int32_t first, width, below, padded;
  std::size_t up;    // offset of the padded x width block -W, column by column
  std::size_t down;  // offset of the padded(width) x (width + below) block [S^-1, -W^T], column by column
  std::size_t rows;  // offset of its row numbers
};

inline constexpr int kPad = 8;

constexpr int padded(int count) {
  return (count + kPad - 1) / kPad * kPad;
}

// Columns first .. last - 1.
struct Span {
  std::int32_t first, last;
};

// Which panels each thread works on. Panels of different threads share no columns and meet only in the top panels,
// which come after them in the forward pass and before them in the backward pass: results do not depend on timing.
struct Schedule {
  std::vector<std::vector<std::int32_t>> panels;  // per thread, ascending
  std::vector<std::vector<Span>> columns;         // per thread, ascending
  std::vector<std::int32_t> top_panels;
  std::vector<Span> top_columns;
};

// Panels begin on lines of the cache: a vector that spans two lines is read twice.
inline constexpr std::size_t kLine = 64;

template <class T>
struct LineAllocator {
  using value_type = T;
  LineAllocator() = default;
  template <class U>
  LineAllocator(const LineAllocator<U>&) {}
  T* allocate(std::size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), std::align_val_t(kLine))); }
  void deallocate(T* values, std::size_t) { ::operator delete(values, std::align_val_t(kLine)); }
  friend bool operator==(const LineAllocator&, const LineAllocator&) { return true; }
  friend bool operator!=(const LineAllocator&, const LineAllocator&) { return false; }
};

template <class T>
using Lines = std::vector<T, LineAllocator<T>>;

template <class T>
struct PanelStore {
  std::vector<Panel> panels;
  Lines<T> up, down;  // in the order of the pass that reads them
  std::vector<std::int32_t> rows;
  Schedule schedule;
  double scale = 1.0;  // of a right-hand side
};

struct DensePanel;

class Factor final : public ConstantInverse {
 public:
  // matrix: symmetric positive definite, both triangles; values of the lower one count. Throws std::runtime_error when
  // it is not.
  Factor(const SparseMatrix& matrix, bool single_precision, Ordering ordering = Ordering::Automatic, int threads = 1);

  int size() const override { return size_; }
  std::size_t nonzeros() const override { return nonzeros_; }
  std::size_t bytes() const override;
  const std::vector<int>& position() const override { return position_; }
  void apply(double* const* columns, int count, std::vector<double>& scratch) const override {
    solve(columns, count, scratch);
  }
  void solve(double* const* columns, int count, std::vector<double>& scratch) const override;

  bool uses_metis() const { return uses_metis_; }

 private:
  template <class T>
  void pack(const std::vector<DensePanel>& panels, PanelStore<T>& store);

  int size_ = 0;
  int threads_ = 1;
  std::size_t nonzeros_ = 0;
  bool single_ = false, uses_metis_ = false;
  std::vector<int> position_;
  int max_rows_ = 0;  // of a panel, its own and those below
  PanelStore<float> float_;
  PanelStore<double> double_;
};

}  // namespace softgrip::gdfe
