// SPDX-License-Identifier: Apache-2.0
// The constant matrix of one axis.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"
#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

// sum_e weight_e K_e on `size` unknowns; map: node -> unknown, -1 where it is held. Both triangles.
SparseMatrix assembled(const std::vector<Element>& elements, const Hexes& hexes, const std::vector<double>& weight,
                       const std::vector<std::int32_t>& map, int size);

}  // namespace softgrip::gdfe
