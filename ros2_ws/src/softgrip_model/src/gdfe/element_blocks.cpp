// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/local_step.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace softgrip::gdfe {
namespace {

// Shares of an element's size and stiffness below which a deviation from a box is rounding.
constexpr double kRounding = 1e-12;

Eigen::Matrix<double, 8, 7> patterns() {
  Eigen::Matrix<double, 8, 7> all;
  for (int c = 0; c < 8; ++c) {
    const double x = kCornerSigns[c][0], y = kCornerSigns[c][1], z = kCornerSigns[c][2];
    all.row(c) << x, y, z, y * z, x * z, x * y, x * y * z;
  }
  return all;
}

bool is_box(const Element& element, const Eigen::Matrix<double, 7, 3>& gradient) {
  const Eigen::Matrix4d& s = element.hourglass_stiffness;
  const Eigen::Matrix4d beside = s - Eigen::Matrix4d(s.diagonal().asDiagonal());
  return element.hourglass_rest.cwiseAbs().maxCoeff() <= kRounding * std::cbrt(element.volume) &&
         gradient.bottomRows<4>().cwiseAbs().maxCoeff() <= kRounding * gradient.cwiseAbs().maxCoeff() &&
         beside.cwiseAbs().maxCoeff() <= kRounding * s.diagonal().maxCoeff();
}

}  // namespace

ElementBlocks::ElementBlocks(const std::vector<Element>& all, const Hexes& hexes, const std::vector<int>& materials,
                             const std::vector<double>& ratios, const std::vector<double>& place)
    : elements(all.size()), blocks((all.size() + kBlock - 1) / kBlock) {
  const Eigen::Matrix<double, 8, 7> pattern = patterns();
  std::vector<Eigen::Matrix<double, 7, 3>> gradients;
  std::vector<char> box;
  for (const Element& e : all) {
    gradients.emplace_back(pattern.transpose() * e.gradient / 8.0);
    box.push_back(is_box(e, gradients.back()) ? 1 : 0);
  }
  std::vector<std::int32_t> order(elements);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return place[static_cast<std::size_t>(a)] < place[static_cast<std::size_t>(b)];
  });
  const auto others = std::stable_partition(order.begin(), order.end(),
                                            [&](std::int32_t e) { return box[static_cast<std::size_t>(e)] != 0; });
  const auto boxes = static_cast<std::size_t>(others - order.begin());
  box_blocks = boxes == elements ? blocks : boxes / kBlock;
  const std::size_t slots = blocks * kBlock, other_blocks = blocks - box_blocks;
  element.resize(slots);
  corner.resize(8 * slots);
  linear.resize(9 * slots);
  box_stiffness.resize(4 * box_blocks * kBlock);
  bent.resize(12 * other_blocks * kBlock);
  hourglass_rest.resize(12 * other_blocks * kBlock);
  hourglass_stiffness.resize(10 * other_blocks * kBlock);
  volume.assign(slots, 0.0);
  material.resize(slots);
  lame_per_mu.resize(slots);
  omega.assign(slots, 1.0);
  last_strain.assign(slots, 0.0);
  strain.assign(slots, 0.0);
  for (std::size_t slot = 0; slot < slots; ++slot) {
    const auto e = static_cast<std::size_t>(order[std::min(slot, elements - 1)]);
    const std::size_t block = slot / kBlock, lane = slot % kBlock;
    const Element& from = all[e];
    const double weight = slot < elements ? 1.0 : 0.0;
    const auto put = [&](std::vector<double>& to, std::size_t of_block, std::size_t rows, std::size_t row,
                         double value) { to[(of_block * rows + row) * kBlock + lane] = value; };
    element[slot] = static_cast<std::int32_t>(e);
    for (int c = 0; c < 8; ++c) {
      corner[(block * 8 + static_cast<std::size_t>(c)) * kBlock + lane] = hexes(static_cast<Eigen::Index>(e), c);
    }
    for (int k = 0; k < 9; ++k) put(linear, block, 9, static_cast<std::size_t>(k), gradients[e](k / 3, k % 3));
    volume[slot] = weight * from.volume;
    material[slot] = materials[e];
    lame_per_mu[slot] = ratios.empty() ? 0.0 : ratios[static_cast<std::size_t>(materials[e])];
    const Eigen::Matrix4d& s = from.hourglass_stiffness;
    if (block < box_blocks) {
      for (int k = 0; k < 4; ++k) put(box_stiffness, block, 4, static_cast<std::size_t>(k), weight * s(k, k));
      continue;
    }
    const std::size_t other = block - box_blocks;
    std::size_t row = 0;
    for (int k = 0; k < 4; ++k) {
      for (int j = 0; j < 3; ++j) {
        const std::size_t place = 3 * static_cast<std::size_t>(k) + static_cast<std::size_t>(j);
        put(bent, other, 12, place, gradients[e](3 + k, j));
        put(hourglass_rest, other, 12, place, from.hourglass_rest(k, j));
      }
      for (int l = k; l < 4; ++l) put(hourglass_stiffness, other, 10, row++, weight * s(k, l));
    }
  }
}

std::array<std::pair<std::size_t, std::size_t>, 2> block_shares(const ElementBlocks& elements, std::size_t share,
                                                                std::size_t shares) {
  const std::size_t boxes = elements.box_blocks, others = elements.blocks - boxes;
  return {{{share * boxes / shares, (share + 1) * boxes / shares},
           {boxes + share * others / shares, boxes + (share + 1) * others / shares}}};
}

std::size_t ElementBlocks::bytes() const {
  const std::size_t constants = linear.size() + box_stiffness.size() + bent.size() + hourglass_rest.size() +
                                hourglass_stiffness.size() + volume.size() + material.size() + lame_per_mu.size() +
                                strain.size();
  return sizeof(double) * constants + sizeof(std::int32_t) * corner.size();
}

}  // namespace softgrip::gdfe
