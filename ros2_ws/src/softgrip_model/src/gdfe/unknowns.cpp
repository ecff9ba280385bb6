// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/unknowns.hpp"

#include <algorithm>

namespace softgrip::gdfe {
namespace {

AxisUnknowns number_unknowns(const DofMap& map, const std::vector<int>& position, std::size_t offset) {
  AxisUnknowns axis;
  axis.size = position.size();
  axis.offset = offset;
  axis.dof.resize(map.size());
  axis.first_node.assign(axis.size + 1, 0);
  for (std::size_t i = 0; i < map.size(); ++i) {
    axis.dof[i] = map[i] < 0 ? -1 : position[static_cast<std::size_t>(map[i])];
    if (axis.dof[i] >= 0) ++axis.first_node[static_cast<std::size_t>(axis.dof[i]) + 1];
  }
  for (std::size_t u = 0; u < axis.size; ++u) axis.first_node[u + 1] += axis.first_node[u];
  std::vector<std::int32_t> next(axis.first_node.begin(), axis.first_node.end() - 1);
  axis.nodes.resize(static_cast<std::size_t>(axis.first_node.back()));
  for (std::size_t i = 0; i < map.size(); ++i) {
    const auto node = static_cast<std::int32_t>(i);
    if (axis.dof[i] >= 0) {
      axis.nodes[static_cast<std::size_t>(next[static_cast<std::size_t>(axis.dof[i])]++)] = node;
    } else {
      axis.held.push_back(node);
    }
  }
  return axis;
}

}  // namespace

Unknowns::Unknowns(const std::array<DofMap, 3>& maps, const std::array<const std::vector<int>*, 3>& position) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    axes[axis] = number_unknowns(maps[axis], *position[axis], count);
    count += axes[axis].size;
  }
  has_shared_dof_map = std::all_of(axes.begin(), axes.end(), [&](const AxisUnknowns& axis) {
    return axis.dof == axes[0].dof && axis.nodes.size() == axis.size;
  });
}

}  // namespace softgrip::gdfe
