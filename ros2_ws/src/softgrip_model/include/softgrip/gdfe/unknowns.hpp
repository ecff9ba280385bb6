// SPDX-License-Identifier: Apache-2.0
// Where the unknowns are in the state x = [u_x, u_y, u_z, anchor tensions of the cables].
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace softgrip::gdfe {

// For one axis: node -> unknown (nodes that share one move alike) or -1 = prescribed.
using DofMap = std::vector<std::int32_t>;

struct AxisUnknowns {
  DofMap dof;                                   // in the order in which the constant matrix is inverted
  std::size_t size = 0, offset = 0;             // in the state
  std::vector<std::int32_t> first_node, nodes;  // unknown -> its nodes, in compressed rows
  std::vector<std::int32_t> held;               // nodes without an unknown
};

struct Unknowns {
  std::array<AxisUnknowns, 3> axes;
  std::size_t count = 0;            // of the mesh: the cables' tensions follow them
  bool has_shared_dof_map = false;  // an unknown is one node, the same on every axis

  Unknowns() = default;

  // position[axis][unknown of the map] -> its place.
  Unknowns(const std::array<DofMap, 3>& maps, const std::array<const std::vector<int>*, 3>& position);
};

// Where one of `shares` equal shares of `count` begins.
constexpr std::size_t share_begin(std::size_t share, std::size_t shares, std::size_t count) {
  return share * count / shares;
}

}  // namespace softgrip::gdfe
