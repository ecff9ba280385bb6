// SPDX-License-Identifier: Apache-2.0
// The local step of all elements: corner forces from corner positions, no SVD, eight elements abreast.
//
// With P = c1 (F - R) + volume part and the hourglass coefficient c_h, the corner forces are
//   f = V0 G P^T + c_h Gamma S Gamma^T V,
// Corners are taken as sums and differences: three linear patterns L (8x3) and four of the hourglass H (8x4), so that
// F = (L^T V)^T A + (H^T V)^T B with A = L^T G / 8, B = H^T G / 8. Of a box B and H^T X vanish and S is diagonal.
//   proj  volume shape:  P = a (F - R) - b D,         c_h = a        (D = F* - F, det F* = 1, |D| least)
//   scale volume shape:  P = a (F - R) + b s F,       c_h = a + b s  (s = 1 - J^(-1/3))
// calibrated: a = 2 mu, b = 3 lame, mu = secant(eps_eq); thesis: a = w (1 - alpha), b = 1 - a.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "softgrip/gdfe/mesh.hpp"

namespace softgrip::gdfe {

enum class Law : std::uint8_t { Calibrated = 0, Thesis = 1, Rigorous = 2 };
enum class VolumeShape : std::uint8_t { Proj = 0, Scale = 1 };

inline constexpr std::size_t kBlock = 8;

// mu(eps_eq) of every material as cubic pieces of equal length; eps_eq with nu = 0.5 (Eq 5.5).
struct SecantTables {
  int cells = 0;                     // per material
  double end = 0.0;                  // eps_eq at the end of the last cell
  std::vector<double> coefficients;  // [material][cell][4]: mu = c0 + t (c1 + t (c2 + t c3)), t in 0..1 within the cell
  std::vector<double> lame_per_mu;   // 2 nu / (1 - 2 nu)
};

// Blocks of kBlock elements, boxes first; the last block is filled up with copies of its last element at zero weight.
struct ElementBlocks {
  std::size_t elements = 0, blocks = 0, box_blocks = 0;
  std::vector<std::int32_t> element;        // [block][lane] its number in the mesh
  std::vector<std::int32_t> corner;         // [block][8][lane] node index
  std::vector<double> linear;               // [block][9][lane] A
  std::vector<double> box_stiffness;        // [box block][4][lane] diagonal of S
  std::vector<double> bent;                 // [other block][12][lane] B
  std::vector<double> hourglass_rest;       // [other block][12][lane] H^T X
  std::vector<double> hourglass_stiffness;  // [other block][10][lane], upper triangle row by row
  std::vector<double> volume;               // [block][lane], zero in the filling
  std::vector<double> material;             // [block][lane] index, as a number
  std::vector<double> lame_per_mu;          // [block][lane] of the material
  std::vector<double> omega;                // [block][lane] thesis law: shape factor
  std::vector<double> last_strain;          // [block][lane] thesis law: eps_eq at the last converged increment
  std::vector<double> strain;               // out: eps_eq, nu = 0.5

  ElementBlocks() = default;
  // Elements are worked on by ascending `place`.
  ElementBlocks(const std::vector<Element>& all, const Hexes& hexes, const std::vector<int>& materials,
                const std::vector<double>& ratios, const std::vector<double>& place);

  // Bytes of what a step reads of the elements and writes of them.
  std::size_t bytes() const;
};

// Blocks of one of `shares` equal shares: of the boxes and of the others, from the first to beyond the last.
std::array<std::pair<std::size_t, std::size_t>, 2> block_shares(const ElementBlocks& elements, std::size_t share,
                                                                std::size_t shares);

// position, force: [node][kStride]; force is added to. One of `threads` equal shares of the elements.
void local_step(ElementBlocks& elements, const SecantTables& tables, Law law, VolumeShape shape, const double* position,
                double* force, std::size_t share, std::size_t shares);

}  // namespace softgrip::gdfe
