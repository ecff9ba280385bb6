// SPDX-License-Identifier: Apache-2.0
// The rigorous law: Q1P0 hexahedra of Ogden materials (Eq 5.11), eight Gauss points, the pressure constant per element.
//
//   W = sum_p 2 mu_p / alpha_p^2 (sum_i lb_i^alpha_p - 3) + K/2 (theta - 1)^2,  lb_i = J^(-1/3) l_i, theta = V / V0
// so K = 2 / D1 of CalculiX and Abaqus. Corner forces are its exact gradient.
#pragma once

#include <cstddef>
#include <vector>

#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

struct OgdenMaterial {
  std::vector<double> moduli;     // mu_p
  std::vector<double> exponents;  // alpha_p
  double bulk = 0.0;              // K
};

// [3 corner + axis]
using ElementTangent = Eigen::Matrix<double, 24, 24>;

class OgdenElements {
 public:
  OgdenElements(const Nodes& rest, const Hexes& hexes, const std::vector<int>& materials,
                std::vector<OgdenMaterial> table);

  // position, force: [node][kStride]; force is added to, strain[e] = eps_eq (nu = 0.5) of the mean deformation
  // gradient. Elements first .. last-1. A Gauss point turned inside out makes forces NaN: the caller steps back.
  void add_forces(const double* position, double* force, double* strain, std::size_t first, std::size_t last) const;

  // Strain energy at a state.
  double energy(const double* position) const;

  // Exact derivative of an element's corner forces to its corners' positions, symmetric.
  ElementTangent tangent(const double* position, std::size_t element) const;

 private:
  struct Point {
    Corners gradient;
    double weight;
  };

  Corners corners(const double* position, std::size_t element) const;

  Hexes hexes_;
  std::vector<int> material_;
  std::vector<OgdenMaterial> table_;
  std::vector<Point> points_;  // 8 per element
  std::vector<double> volume_;
};

}  // namespace softgrip::gdfe
