// SPDX-License-Identifier: Apache-2.0
// In what order a factor eliminates its unknowns.
#pragma once

#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"

namespace softgrip::gdfe {

// unknown -> its place: by METIS or AMD, or from both ends of a slender mesh to its middle, whichever fills in least. Each
// subtree of the elimination tree is in one piece and columns of like rows are neighbours. matrix: symmetric, both triangles.
std::vector<int> elimination_order(const SparseMatrix& matrix, bool metis);

}  // namespace softgrip::gdfe
