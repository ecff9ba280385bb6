// SPDX-License-Identifier: Apache-2.0
// Rotation and volume correction of 3x3 matrices, as many abreast as a vector has lanes. Compiled once per instruction
// set: the guard is undone for each.
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

// Invariants of the stretch U = R^T F, and what they come from: cof F and C = F^T F (upper triangle by rows).
template <class V>
struct Stretch {
  Matrix3<V> cof;
  V c[6];
  V trace, second, det;  // of U: i1, i2, i3

  HWY_INLINE Stretch() {}
};

// i1 is the largest root of (x^2 - |F|^2)^2 = 4 |cof F|^2 + 8 det F x. `inverse_cof_squared`, 1 / |cof F|^2, falls off.
template <class D, class V = hn::Vec<D>>
HWY_INLINE Stretch<V> stretch_of(D d, const Matrix3<V>& f, V& inverse_cof_squared) {
  const auto number = [&](double value) HWY_ATTR { return hn::Set(d, value); };
  Stretch<V> u;
  u.cof = cofactors(f);
  u.det = determinant(f, u.cof);
  int at = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j)
      u.c[at++] = hn::MulAdd(f.m[0][i], f.m[0][j], hn::MulAdd(f.m[1][i], f.m[1][j], f.m[2][i] * f.m[2][j]));
  }
  const V square = u.c[0] + u.c[3] + u.c[5], cof_square = dot(u.cof, u.cof);
  const V inverse = number(1.0) / (square * cof_square);
  inverse_cof_squared = inverse * square;
  // of third order in the differences of the principal stretches
  V x = hn::Sqrt(hn::MulAdd(number(4.5) * cof_square, cof_square * inverse, number(1.5) * square));
  const V four_cof = number(4.0) * cof_square, eight_det = number(8.0) * u.det;
  for (int iteration = 0; iteration < 20; ++iteration) {  // Chebyshev's method: cubic, one division
    const V h = hn::MulSub(x, x, square), four_x = number(4.0) * x;
    const V f_x = hn::NegMulAdd(eight_det, x, hn::MulSub(h, h, four_cof));
    const V slope_inverse = number(1.0) / hn::MulSub(four_x, h, eight_det);
    const V newton = f_x * slope_inverse;
    const V bend = hn::MulAdd(number(6.0), x * x, number(-2.0) * square) * slope_inverse;
    const V step = hn::MulAdd(newton * newton, bend, newton);
    x = x - step;
    if (hn::AllTrue(d, hn::Lt(hn::Abs(step), number(2e-6) * x))) break;  // leaves 1e-17
  }
  u.trace = x;
  u.second = number(0.5) * hn::MulSub(x, x, square);
  return u;
}

// The polar rotation R = ((i1^2 - i2) F + i1 cof F - F C) / (i1 i2 - i3), by Cayley and Hamilton.
template <class D, class V = hn::Vec<D>>
HWY_INLINE Matrix3<V> rotation_of(D d, const Matrix3<V>& f, const Stretch<V>& u) {
  const V inverse = hn::Set(d, 1.0) / hn::MulSub(u.trace, u.second, u.det);
  const V on_cof = inverse * u.trace, on_f = inverse * hn::MulSub(u.trace, u.trace, u.second), less = hn::Neg(inverse);
  V c[3][3];
  int at = 0;
  for (int i = 0; i < 3; ++i) {
    c[i][i] = hn::MulAdd(less, u.c[at++], on_f);
    for (int j = i + 1; j < 3; ++j) c[i][j] = c[j][i] = less * u.c[at++];
  }
  Matrix3<V> r;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      r.m[i][j] = hn::MulAdd(f.m[i][0], c[0][j],
                             hn::MulAdd(f.m[i][1], c[1][j], hn::MulAdd(f.m[i][2], c[2][j], on_cof * u.cof.m[i][j])));
    }
  }
  return r;
}

// One step of the fixed point of Bouaziz et al. 2014 towards D = F* - F with det F* = 1 and |D| least; returns the
// squared change.
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

// D = F* - F = l cof F* with det F* = 1 where det F is in this range; beyond it the scalar problem has other roots near
// by.
constexpr double kVolumeFrom = 0.5, kVolumeTo = 1.6;

