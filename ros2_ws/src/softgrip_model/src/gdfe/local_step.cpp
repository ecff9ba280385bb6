// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/local_step.hpp"

#include <cmath>

#include "softgrip/gdfe/inverted.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/local_step.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "softgrip/gdfe/collect_rows-inl.hpp"
#include "softgrip/gdfe/rotation_volume-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <class D, class V = hn::Vec<D>>
HWY_INLINE V secant_modulus(D d, const SecantTables& tables, V strain, V material) {
  const V cells = hn::Set(d, static_cast<double>(tables.cells));
  V t = strain * hn::Set(d, tables.cells / tables.end);
  t = hn::Min(t, hn::Set(d, tables.cells * (1.0 - 1e-12)));
  const V cell = hn::Floor(t);
  t = t - cell;
  const hn::Rebind<std::int32_t, D> di;
  HWY_ALIGN std::int32_t row[kBlock];
  HWY_ALIGN double rows[kStride * kBlock];
  hn::Store(hn::DemoteTo(di, hn::MulAdd(material, cells, cell)), di, row);
  const double* coefficients = tables.coefficients.data();
  const auto coefficients_of = [&](std::size_t lane, std::size_t p) HWY_ATTR {
    return hn::LoadU(RowPart(), coefficients + kStride * static_cast<std::size_t>(row[lane]) + p);
  };
  collect_rows(hn::Lanes(d), coefficients_of, rows);
  V c0, c1, c2, c3;
  hn::LoadInterleaved4(d, rows, c0, c1, c2, c3);
  return hn::MulAdd(t, hn::MulAdd(t, hn::MulAdd(t, c3, c2), c1), c0);
}

// Inverted and flat elements leave Newton's domain: their lanes are replaced one by one.
template <class D, class V = hn::Vec<D>>
HWY_INLINE void repair_inverted(D d, const Matrix3<V>& f, V det, Matrix3<V>& r, Matrix3<V>& correction) {
  const auto bad = hn::Not(hn::Gt(det, hn::Set(d, kInvertedBelow)));
  if (hn::AllFalse(d, bad)) return;
  HWY_ALIGN double fs[9][kBlock], rs[9][kBlock], cs[9][kBlock], dets[kBlock];
  hn::Store(det, d, dets);
  for (int k = 0; k < 9; ++k) {
    hn::Store(f.m[k / 3][k % 3], d, fs[k]);
    hn::Store(r.m[k / 3][k % 3], d, rs[k]);
    hn::Store(correction.m[k / 3][k % 3], d, cs[k]);
  }
  for (std::size_t lane = 0; lane < hn::Lanes(d); ++lane) {
    if (dets[lane] > kInvertedBelow) continue;
    double f9[9], r9[9], c9[9];
    for (int k = 0; k < 9; ++k) f9[k] = fs[k][lane];
    rotation_and_volume_of_inverted(f9, r9, c9);
    for (int k = 0; k < 9; ++k) {
      rs[k][lane] = r9[k];
      cs[k][lane] = c9[k];
    }
  }
  for (int k = 0; k < 9; ++k) {
    r.m[k / 3][k % 3] = hn::Load(d, rs[k]);
    correction.m[k / 3][k % 3] = hn::Load(d, cs[k]);
  }
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V equivalent_strain(D d, const Matrix3<V>& f, const Matrix3<V>& r) {
  // |dev S| of the stretch S = R^T F; Eq 5.5 with nu = 0.5 is sqrt(1.5) |dev S| / 1.5, without cancellation near rest
  V s[3][3];
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j) {
      s[i][j] = hn::MulAdd(r.m[0][i], f.m[0][j], hn::MulAdd(r.m[1][i], f.m[1][j], r.m[2][i] * f.m[2][j]));
    }
  }
  const V mean = (s[0][0] + s[1][1] + s[2][2]) * hn::Set(d, 1.0 / 3.0);
  V square = s[0][1] * s[0][1] + s[0][2] * s[0][2] + s[1][2] * s[1][2];
  square = square + square;
  for (int i = 0; i < 3; ++i) square = hn::MulAdd(s[i][i] - mean, s[i][i] - mean, square);
  return hn::Sqrt(square) * hn::Set(d, std::sqrt(1.5) / 1.5);
}

