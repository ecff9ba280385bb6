// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/ogden.hpp"

#include <array>
#include <cmath>
#include <limits>

namespace softgrip::gdfe {
namespace {

using Matrix3 = Eigen::Matrix3d;

struct Spectrum {
  Eigen::Vector3d stretch;
  Matrix3 direction;  // columns: principal directions at rest
};

Spectrum spectrum_of(const Matrix3& f) {
  Eigen::SelfAdjointEigenSolver<Matrix3> solver;
  solver.computeDirect(f.transpose() * f);
  return {solver.eigenvalues().cwiseMax(0.0).cwiseSqrt(), solver.eigenvectors()};
}

// sum_p 2 mu/alpha (lb_i^alpha - mean): principal Kirchhoff stresses of the isochoric part.
Eigen::Vector3d isochoric_stress(const OgdenMaterial& material, const Eigen::Vector3d& log_stretch) {
  Eigen::Vector3d stress = Eigen::Vector3d::Zero();
  for (std::size_t p = 0; p < material.moduli.size(); ++p) {
    const double alpha = material.exponents[p];
    const Eigen::Vector3d power = (alpha * log_stretch).array().exp();
    stress += 2.0 * material.moduli[p] / alpha * (power.array() - power.mean()).matrix();
  }
  return stress;
}

Matrix3 cofactor(const Matrix3& f) {
  Matrix3 c;
  c.col(0) = f.col(1).cross(f.col(2));
  c.col(1) = f.col(2).cross(f.col(0));
  c.col(2) = f.col(0).cross(f.col(1));
  return c;
}

}  // namespace

OgdenElements::OgdenElements(const Nodes& rest, const Hexes& hexes, const std::vector<int>& materials,
                             std::vector<OgdenMaterial> table)
    : hexes_(hexes), material_(materials), table_(std::move(table)) {
  const auto count = static_cast<std::size_t>(hexes.rows());
  points_.reserve(8 * count);
  volume_.assign(count, 0.0);
  for (std::size_t e = 0; e < count; ++e) {
    Corners x;
    for (int a = 0; a < 8; ++a) x.row(a) = rest.row(hexes(static_cast<Eigen::Index>(e), a));
    for (const auto& sign : kCornerSigns) {
      const double point = 1.0 / std::sqrt(3.0);
      const Corners slopes = shape_slopes(sign[0] * point, sign[1] * point, sign[2] * point);
      const Matrix3 map = x.transpose() * slopes;
      points_.push_back({slopes * map.inverse(), map.determinant()});
      volume_[e] += points_.back().weight;
    }
  }
}

Corners OgdenElements::corners(const double* position, std::size_t element) const {
  Corners x;
  for (int a = 0; a < 8; ++a) {
    const double* node = position + kStride * static_cast<std::size_t>(hexes_(static_cast<Eigen::Index>(element), a));
    x.row(a) << node[0], node[1], node[2];
  }
  return x;
}

void OgdenElements::add_forces(const double* position, double* force, double* strain, std::size_t first,
                               std::size_t last) const {
  for (std::size_t e = first; e < last; ++e) {
    const Corners x = corners(position, e);
    const OgdenMaterial& material = table_[static_cast<std::size_t>(material_[e])];
    std::array<Matrix3, 8> f;
    double volume = 0.0;
    Matrix3 mean = Matrix3::Zero();
    for (std::size_t q = 0; q < 8; ++q) {
      const Point& point = points_[8 * e + q];
      f[q] = x.transpose() * point.gradient;
      volume += point.weight * f[q].determinant();
      mean += point.weight * f[q];
    }
    const double pressure = material.bulk * (volume / volume_[e] - 1.0);
    Corners total = Corners::Zero();
    for (std::size_t q = 0; q < 8; ++q) {
      const Point& point = points_[8 * e + q];
      const double det = f[q].determinant();
      if (!(det > 0.0)) {
        total.setConstant(std::numeric_limits<double>::quiet_NaN());
        break;
      }
      const Spectrum spectrum = spectrum_of(f[q]);
      const Eigen::Vector3d log_stretch = spectrum.stretch.array().log() - std::log(det) / 3.0;
      const Eigen::Vector3d factor =
          isochoric_stress(material, log_stretch).cwiseQuotient(spectrum.stretch.cwiseAbs2());
      const Matrix3 stress =
          f[q] * spectrum.direction * factor.asDiagonal() * spectrum.direction.transpose() + pressure * cofactor(f[q]);
      total += point.weight * point.gradient * stress.transpose();
    }
    for (int a = 0; a < 8; ++a) {
      double* node = force + kStride * static_cast<std::size_t>(hexes_(static_cast<Eigen::Index>(e), a));
      for (int i = 0; i < 3; ++i) node[i] += total(a, i);
    }
    const Eigen::Vector3d stretch = spectrum_of(mean / volume_[e]).stretch;
    strain[e] = std::sqrt(1.5) / 1.5 * (stretch.array() - stretch.mean()).matrix().norm();
  }
}

double OgdenElements::energy(const double* position) const {
  double total = 0.0;
  for (std::size_t e = 0; e < volume_.size(); ++e) {
    const Corners x = corners(position, e);
    const OgdenMaterial& material = table_[static_cast<std::size_t>(material_[e])];
    double volume = 0.0;
    for (std::size_t q = 0; q < 8; ++q) {
      const Point& point = points_[8 * e + q];
      const Matrix3 f = x.transpose() * point.gradient;
      const double det = f.determinant();
      volume += point.weight * det;
      const Eigen::Vector3d log_stretch = spectrum_of(f).stretch.array().log() - std::log(det) / 3.0;
      for (std::size_t p = 0; p < material.moduli.size(); ++p) {
        const double alpha = material.exponents[p];
        total += point.weight * 2.0 * material.moduli[p] / (alpha * alpha) *
                 ((alpha * log_stretch).array().exp().sum() - 3.0);
      }
    }
    const double swelling = volume / volume_[e] - 1.0;
    total += 0.5 * material.bulk * swelling * swelling * volume_[e];
  }
  return total;
}

}  // namespace softgrip::gdfe
