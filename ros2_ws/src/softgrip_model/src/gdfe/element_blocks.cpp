// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/local_step.hpp"

#include <algorithm>

namespace softgrip::gdfe {

ElementBlocks::ElementBlocks(const std::vector<Element>& all, const Hexes& hexes, const std::vector<int>& materials)
    : elements(all.size()), blocks((all.size() + kBlock - 1) / kBlock) {
  corner.resize(blocks * 8 * kBlock);
  gradient.resize(blocks * 24 * kBlock);
  hourglass_rest.resize(blocks * 12 * kBlock);
  hourglass_stiffness.resize(blocks * 10 * kBlock);
  volume.assign(blocks * kBlock, 0.0);
  material.resize(blocks * kBlock);
  omega.assign(blocks * kBlock, 1.0);
  last_strain.assign(blocks * kBlock, 0.0);
  strain.assign(blocks * kBlock, 0.0);
  for (std::size_t slot = 0; slot < blocks * kBlock; ++slot) {
    const std::size_t e = std::min(slot, elements - 1), block = slot / kBlock, lane = slot % kBlock;
    const Element& element = all[e];
    for (int a = 0; a < 8; ++a) {
      corner[(block * 8 + a) * kBlock + lane] = hexes(static_cast<Eigen::Index>(e), a);
      for (int j = 0; j < 3; ++j) gradient[(block * 24 + a * 3 + j) * kBlock + lane] = element.gradient(a, j);
    }
    int row = 0;
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 3; ++j) hourglass_rest[(block * 12 + i * 3 + j) * kBlock + lane] = element.hourglass_rest(i, j);
      for (int j = i; j < 4; ++j) {
        hourglass_stiffness[(block * 10 + row++) * kBlock + lane] = slot < elements ? element.hourglass_stiffness(i, j) : 0.0;
      }
    }
    if (slot < elements) volume[slot] = element.volume;
    material[slot] = materials[e];
  }
}

}  // namespace softgrip::gdfe
