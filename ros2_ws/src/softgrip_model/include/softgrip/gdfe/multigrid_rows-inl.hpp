// SPDX-License-Identifier: Apache-2.0
// Rows of multigrid.hpp times interleaved vectors. Compiled once per instruction set: the guard is undone for each.
#if defined(SOFTGRIP_GDFE_MULTIGRID_ROWS) == defined(HWY_TARGET_TOGGLE)
#ifdef SOFTGRIP_GDFE_MULTIGRID_ROWS
#undef SOFTGRIP_GDFE_MULTIGRID_ROWS
#else
#define SOFTGRIP_GDFE_MULTIGRID_ROWS
#endif

#include <hwy/highway.h>

#include "softgrip/gdfe/multigrid_cycle.hpp"

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The interleaved values of `rows` unknowns that follow one another.
template <class T, int rows>
struct Rows {
  // an unknown fills 16 bytes, what instruction sets repeat, or all of a vector
  using D = hn::CappedTag<T, sizeof(T) * kAbreast == 16 ? kAbreast * rows : kAbreast>;
  using V = hn::Vec<D>;
  static constexpr int kLanes = static_cast<int>(hn::MaxLanes(D())), kParts = kAbreast * rows / kLanes;
  V v[kParts];

  HWY_INLINE Rows() {}  // the implicit one would not be of this instruction set: GCC refuses it for NEON
  static HWY_INLINE Rows zero() {
    Rows q;
    for (V& part : q.v) part = hn::Zero(D());
    return q;
  }
  static HWY_INLINE Rows load(const T* from) {
    Rows q;
    for (int p = 0; p < kParts; ++p) q.v[p] = hn::LoadU(D(), from + p * kLanes);
    return q;
  }
  // the one unknown at `from` in all of the rows
  static HWY_INLINE Rows repeat(const T* from) {
    Rows q;
    if constexpr (kLanes <= kAbreast) {
      for (int p = 0; p < kParts; ++p) q.v[p] = hn::LoadU(D(), from + p * kLanes % kAbreast);
    } else {
      const V same = hn::LoadDup128(D(), from);
      for (V& part : q.v) part = same;
    }
    return q;
  }
  HWY_INLINE void store(T* to) const {
    for (int p = 0; p < kParts; ++p) hn::StoreU(v[p], D(), to + p * kLanes);
  }
  // values[r] in all of row r
  static HWY_INLINE Rows spread(const T* values) {
    Rows q;
    if constexpr (kLanes <= kAbreast) {
      for (int p = 0; p < kParts; ++p) q.v[p] = hn::Set(D(), values[p * kLanes / kAbreast]);
    } else {
      constexpr int kPartRows = kLanes / kAbreast;
      for (int p = 0; p < kParts; ++p) {
        HWY_ALIGN hwy::MakeSigned<T> from[kLanes];
        for (int lane = 0; lane < kLanes; ++lane) from[lane] = lane / kAbreast + p * kPartRows;
        q.v[p] = hn::TableLookupLanes(hn::LoadDup128(D(), values), hn::SetTableIndices(D(), from));
      }
    }
    return q;
  }
  // this += factor * other
  HWY_INLINE void add(const Rows& factor, const Rows& other) {
    for (int p = 0; p < kParts; ++p) v[p] = hn::MulAdd(factor.v[p], other.v[p], v[p]);
  }
  HWY_INLINE void add(T factor, const Rows& other) {
    const V f = hn::Set(D(), factor);
    for (int p = 0; p < kParts; ++p) v[p] = hn::MulAdd(f, other.v[p], v[p]);
  }
  HWY_INLINE Rows times(T factor) const {
    Rows q;
    for (int p = 0; p < kParts; ++p) q.v[p] = hn::Set(D(), factor) * v[p];
    return q;
  }
  HWY_INLINE Rows plus(const Rows& other) const {
    Rows q;
    for (int p = 0; p < kParts; ++p) q.v[p] = v[p] + other.v[p];
    return q;
  }
  HWY_INLINE Rows minus(const Rows& other) const {
    Rows q;
    for (int p = 0; p < kParts; ++p) q.v[p] = v[p] - other.v[p];
    return q;
  }
};

template <class T>
using Row = Rows<T, 1>;

// Row `row` of the matrix times x.
template <class T>
HWY_INLINE Row<T> row_product(const SparseRows<T>& matrix, int row, const T* x) {
  Row<T> even = Row<T>::zero(), odd = Row<T>::zero(), third = Row<T>::zero();
  std::int32_t k = matrix.start[row];
  const std::int32_t end = matrix.start[row + 1];
  const std::int32_t* column = matrix.column.data();
  const T* value = matrix.value.data();
  for (; k + 3 <= end; k += 3) {
    even.add(value[k], Row<T>::load(x + kAbreast * static_cast<std::size_t>(column[k])));
    odd.add(value[k + 1], Row<T>::load(x + kAbreast * static_cast<std::size_t>(column[k + 1])));
    third.add(value[k + 2], Row<T>::load(x + kAbreast * static_cast<std::size_t>(column[k + 2])));
  }
  for (; k < end; ++k) even.add(value[k], Row<T>::load(x + kAbreast * static_cast<std::size_t>(column[k])));
  return even.plus(odd).plus(third);
}

// A block of rows times x.
template <class T>
HWY_INLINE Rows<T, kRowsAbreast> block_product(const BlockedRows<T>& matrix, int block, const T* x) {
  using Block = Rows<T, kRowsAbreast>;
  Block even = Block::zero(), odd = Block::zero();
  const std::int32_t distinct = matrix.distinct[block];
  std::int32_t k = matrix.start[distinct];
  const std::int32_t end = matrix.start[distinct + 1];
  const std::int32_t* distance = matrix.distance.data();
  const T *value = matrix.value.data(), *own = x + static_cast<std::ptrdiff_t>(kAbreast * kRowsAbreast) * block;
  const auto add = [&](Block& sum, std::int32_t entry) HWY_ATTR {
    const std::ptrdiff_t away = static_cast<std::ptrdiff_t>(kAbreast) * distance[entry];
    sum.add(Block::spread(value + static_cast<std::ptrdiff_t>(kRowsAbreast) * entry), Block::load(own + away));
  };
  for (; k + 2 <= end; k += 2) {
    add(even, k);
    add(odd, k + 1);
  }
  if (k < end) add(even, k);
  return even.plus(odd);
}

// x += a block of the prolongation times the correction
template <class T>
HWY_INLINE void correct_block(const SharedColumns<T>& prolongation, int block, const T* correction, T* x) {
  using Block = Rows<T, kRowsAbreast>;
  T* own = x + static_cast<std::ptrdiff_t>(kAbreast * kRowsAbreast) * block;
  Block sum = Block::load(own);
  for (std::int32_t k = prolongation.start[block]; k < prolongation.start[block + 1]; ++k) {
    const T* value = prolongation.value.data() + static_cast<std::ptrdiff_t>(kRowsAbreast) * k;
    sum.add(Block::spread(value),
            Block::repeat(correction + static_cast<std::ptrdiff_t>(kAbreast) * prolongation.column[k]));
  }
  sum.store(own);
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#endif
