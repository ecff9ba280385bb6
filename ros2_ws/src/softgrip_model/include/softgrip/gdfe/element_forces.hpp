// SPDX-License-Identifier: Apache-2.0
// The elements' forces of a problem, without a solver: nothing is inverted, and no node need be held.
#pragma once

#include <memory>
#include <vector>

#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

// What the local step needs of every element.
std::vector<Element> make_elements(const Problem& problem, const Settings& settings);

class ElementForces {
 public:
  ElementForces(const Problem& problem, const Settings& settings);

  // Corner forces of all elements at a displacement, (n, 3); by the thesis law as in the first increment.
  Nodes at(const Nodes& displacement);

 private:
  const Nodes rest_;
  const Law law_;
  const VolumeShape shape_;
  const SecantTables tables_;
  ElementBlocks blocks_;
  std::unique_ptr<OgdenElements> ogden_;  // of the rigorous law
  std::size_t elements_;
};

}  // namespace softgrip::gdfe
