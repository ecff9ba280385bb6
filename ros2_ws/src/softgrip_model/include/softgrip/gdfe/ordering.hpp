// SPDX-License-Identifier: Apache-2.0
// In what order a factor eliminates its unknowns.
#pragma once

#include <vector>

#include "softgrip/gdfe/constant_inverse.hpp"

namespace softgrip::gdfe {

struct Elimination {
  std::vector<int> position;  // unknown -> its place
  // of every column of the factor in that order
  std::vector<int> parent;  // row of its first entry below the diagonal, -1 if it has none
  std::vector<int> count;   // its entries below the diagonal
};

// By METIS or AMD, or from both ends of a slender mesh to its middle, whichever fills in least. Each subtree of the
// elimination tree is in one piece and columns of like rows are neighbours. matrix: symmetric, both triangles.
Elimination eliminate(const SparseMatrix& matrix, bool metis);

}  // namespace softgrip::gdfe
