// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set by Highway and chosen at run time.
#include "softgrip/gdfe/local_step.hpp"

#include <cmath>

#include "src/gdfe/inverted.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "src/gdfe/local_step.cpp"
// Vectors are kept in arrays here: not possible with the sizeless types of SVE and RVV, which run NEON or scalar code.
#ifndef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#endif
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace softgrip::gdfe {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <class V>
struct Matrix3 {
  V m[3][3];

  HWY_INLINE Matrix3() {}  // the implicit one would not be of this instruction set: GCC refuses it for NEON
};

template <class V>
HWY_INLINE Matrix3<V> cofactors(const Matrix3<V>& a) {
  Matrix3<V> c;
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      c.m[i][j] = hn::MulSub(a.m[i1][j1], a.m[i2][j2], a.m[i1][j2] * a.m[i2][j1]);
    }
  }
  return c;
}

template <class V>
HWY_INLINE V dot(const Matrix3<V>& a, const Matrix3<V>& b) {
  V rows[3];  // by rows: a chain of nine additions would be waited for
  for (int i = 0; i < 3; ++i) {
    rows[i] = hn::MulAdd(a.m[i][0], b.m[i][0], hn::MulAdd(a.m[i][1], b.m[i][1], a.m[i][2] * b.m[i][2]));
  }
  return (rows[0] + rows[1]) + rows[2];
}

template <class V>
HWY_INLINE V determinant(const Matrix3<V>& a, const Matrix3<V>& cof) {
  return hn::MulAdd(a.m[0][0], cof.m[0][0], hn::MulAdd(a.m[0][1], cof.m[0][1], a.m[0][2] * cof.m[0][2]));
}

// One step of Newton's polar iteration R <- (g R + cof(R) / (g det R)) / 2, with Frobenius scaling g where `scaled`; returns
// the squared change.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V polar_step(D d, Matrix3<V>& r, bool scaled) {
  const V half = hn::Set(d, 0.5);
  const Matrix3<V> cof = cofactors(r);
  const V inverse = hn::Set(d, 1.0) / determinant(r, cof);
  V scale = half, scale_inverse = half * inverse;
  if (scaled) {
    const V ratio = hn::Sqrt(dot(cof, cof) / dot(r, r)) * hn::Abs(inverse);  // |R^-T| / |R|
    const V g = hn::Sqrt(ratio);
    scale = half * g;
    scale_inverse = half * inverse / g;
  }
  Matrix3<V> change;
  for (int k = 0; k < 9; ++k) {
    const V before = r.m[k / 3][k % 3];
    r.m[k / 3][k % 3] = hn::MulAdd(scale, before, scale_inverse * cof.m[k / 3][k % 3]);
    change.m[k / 3][k % 3] = r.m[k / 3][k % 3] - before;
  }
  return dot(change, change);
}

// One step of the fixed point of Bouaziz et al. 2014 towards D = F* - F with det F* = 1 and |D| least; returns the squared
// change.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V volume_step(D d, const Matrix3<V>& f, Matrix3<V>& correction) {
  Matrix3<V> target;
  for (int k = 0; k < 9; ++k) target.m[k / 3][k % 3] = f.m[k / 3][k % 3] + correction.m[k / 3][k % 3];
  const Matrix3<V> cof = cofactors(target);
  const V gap = determinant(target, cof) - hn::Set(d, 1.0);
  const V step = (dot(cof, correction) - gap) / (dot(cof, cof) + hn::Set(d, 1e-12));
  Matrix3<V> change;
  for (int k = 0; k < 9; ++k) {
    const V after = step * cof.m[k / 3][k % 3];
    change.m[k / 3][k % 3] = after - correction.m[k / 3][k % 3];
    correction.m[k / 3][k % 3] = after;
  }
  return dot(change, change);
}

