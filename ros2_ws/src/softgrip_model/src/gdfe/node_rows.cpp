// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/node_rows.hpp"

#include "softgrip/gdfe/mesh.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/node_rows.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "softgrip/gdfe/collect_rows-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Wide = hn::ScalableTag<double>;

void expand(const std::int32_t* nodes, const std::array<const double*, 3>& columns, std::size_t first, std::size_t last,
            const double* base, double* position) {
  const Wide d;
  const RowPart part;
  HWY_ALIGN double rows[kStride * hn::MaxLanes(Wide())];
  std::size_t u = first;
  for (; u + hn::Lanes(d) <= last; u += hn::Lanes(d)) {
    hn::StoreInterleaved4(hn::LoadU(d, columns[0] + u), hn::LoadU(d, columns[1] + u), hn::LoadU(d, columns[2] + u),
                          hn::Zero(d), d, rows);
    for (std::size_t k = 0; k < hn::Lanes(d); ++k) {
      const std::size_t at = kStride * static_cast<std::size_t>(nodes[u + k]);
      for (std::size_t p = 0; p < kStride; p += hn::Lanes(part)) {
        hn::StoreU(hn::LoadU(part, base + at + p) + hn::Load(part, rows + kStride * k + p), part, position + at + p);
      }
    }
  }
  for (; u < last; ++u) {
    const std::size_t at = kStride * static_cast<std::size_t>(nodes[u]);
    for (std::size_t axis = 0; axis < 3; ++axis) position[at + axis] = base[at + axis] + columns[axis][u];
  }
}

double gather(const std::int32_t* nodes, const std::array<double*, 3>& columns, std::size_t first, std::size_t last,
              const double* load, const std::vector<ForceShare>& shares) {
  const Wide d;
  const RowPart part;
  HWY_ALIGN double rows[kStride * hn::MaxLanes(Wide())];
  auto squares = hn::Zero(d);
  std::size_t u = first;
  for (; u + hn::Lanes(d) <= last; u += hn::Lanes(d)) {
    const auto unbalanced = [&](std::size_t k, std::size_t p) HWY_ATTR {
      const auto node = static_cast<std::size_t>(nodes[u + k]);
      const std::size_t at = kStride * node + p;
      auto sum = hn::Zero(part);
      for (const ForceShare& share : shares) {
        if (node >= share.first && node < share.last) sum = sum + hn::LoadU(part, share.force + at);
      }
      return hn::LoadU(part, load + at) - sum;
    };
    collect_rows(hn::Lanes(d), unbalanced, rows);
    auto x = hn::Zero(d), y = x, z = x, unused = x;
    hn::LoadInterleaved4(d, rows, x, y, z, unused);
    hn::StoreU(x, d, columns[0] + u);
    hn::StoreU(y, d, columns[1] + u);
    hn::StoreU(z, d, columns[2] + u);
    squares = hn::MulAdd(x, x, hn::MulAdd(y, y, hn::MulAdd(z, z, squares)));
  }
  double square = hn::GetLane(hn::SumOfLanes(d, squares));
  for (; u < last; ++u) {
    const auto node = static_cast<std::size_t>(nodes[u]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t at = kStride * node + axis;
      const double value = load[at] - total_force(shares, node, at);
      columns[axis][u] = value;
      square += value * value;
    }
  }
  return square;
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(expand);
HWY_EXPORT(gather);

void expand_rows(const std::int32_t* nodes, const std::array<const double*, 3>& columns, std::size_t first,
                 std::size_t last, const double* base, double* position) {
  HWY_DYNAMIC_DISPATCH(expand)(nodes, columns, first, last, base, position);
}

double gather_rows(const std::int32_t* nodes, const std::array<double*, 3>& columns, std::size_t first,
                   std::size_t last, const double* load, const std::vector<ForceShare>& shares) {
  return HWY_DYNAMIC_DISPATCH(gather)(nodes, columns, first, last, load, shares);
}

}  // namespace softgrip::gdfe
#endif