// Sums and differences of eight corners: linear patterns x, y, z and hourglass patterns yz, xz, xy, xyz.
template <class V>
HWY_INLINE void patterns_of(const V* x, V* linear, V* hourglass) {
  const V d0 = x[1] - x[0], d1 = x[2] - x[3], d2 = x[5] - x[4], d3 = x[6] - x[7];
  const V e0 = x[1] + x[0], e1 = x[2] + x[3], e2 = x[5] + x[4], e3 = x[6] + x[7];
  const V d_sum0 = d0 + d1, d_sum1 = d2 + d3, d_along0 = d1 - d0, d_along1 = d3 - d2;
  const V e_sum0 = e0 + e1, e_sum1 = e2 + e3, e_along0 = e1 - e0, e_along1 = e3 - e2;
  linear[0] = d_sum0 + d_sum1;
  linear[1] = e_along0 + e_along1;
  linear[2] = e_sum1 - e_sum0;
  hourglass[0] = e_along1 - e_along0;
  hourglass[1] = d_sum1 - d_sum0;
  hourglass[2] = d_along0 + d_along1;
  hourglass[3] = d_along1 - d_along0;
}

// The sum of patterns at the eight corners.
template <class V>
HWY_INLINE void corners_of(const V* linear, const V* hourglass, V* x) {
  const V e_plus = linear[2] + hourglass[0], e_minus = linear[2] - hourglass[0];
  const V d_plus = linear[0] + hourglass[2], d_minus = linear[0] - hourglass[2];
  const V c_plus = hourglass[1] + hourglass[3], c_minus = hourglass[1] - hourglass[3];
  const V even[4] = {hn::Neg(linear[1] + e_minus), linear[1] - e_plus, e_minus - linear[1], linear[1] + e_plus};
  const V odd[4] = {d_minus - c_minus, d_plus - c_plus, d_minus + c_minus, d_plus + c_plus};
  x[0] = even[0] - odd[0], x[1] = even[0] + odd[0];
  x[3] = even[1] - odd[1], x[2] = even[1] + odd[1];
  x[4] = even[2] - odd[2], x[5] = even[2] + odd[2];
  x[7] = even[3] - odd[3], x[6] = even[3] + odd[3];
}