// The rotation of F and, for the shape `proj`, its volume correction, side by side: each alone is a chain of divisions.
template <VolumeShape shape, class D, class V = hn::Vec<D>>
HWY_INLINE void rotation_and_volume(D d, const Matrix3<V>& f, V det, Matrix3<V>& r, Matrix3<V>& correction) {
  const V half = hn::Set(d, 0.5);
  const auto even = hn::Lt(hn::Abs(dot(f, f) - hn::Set(d, 3.0)), hn::Set(d, 1.5));
  const bool near = hn::AllTrue(d, hn::And(even, hn::Gt(det, half)));  // to a rotation: no scaling
  r = f;
  for (int k = 0; k < 9; ++k) correction.m[k / 3][k % 3] = hn::Zero(d);
  for (int iteration = 0; iteration < 20; ++iteration) {
    const bool scaled = iteration < 2 && !near;
    // quadratic: a change of 3e-8 leaves 1e-15
    auto settled = hn::Lt(polar_step(d, r, scaled), hn::Set(d, 1e-15));
    if constexpr (shape == VolumeShape::Proj) {
      // linear, by a tenth to a third a step: a change of 3e-10 leaves at most 1e-10
      settled = hn::And(settled, hn::Lt(volume_step(d, f, correction), hn::Set(d, 1e-19)));
    }
    if (!scaled && hn::AllTrue(d, settled)) break;
  }
}

