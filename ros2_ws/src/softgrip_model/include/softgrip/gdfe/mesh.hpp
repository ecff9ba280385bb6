// SPDX-License-Identifier: Apache-2.0
// A hexahedral mesh at rest, and what the local step needs of each element.
//
// Corner order as in VTK and CalculiX C3D8: (xi, eta, zeta) = (-,-,-) (+,-,-) (+,+,-) (-,+,-), then the same with zeta
// = +. With V the 8x3 corner positions: F = V^T G is the element's mean deformation gradient, G = (1/V0) int grad N dV.
// On parallelepipeds this is the least-squares affine map X (X^T X)^-1 of the thesis; on others it keeps the element's
// energy variational. The FE Laplacian K_e = int grad N grad N^T dV splits exactly into K_e = V0 G G^T + Gamma S
// Gamma^T, Gamma = H - G X^T H, with the four hourglass patterns H = (eta zeta, xi zeta, xi eta, xi eta zeta).
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace softgrip::gdfe {

using Nodes = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Hexes = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 8, Eigen::RowMajor>;
using Corners = Eigen::Matrix<double, 8, 3>;
using Matrix8 = Eigen::Matrix<double, 8, 8>;

// Values from one node to the next in positions and forces: x, y, z and one to spare.
inline constexpr std::size_t kStride = 4;

inline constexpr std::array<std::array<int, 3>, 8> kCornerSigns{
    {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, 1}}};

struct Element {
  double volume;                               // V0
  Corners gradient;                            // G [1/length]
  Eigen::Matrix<double, 4, 3> hourglass_rest;  // H^T X
  Eigen::Matrix4d hourglass_stiffness;         // S [length]
  Matrix8 laplacian;                           // K_e [length]
};

// d N_a / d (xi, eta, zeta) of the eight corners.
Corners shape_slopes(double xi, double eta, double zeta);

// Stiffness of the hourglass patterns: of the FE Laplacian, or of the thesis' centring matrix N (1.5 times that on
// cubes).
enum class Metric : std::uint8_t { Laplacian = 0, Centring = 1 };

// Corner coordinates X (8x3) -> element data.
Element make_element(const Corners& rest, Metric metric = Metric::Laplacian);

// Least det of the isoparametric map at Gauss points and corners.
double min_jacobian(const Corners& rest);

// The step of differences of forces [length]: beyond their noise, and nothing beside what bends their slopes. Soft
// motions are small differences of stiff ones: a coarser difference would not resolve them.
inline double difference_step(const Nodes& rest) {
  return 1e-8 * (rest.colwise().maxCoeff() - rest.colwise().minCoeff()).norm();
}

inline Corners corners_of(const Nodes& rest, const Hexes& hexes, Eigen::Index element) {
  Corners corners;
  for (int a = 0; a < 8; ++a) corners.row(a) = rest.row(hexes(element, a));
  return corners;
}

}  // namespace softgrip::gdfe