// One group of lanes of one block; corners and forces: [8][kBlock][kStride].
template <Law law, VolumeShape shape, bool box, class D, class V = hn::Vec<D>>
HWY_INLINE void lanes_step(D d, ElementBlocks& e, const SecantTables& tables, std::size_t block, std::size_t lane,
                           const double* corners, double* forces) {
  const std::size_t other = block - (box ? 0 : e.box_blocks), slot = block * kBlock + lane;
  const double* linear = &e.linear[block * 9 * kBlock + lane];
  const double* bent = box ? nullptr : &e.bent[other * 12 * kBlock + lane];
  const double* rest = box ? nullptr : &e.hourglass_rest[other * 12 * kBlock + lane];
  const double* stiffness =
      box ? &e.box_stiffness[block * 4 * kBlock + lane] : &e.hourglass_stiffness[other * 10 * kBlock + lane];

  V x[3][8], l[3][3], h[3][4];
  for (int c = 0; c < 8; ++c) {
    V unused;
    hn::LoadInterleaved4(d, corners + (static_cast<std::size_t>(c) * kBlock + lane) * kStride, x[0][c], x[1][c],
                         x[2][c], unused);
  }
  for (int i = 0; i < 3; ++i) patterns_of(x[i], l[i], h[i]);
  Matrix3<V> f;
  for (int j = 0; j < 3; ++j) {
    V a[3];
    for (int k = 0; k < 3; ++k) a[k] = hn::LoadU(d, linear + static_cast<std::size_t>(3 * k + j) * kBlock);
    for (int i = 0; i < 3; ++i) f.m[i][j] = hn::MulAdd(l[i][0], a[0], hn::MulAdd(l[i][1], a[1], l[i][2] * a[2]));
  }
  if constexpr (!box) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 4; ++k) {
        const V b = hn::LoadU(d, bent + static_cast<std::size_t>(3 * k + j) * kBlock);
        for (int i = 0; i < 3; ++i) f.m[i][j] = hn::MulAdd(h[i][k], b, f.m[i][j]);
      }
    }
    for (int k = 0; k < 4; ++k) {
      for (int j = 0; j < 3; ++j) {
        const V r = hn::LoadU(d, rest + static_cast<std::size_t>(3 * k + j) * kBlock);
        for (int i = 0; i < 3; ++i) h[i][k] = hn::NegMulAdd(r, f.m[i][j], h[i][k]);
      }
    }
  }

  V det;
  Matrix3<V> r, correction;
  rotation_and_volume<shape>(d, f, det, r, correction);
  repair_inverted(d, f, det, r, correction);

  const V strain = equivalent_strain(d, f, r);
  hn::StoreU(strain, d, &e.strain[slot]);
  const V material = hn::LoadU(d, &e.material[slot]);
  V a, b;
  if constexpr (law == Law::Calibrated) {
    const V mu = secant_modulus(d, tables, strain, material);
    a = mu + mu;
    b = hn::Set(d, 3.0) * hn::LoadU(d, &e.lame_per_mu[slot]) * mu;
  } else {
    const V one = hn::Set(d, 1.0), last = hn::LoadU(d, &e.last_strain[slot]);
    const V alpha = hn::Min(last / hn::Max(strain, hn::Set(d, 1e-30)), one);
    a = hn::LoadU(d, &e.omega[slot]) * (one - alpha);
    b = one - a;
  }
  V spread = a;
  Matrix3<V> p;
  if constexpr (shape == VolumeShape::Proj) {
    for (int k = 0; k < 9; ++k) {
      const int i = k / 3, j = k % 3;
      p.m[i][j] = hn::NegMulAdd(b, correction.m[i][j], a * (f.m[i][j] - r.m[i][j]));
    }
  } else {
    const V one = hn::Set(d, 1.0);
    const V s = b * (one - inverse_cube_root(d, hn::Max(det, hn::Set(d, kInvertedBelow))));
    for (int k = 0; k < 9; ++k) {
      const int i = k / 3, j = k % 3;
      p.m[i][j] = hn::MulAdd(s, f.m[i][j], a * (f.m[i][j] - r.m[i][j]));
    }
    spread = spread + s;
  }

  // of the hourglass patterns
  const auto load_stiffness = [&](int row) { return hn::LoadU(d, stiffness + static_cast<std::size_t>(row) * kBlock); };
  if constexpr (box) {
    for (int k = 0; k < 4; ++k) {
      const V s = spread * load_stiffness(k);
      for (int i = 0; i < 3; ++i) h[i][k] = s * h[i][k];
    }
  } else {
    V s[4][4];
    int row = 0;
    for (int k = 0; k < 4; ++k) {
      for (int m = k; m < 4; ++m) s[k][m] = s[m][k] = spread * load_stiffness(row++);
    }
    for (int i = 0; i < 3; ++i) {
      V t[4];
      for (int k = 0; k < 4; ++k) {
        t[k] = s[k][0] * h[i][0];
        for (int m = 1; m < 4; ++m) t[k] = hn::MulAdd(s[k][m], h[i][m], t[k]);
      }
      for (int k = 0; k < 4; ++k) h[i][k] = t[k];
    }
  }
  const V volume = hn::LoadU(d, &e.volume[slot]);
  for (int k = 0; k < 9; ++k) p.m[k / 3][k % 3] = volume * p.m[k / 3][k % 3];
  if constexpr (!box) {
    for (int k = 0; k < 4; ++k) {
      for (int j = 0; j < 3; ++j) {
        const V row = hn::LoadU(d, rest + static_cast<std::size_t>(3 * k + j) * kBlock);
        for (int i = 0; i < 3; ++i) p.m[i][j] = hn::NegMulAdd(row, h[i][k], p.m[i][j]);
      }
    }
    for (int k = 0; k < 4; ++k) {
      for (int j = 0; j < 3; ++j) {
        const V row = hn::LoadU(d, bent + static_cast<std::size_t>(3 * k + j) * kBlock);
        for (int i = 0; i < 3; ++i) h[i][k] = hn::MulAdd(row, p.m[i][j], h[i][k]);
      }
    }
  }
  for (int k = 0; k < 3; ++k) {
    V row[3];
    for (int j = 0; j < 3; ++j) row[j] = hn::LoadU(d, linear + static_cast<std::size_t>(3 * k + j) * kBlock);
    for (int i = 0; i < 3; ++i) {
      l[i][k] = hn::MulAdd(row[0], p.m[i][0], hn::MulAdd(row[1], p.m[i][1], row[2] * p.m[i][2]));
    }
  }
  for (int i = 0; i < 3; ++i) corners_of(l[i], h[i], x[i]);
  for (int c = 0; c < 8; ++c) {
    hn::StoreInterleaved4(x[0][c], x[1][c], x[2][c], hn::Zero(d), d,
                          forces + (static_cast<std::size_t>(c) * kBlock + lane) * kStride);
  }
}

