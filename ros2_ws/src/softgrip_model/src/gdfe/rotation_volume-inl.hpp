// SPDX-License-Identifier: Apache-2.0
// Rotation and volume correction of 3x3 matrices, as many abreast as a vector has lanes. Compiled once per instruction set: the
// guard is undone for each.
#if defined(SOFTGRIP_GDFE_ROTATION_VOLUME) == defined(HWY_TARGET_TOGGLE)
#ifdef SOFTGRIP_GDFE_ROTATION_VOLUME
#undef SOFTGRIP_GDFE_ROTATION_VOLUME
#else
#define SOFTGRIP_GDFE_ROTATION_VOLUME
#endif

#include <hwy/highway.h>

#include "softgrip/gdfe/local_step.hpp"

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

}  // namespace HWY_NAMESPACE
}  // namespace softgrip::gdfe
HWY_AFTER_NAMESPACE();

#endif  // the guard