// With x, y the first two invariants of the stretch of F*, whose third is 1, and s = t - l / t for its principal values
// t:
//   x = i1 + l y,   y - l (x y - 3) + l^2 x = i2,   1 - l (y^2 - 2 x) + l^2 (x^2 - 2 y) - l^3 = i3,
//   D = l (cof F + l (x y - 1) R - l (y + l) F) / (1 + l x + l^2 y + l^3).
// Newton in l and y; false where a lane has no part in this.
template <class D, class V = hn::Vec<D>>
HWY_INLINE bool volume_by_invariants(D d, const Matrix3<V>& f, const Stretch<V>& u, const Matrix3<V>& r,
                                     V inverse_cof_squared, Matrix3<V>& correction) {
  const auto number = [&](double value) HWY_ATTR { return hn::Set(d, value); };
  const V one = number(1.0), two = number(2.0), three = number(3.0);
  if (!hn::AllTrue(d, hn::And(hn::Gt(u.det, number(kVolumeFrom)), hn::Lt(u.det, number(kVolumeTo))))) return false;
  // exact for equal principal stretches to second order, for any to first
  V l = (one - u.det) * u.det * inverse_cof_squared;
  V y = u.second * hn::MulAdd(l, hn::MulAdd(l, hn::MulAdd(l, number(4.0), three), two), one);
  V x = hn::MulAdd(l, y, u.trace);
  bool settled = false;
  for (int iteration = 0; iteration < 8 && !settled; ++iteration) {
    const V ll = l * l, lx = l * x, ly = l * y, xy = x * y, llx = l * lx, yy_2x = hn::MulSub(y, y, x + x);
    const V e1 = hn::NegMulAdd(l, xy - three, y + llx) - u.second;
    const V e2 = hn::MulAdd(l, hn::MulSub(l, hn::MulSub(x, x, y + y), ll), hn::NegMulAdd(l, yy_2x, one)) - u.det;
    const V e1_y = hn::MulAdd(l, ll - x - ly, one);
    const V e1_l = hn::MulAdd(ly, l - y, hn::MulAdd(two, lx, three - xy));
    const V e2_y = two * hn::MulSub(ll, lx, ly);
    const V e2_l = hn::MulAdd(two, hn::MulAdd(lx, x + ly, hn::Neg(ly)), hn::Neg(hn::MulAdd(three, ll, yy_2x)));
    const V inverse = one / hn::MulSub(e1_y, e2_l, e1_l * e2_y);
    const V l_step = hn::MulSub(e1_y, e2, e2_y * e1) * inverse, y_step = hn::MulSub(e2_l, e1, e1_l * e2) * inverse;
    l = l - l_step;
    y = y - y_step;
    x = hn::MulAdd(l, y, u.trace);
    // quadratic: leaves 1e-11 of D
    settled = hn::AllTrue(d, hn::Lt(hn::Max(hn::Abs(l_step), hn::Abs(y_step)), number(1e-6)));
  }
  const V y_l = y + l;
  const V scale = l / hn::MulAdd(l, hn::MulAdd(l, y_l, x), one);
  const V on_r = scale * l * hn::MulSub(x, y, one), on_f = scale * l * y_l;
  for (int k = 0; k < 9; ++k) {
    const int i = k / 3, j = k % 3;
    correction.m[i][j] = hn::NegMulAdd(on_f, f.m[i][j], hn::MulAdd(on_r, r.m[i][j], scale * u.cof.m[i][j]));
  }
  return settled;
}

// The rotation of F, det F > 0, and, for the shape `proj`, its volume correction.
template <VolumeShape shape, class D, class V = hn::Vec<D>>
HWY_INLINE void rotation_and_volume(D d, const Matrix3<V>& f, V& det, Matrix3<V>& r, Matrix3<V>& correction) {
  V inverse_cof_squared;
  const Stretch<V> u = stretch_of(d, f, inverse_cof_squared);
  det = u.det;
  r = rotation_of(d, f, u);
  if constexpr (shape == VolumeShape::Proj) {
    if (volume_by_invariants(d, f, u, r, inverse_cof_squared, correction)) return;
  }
  for (int k = 0; k < 9; ++k) correction.m[k / 3][k % 3] = hn::Zero(d);
  if constexpr (shape == VolumeShape::Proj) {
    for (int iteration = 0; iteration < 20; ++iteration) {
      // linear, by a tenth to a third a step: a change of 3e-10 leaves at most 1e-10
      if (hn::AllTrue(d, hn::Lt(volume_step(d, f, correction), hn::Set(d, 1e-19)))) break;
    }
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