template <Law law, VolumeShape shape, bool box>
void step_of(ElementBlocks& e, const SecantTables& tables, const double* position, double* force, std::size_t first,
             std::size_t last) {
  const hn::CappedTag<double, kBlock> d;
  const RowPart quad;
  const std::size_t parts = hn::Lanes(quad);
  HWY_ALIGN double corners[8 * kBlock * kStride], forces[8 * kBlock * kStride];
  for (std::size_t block = first; block < last; ++block) {
    const std::int32_t* corner = &e.corner[block * 8 * kBlock];
    const auto position_of = [&](std::size_t k, std::size_t p) HWY_ATTR {
      return hn::LoadU(quad, position + kStride * static_cast<std::size_t>(corner[k]) + p);
    };
    collect_rows(8 * kBlock, position_of, corners);
    for (std::size_t lane = 0; lane < kBlock; lane += hn::Lanes(d)) {
      lanes_step<law, shape, box>(d, e, tables, block, lane, corners, forces);
    }
#pragma GCC unroll 8
    for (std::size_t k = 0; k < 8 * kBlock; ++k) {
      double* node = force + kStride * static_cast<std::size_t>(corner[k]);
      for (std::size_t p = 0; p < kStride; p += parts) {
        hn::StoreU(hn::LoadU(quad, node + p) + hn::Load(quad, forces + kStride * k + p), quad, node + p);
      }
    }
  }
}

template <Law law, VolumeShape shape>
void steps_of(ElementBlocks& e, const SecantTables& tables, const double* position, double* force, std::size_t share,
              std::size_t shares) {
  const auto [boxes, others] = block_shares(e, share, shares);
  step_of<law, shape, true>(e, tables, position, force, boxes.first, boxes.second);
  step_of<law, shape, false>(e, tables, position, force, others.first, others.second);
}

void local_steps(ElementBlocks& e, const SecantTables& tables, Law law, VolumeShape shape, const double* position,
                 double* force, std::size_t share, std::size_t shares) {
  if (law == Law::Calibrated) {
    if (shape == VolumeShape::Proj) {
      steps_of<Law::Calibrated, VolumeShape::Proj>(e, tables, position, force, share, shares);
    } else {
      steps_of<Law::Calibrated, VolumeShape::Scale>(e, tables, position, force, share, shares);
    }
  } else if (shape == VolumeShape::Proj) {
    steps_of<Law::Thesis, VolumeShape::Proj>(e, tables, position, force, share, shares);
  } else {
    steps_of<Law::Thesis, VolumeShape::Scale>(e, tables, position, force, share, shares);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(local_steps);

void local_step(ElementBlocks& elements, const SecantTables& tables, Law law, VolumeShape shape, const double* position,
                double* force, std::size_t share, std::size_t shares) {
  HWY_DYNAMIC_DISPATCH(local_steps)(elements, tables, law, shape, position, force, share, shares);
}

}  // namespace softgrip::gdfe
#endif
