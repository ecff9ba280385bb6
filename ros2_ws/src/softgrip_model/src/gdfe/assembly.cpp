// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/assembly.hpp"

#include <algorithm>

namespace softgrip::gdfe {
namespace {

using Unknowns = std::array<std::int32_t, 8>;  // of an element's corners

// Unknown -> its elements, ascending, in compressed rows.
struct ElementsOf {
  std::vector<std::int32_t> first, element;
};

ElementsOf elements_of(const std::vector<Unknowns>& unknowns, std::size_t size) {
  ElementsOf found{std::vector<std::int32_t>(size + 1, 0), {}};
  const auto each = [&](const auto& visit) {
    for (std::size_t e = 0; e < unknowns.size(); ++e) {
      for (auto a = unknowns[e].begin(); a != unknowns[e].end(); ++a) {
        const bool tied_to_earlier = std::find(unknowns[e].begin(), a, *a) != a;
        if (*a >= 0 && !tied_to_earlier) visit(static_cast<std::size_t>(*a), static_cast<std::int32_t>(e));
      }
    }
  };
  each([&](std::size_t unknown, std::int32_t) { ++found.first[unknown + 1]; });
  for (std::size_t u = 0; u < size; ++u) found.first[u + 1] += found.first[u];
  found.element.resize(static_cast<std::size_t>(found.first[size]));
  std::vector<std::int32_t> next(found.first.begin(), found.first.end() - 1);
  each([&](std::size_t unknown, std::int32_t e) { found.element[static_cast<std::size_t>(next[unknown]++)] = e; });
  return found;
}

}  // namespace

SparseMatrix assembled(const std::vector<Element>& elements, const Hexes& hexes, const std::vector<double>& weight,
                       const std::vector<std::int32_t>& map, int size) {
  std::vector<Unknowns> unknowns(elements.size());
  for (std::size_t e = 0; e < elements.size(); ++e) {
    for (int a = 0; a < 8; ++a) unknowns[e][a] = map[static_cast<std::size_t>(hexes(static_cast<Eigen::Index>(e), a))];
  }
  const ElementsOf around = elements_of(unknowns, static_cast<std::size_t>(size));
  std::vector<double> sum(static_cast<std::size_t>(size));
  std::vector<int> met(static_cast<std::size_t>(size), -1), rows;
  SparseMatrix matrix(size, size);
  matrix.reserve(27 * static_cast<Eigen::Index>(size));  // of a node inside a grid
  for (int column = 0; column < size; ++column) {
    rows.clear();
    for (std::int32_t k = around.first[column]; k < around.first[column + 1]; ++k) {
      const auto e = static_cast<std::size_t>(around.element[k]);
      std::array<int, 8> own{};
      int owned = 0;
      for (int b = 0; b < 8; ++b) {
        if (unknowns[e][b] == column) own[owned++] = b;
      }
      for (int a = 0; a < 8; ++a) {
        const int row = unknowns[e][a];
        if (row < 0) continue;
        if (met[row] != column) met[row] = column, sum[row] = 0.0, rows.push_back(row);
        for (int b = 0; b < owned; ++b) sum[row] += weight[e] * elements[e].laplacian(a, own[b]);
      }
    }
    std::sort(rows.begin(), rows.end());
    matrix.startVec(column);
    for (const int row : rows) matrix.insertBack(row, column) = sum[row];
  }
  matrix.finalize();
  return matrix;
}

}  // namespace softgrip::gdfe
