// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/ogden.hpp"

#include <array>
#include <cmath>
#include <limits>

namespace softgrip::gdfe {
namespace {

using Matrix3 = Eigen::Matrix3d;

// Principal stretches this near to each other count as equal: their differences' quotient loses half the digits there.
constexpr double kEqualStretch = 1e-6;

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

// How the principal stresses P_i = dW/dl_i of the isochoric part answer to the principal stretches (direct), and how
// they turn with F: an element of F across two principal directions is answered along itself and across.
struct Answer {
  Matrix3 direct, along, across;
};

Answer isochoric_answer(const OgdenMaterial& material, const Eigen::Vector3d& stretch) {
  const Eigen::Vector3d log_stretch = stretch.array().log() - std::log(stretch.prod()) / 3.0;
  const Eigen::Vector3d kirchhoff = isochoric_stress(material, log_stretch), stress = kirchhoff.cwiseQuotient(stretch);
  Answer answer{Matrix3::Zero(), Matrix3::Zero(), Matrix3::Zero()};
  for (std::size_t p = 0; p < material.moduli.size(); ++p) {
    const Eigen::Vector3d power = (material.exponents[p] * log_stretch).array().exp();
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        answer.direct(i, j) +=
            2.0 * material.moduli[p] * ((i == j ? power(i) : 0.0) - (power(i) + power(j) - power.mean()) / 3.0);
      }
    }
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) answer.direct(i, j) /= stretch(i) * stretch(j);
    answer.direct(i, i) -= stress(i) / stretch(i);
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      if (i == j) continue;
      const double apart = stretch(i) - stretch(j);
      const double flip = std::abs(apart) > kEqualStretch * stretch(i)
                              ? (stress(i) - stress(j)) / apart
                              : 0.5 * (answer.direct(i, i) + answer.direct(j, j)) - answer.direct(i, j);
      const double twist = (stress(i) + stress(j)) / (stretch(i) + stretch(j));
      answer.along(i, j) = 0.5 * (flip + twist);
      answer.across(i, j) = 0.5 * (flip - twist);
    }
  }
  return answer;
}

Matrix3 cofactor(const Matrix3& f) {
  Matrix3 c;
  c.col(0) = f.col(1).cross(f.col(2));
  c.col(1) = f.col(2).cross(f.col(0));
  c.col(2) = f.col(0).cross(f.col(1));
  return c;
}

Matrix3 cross_matrix(const Eigen::Vector3d& v) {
  Matrix3 cross;
  cross << 0.0, -v(2), v(1), v(2), 0.0, -v(0), -v(1), v(0), 0.0;
  return cross;
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

ElementTangent OgdenElements::tangent(const double* position, std::size_t element) const {
  const Corners x = corners(position, element);
  const OgdenMaterial& material = table_[static_cast<std::size_t>(material_[element])];
  ElementTangent total = ElementTangent::Zero(), swelling_turn = ElementTangent::Zero();
  Eigen::Matrix<double, 24, 1> swelling = Eigen::Matrix<double, 24, 1>::Zero();  // d volume / d corners
  double volume = 0.0;
  for (std::size_t q = 0; q < 8; ++q) {
    const Point& point = points_[8 * element + q];
    const Matrix3 f = x.transpose() * point.gradient, stretched = cofactor(f);
    volume += point.weight * f.determinant();
    const Spectrum spectrum = spectrum_of(f);
    const Answer answer = isochoric_answer(material, spectrum.stretch);
    const Matrix3 here = f * spectrum.direction * spectrum.stretch.cwiseInverse().asDiagonal();
    const Corners slopes = point.gradient * spectrum.direction;
    for (int a = 0; a < 8; ++a) {
      swelling.segment<3>(3 * a) += point.weight * stretched * point.gradient.row(a).transpose();
      for (int b = 0; b <= a; ++b) {
        const auto of_a = slopes.row(a), of_b = slopes.row(b);
        Matrix3 block;
        for (int i = 0; i < 3; ++i) {
          for (int j = 0; j < 3; ++j) {
            block(i, j) = answer.direct(i, j) * of_a(i) * of_b(j) + answer.across(i, j) * of_a(j) * of_b(i);
          }
          block(i, i) += (answer.along.row(i).array() * of_a.array() * of_b.array()).sum();
        }
        total.block<3, 3>(3 * a, 3 * b) += point.weight * here * block * here.transpose();
        const Eigen::Vector3d turn = point.weight * f * point.gradient.row(a).cross(point.gradient.row(b)).transpose();
        swelling_turn.block<3, 3>(3 * a, 3 * b) += -cross_matrix(turn);
      }
    }
  }
  total += material.bulk * (volume / volume_[element] - 1.0) * swelling_turn;
  total += material.bulk / volume_[element] * swelling * swelling.transpose();
  return total.selfadjointView<Eigen::Lower>();
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
