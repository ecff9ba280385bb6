// SPDX-License-Identifier: Apache-2.0
// Loads that follow the body: pressure on faces, and forces that turn with a patch of nodes.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

// Outer faces, corners ordered so that the right-hand rule points out of the body.
using PressedSurface = std::vector<std::array<std::int32_t, 4>>;

// Nodes that carry a force in shares (sum 1) and whose mean rotation since rest turns it.
struct FollowerPatch {
  std::vector<std::int32_t> nodes;
  std::vector<double> shares;
};

// Adds -p n dA of every face, integrated exactly over the bilinear patch. position, load: [node][kStride].
void add_pressure(const PressedSurface& surface, double pressure, const double* position, double* load);

// Adds R force; R = rotation nearest to sum_i share_i (x_i - x)(X_i - X)^T.
void add_follower_force(const FollowerPatch& patch, const Eigen::Vector3d& force, const Nodes& rest,
                        const double* position, double* load);

}  // namespace softgrip::gdfe