// x^(-1/3) by Newton; 1 / (2/3 + x/3) lies below it (arithmetic over geometric mean), so the way is monotone.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V inverse_cube_root(D d, V x) {
  const V third = hn::Set(d, 1.0 / 3.0), four = hn::Set(d, 4.0);
  V y = hn::Set(d, 1.0) / hn::MulAdd(third, x, hn::Set(d, 2.0 / 3.0));
  for (int iteration = 0; iteration < 12; ++iteration) {
    const V next = y * (four - x * y * y * y) * third;
    const bool still = hn::AllTrue(d, hn::Lt(hn::Abs(next - y), hn::Set(d, 1e-8)));
    y = next;
    if (still) break;
  }
  return y;
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V secant_modulus(D d, const SecantTables& tables, V strain, V material) {
  const hn::RebindToSigned<D> di;
  const V cells = hn::Set(d, static_cast<double>(tables.cells));
  V t = strain * hn::Set(d, tables.cells / tables.end);
  t = hn::Min(t, hn::Set(d, tables.cells * (1.0 - 1e-12)));
  const V cell = hn::Floor(t);
  t = t - cell;
  const auto index = hn::ConvertTo(di, hn::MulAdd(material * hn::Set(d, 4.0), cells, cell));
  const double* base = tables.coefficients.data();
  const V c0 = hn::GatherIndex(d, base, index), c1 = hn::GatherIndex(d, base + tables.cells, index);
  const V c2 = hn::GatherIndex(d, base + 2 * tables.cells, index), c3 = hn::GatherIndex(d, base + 3 * tables.cells, index);
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

// One group of lanes of one block; corners and forces: [24][kBlock], component by component.
template <Law law, VolumeShape shape, class D, class V = hn::Vec<D>>
HWY_INLINE void lanes_step(D d, ElementBlocks& e, const SecantTables& tables, std::size_t block, std::size_t lane,
                           const double* corners, double* forces) {
  const double* gradient = &e.gradient[block * 24 * kBlock + lane];
  const double* rest = &e.hourglass_rest[block * 12 * kBlock + lane];
  const double* stiffness = &e.hourglass_stiffness[block * 10 * kBlock + lane];
  const std::size_t slot = block * kBlock + lane;

  Matrix3<V> f;
  V h[4][3];
  for (int i = 0; i < 3; ++i) {
    V x[8];
    for (int a = 0; a < 8; ++a) x[a] = hn::LoadU(d, corners + (i * 8 + a) * kBlock + lane);
    for (int j = 0; j < 3; ++j) {
      V sum = x[0] * hn::LoadU(d, gradient + j * kBlock);
      for (int a = 1; a < 8; ++a) sum = hn::MulAdd(x[a], hn::LoadU(d, gradient + (a * 3 + j) * kBlock), sum);
      f.m[i][j] = sum;
    }
    const V a = x[0] - x[1], b = x[2] - x[3], c = x[4] - x[5], g = x[6] - x[7];
    const V ap = x[0] + x[1], bp = x[2] + x[3], cp = x[4] + x[5], gp = x[6] + x[7];
    h[0][i] = (ap - bp) - (cp - gp);
    h[1][i] = (a - b) - (c - g);
    h[2][i] = (a + b) + (c + g);
    h[3][i] = (c + g) - (a + b);
  }
  for (int k = 0; k < 4; ++k) {
    for (int j = 0; j < 3; ++j) {
      const V r = hn::LoadU(d, rest + (k * 3 + j) * kBlock);
      for (int i = 0; i < 3; ++i) h[k][i] = hn::NegMulAdd(r, f.m[i][j], h[k][i]);
    }
  }

  const V det = determinant(f, cofactors(f));
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
    const V ratio = hn::GatherIndex(d, tables.lame_per_mu.data(), hn::ConvertTo(hn::RebindToSigned<D>(), material));
    b = hn::Set(d, 3.0) * ratio * mu;
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

  const V volume = hn::LoadU(d, &e.volume[slot]);
  V t[4][3];
  for (int i = 0; i < 3; ++i) {
    V s[4][4];
    int row = 0;
    for (int k = 0; k < 4; ++k) {
      for (int l = k; l < 4; ++l) s[k][l] = s[l][k] = hn::LoadU(d, stiffness + row++ * kBlock);
    }
    for (int k = 0; k < 4; ++k) {
      V sum = s[k][0] * h[0][i];
      for (int l = 1; l < 4; ++l) sum = hn::MulAdd(s[k][l], h[l][i], sum);
      t[k][i] = spread * sum;
    }
  }
  for (int i = 0; i < 3; ++i) {
    V q[3];
    for (int j = 0; j < 3; ++j) {
      q[j] = volume * p.m[i][j];
      for (int k = 0; k < 4; ++k) q[j] = hn::NegMulAdd(hn::LoadU(d, rest + (k * 3 + j) * kBlock), t[k][i], q[j]);
    }
    for (int c = 0; c < 8; ++c) {
      const auto& sign = kCornerSigns[c];
      V force = sign[1] * sign[2] > 0 ? t[0][i] : hn::Neg(t[0][i]);
      force = sign[0] * sign[2] > 0 ? force + t[1][i] : force - t[1][i];
      force = sign[0] * sign[1] > 0 ? force + t[2][i] : force - t[2][i];
      force = sign[0] * sign[1] * sign[2] > 0 ? force + t[3][i] : force - t[3][i];
      for (int j = 0; j < 3; ++j) force = hn::MulAdd(q[j], hn::LoadU(d, gradient + (c * 3 + j) * kBlock), force);
      hn::StoreU(force, d, forces + (i * 8 + c) * kBlock + lane);
    }
  }
}

template <Law law, VolumeShape shape>
void step_of(ElementBlocks& e, const SecantTables& tables, const double* position, double* force, std::size_t nodes,
             std::size_t first, std::size_t last) {
  const hn::CappedTag<double, kBlock> d;
  HWY_ALIGN double corners[24 * kBlock], forces[24 * kBlock];
  for (std::size_t block = first; block < last; ++block) {
    const std::int32_t* corner = &e.corner[block * 8 * kBlock];
    for (std::size_t k = 0; k < 8 * kBlock; ++k) {
      const double* node = position + corner[k];
      corners[k] = node[0];
      corners[8 * kBlock + k] = node[nodes];
      corners[16 * kBlock + k] = node[2 * nodes];
    }
    for (std::size_t lane = 0; lane < kBlock; lane += hn::Lanes(d)) {
      lanes_step<law, shape>(d, e, tables, block, lane, corners, forces);
    }
    for (std::size_t k = 0; k < 8 * kBlock; ++k) {
      double* node = force + corner[k];
      node[0] += forces[k];
      node[nodes] += forces[8 * kBlock + k];
      node[2 * nodes] += forces[16 * kBlock + k];
    }
  }
}

void LocalStep(ElementBlocks& e, const SecantTables& tables, Law law, VolumeShape shape, const double* position,
               double* force, std::size_t nodes, std::size_t first, std::size_t last) {
  if (law == Law::Calibrated) {
    if (shape == VolumeShape::Proj) {
      step_of<Law::Calibrated, VolumeShape::Proj>(e, tables, position, force, nodes, first, last);
    } else {
      step_of<Law::Calibrated, VolumeShape::Scale>(e, tables, position, force, nodes, first, last);
    }
  } else if (shape == VolumeShape::Proj) {
    step_of<Law::Thesis, VolumeShape::Proj>(e, tables, position, force, nodes, first, last);
  } else {
    step_of<Law::Thesis, VolumeShape::Scale>(e, tables, position, force, nodes, first, last);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace softgrip::gdfe {

HWY_EXPORT(LocalStep);

void local_step(ElementBlocks& elements, const SecantTables& tables, Law law, VolumeShape shape, const double* position,
                double* force, std::size_t nodes, std::size_t first, std::size_t last) {
  HWY_DYNAMIC_DISPATCH(LocalStep)(elements, tables, law, shape, position, force, nodes, first, last);
}

}  // namespace softgrip::gdfe
#endif
