// SPDX-License-Identifier: Apache-2.0
// Small meshes and dense matrices that the tests compare with.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe::testing {

// Boxes of edges `size`, `counts` of them along each axis, from the origin.
struct Block {
  Nodes rest;
  Hexes hexes;
};

inline Block make_block(const std::array<int, 3>& counts, const Eigen::Vector3d& size) {
  const auto [nx, ny, nz] = counts;
  const auto node = [ny = ny, nz = nz](int i, int j, int k) { return (i * (ny + 1) + j) * (nz + 1) + k; };
  Block block{Nodes((nx + 1) * (ny + 1) * (nz + 1), 3), Hexes(nx * ny * nz, 8)};
  for (int i = 0; i <= nx; ++i) {
    for (int j = 0; j <= ny; ++j) {
      for (int k = 0; k <= nz; ++k) block.rest.row(node(i, j, k)) << i * size.x(), j * size.y(), k * size.z();
    }
  }
  Eigen::Index e = 0;
  for (int i = 0; i < nx; ++i) {
    for (int j = 0; j < ny; ++j) {
      for (int k = 0; k < nz; ++k, ++e) {
        for (int c = 0; c < 8; ++c) {
          const auto& sign = kCornerSigns[static_cast<std::size_t>(c)];
          block.hexes(e, c) = node(i + (sign[0] > 0), j + (sign[1] > 0), k + (sign[2] > 0));
        }
      }
    }
  }
  return block;
}

// One cell of a constant shear modulus: mu does not depend on strain.
inline SecantTables hooke(double shear_modulus, double poisson) {
  return {1, 1.0, {shear_modulus, 0.0, 0.0, 0.0}, {2.0 * poisson / (1.0 - 2.0 * poisson)}};
}

// Unknowns of all nodes for which `is_free`, the same on every axis.
template <class IsFree>
std::array<DofMap, 3> shared_maps(const Nodes& rest, const IsFree& is_free) {
  DofMap map(static_cast<std::size_t>(rest.rows()), -1);
  std::int32_t count = 0;
  for (Eigen::Index i = 0; i < rest.rows(); ++i) {
    if (is_free(rest.row(i))) map[static_cast<std::size_t>(i)] = count++;
  }
  return {map, map, map};
}

// A block of one linear material, held at x = 0.
inline Problem held_block(const std::array<int, 3>& counts, const Eigen::Vector3d& size, double shear_modulus,
                          double poisson) {
  const Block block = make_block(counts, size);
  Problem problem;
  problem.rest = block.rest;
  problem.hexes = block.hexes;
  problem.materials.assign(static_cast<std::size_t>(block.hexes.rows()), 0);
  problem.tables = hooke(shear_modulus, poisson);
  const double weight = shear_modulus * (2.0 + problem.tables.lame_per_mu[0]);
  problem.matrix_weight.assign(static_cast<std::size_t>(block.hexes.rows()), weight);
  problem.maps = shared_maps(block.rest, [](const auto& at) { return at(0) > 0.0; });
  return problem;
}

// sum_e weight K_e of one axis, dense, in the numbers of the map.
inline Eigen::MatrixXd dense_laplacian(const Problem& problem, int axis) {
  const DofMap& map = problem.maps[static_cast<std::size_t>(axis)];
  const int size = 1 + *std::max_element(map.begin(), map.end());
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(size, size);
  for (Eigen::Index e = 0; e < problem.hexes.rows(); ++e) {
    const Element element = make_element(corners_of(problem.rest, problem.hexes, e));
    for (int a = 0; a < 8; ++a) {
      for (int b = 0; b < 8; ++b) {
        const int row = map[static_cast<std::size_t>(problem.hexes(e, a))],
                  column = map[static_cast<std::size_t>(problem.hexes(e, b))];
        if (row >= 0 && column >= 0)
          matrix(row, column) += problem.matrix_weight[static_cast<std::size_t>(e)] * element.laplacian(a, b);
      }
    }
  }
  return matrix;
}

// Positions as the core keeps them.
inline std::vector<double> strided(const Nodes& nodes) {
  std::vector<double> values(kStride * static_cast<std::size_t>(nodes.rows()), 0.0);
  for (Eigen::Index i = 0; i < nodes.rows(); ++i) {
    for (Eigen::Index axis = 0; axis < 3; ++axis)
      values[kStride * static_cast<std::size_t>(i) + static_cast<std::size_t>(axis)] = nodes(i, axis);
  }
  return values;
}

inline Task idle_task(const Problem& problem) {
  Task task;
  task.prescribed = task.load = task.before = Nodes::Zero(problem.rest.rows(), 3);
  return task;
}

}  // namespace softgrip::gdfe::testing
