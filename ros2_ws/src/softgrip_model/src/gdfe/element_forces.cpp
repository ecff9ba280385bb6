// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/element_forces.hpp"

namespace softgrip::gdfe {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, static_cast<int>(kStride), Eigen::RowMajor>;

}  // namespace

std::vector<Element> make_elements(const Problem& problem, const Settings& settings) {
  std::vector<Element> elements(static_cast<std::size_t>(problem.hexes.rows()));
#pragma omp parallel for num_threads(settings.threads) if (settings.threads > 1)
  for (Eigen::Index e = 0; e < problem.hexes.rows(); ++e) {
    elements[static_cast<std::size_t>(e)] = make_element(corners_of(problem.rest, problem.hexes, e), settings.metric);
  }
  return elements;
}

ElementForces::ElementForces(const Problem& problem, const Settings& settings)
    : rest_(problem.rest),
      law_(settings.law),
      shape_(settings.shape),
      tables_(problem.tables),
      elements_(static_cast<std::size_t>(problem.hexes.rows())) {
  if (law_ == Law::Rigorous) {
    ogden_ = std::make_unique<OgdenElements>(rest_, problem.hexes, problem.materials, problem.ogden);
  } else {
    const std::vector<double> as_they_come(elements_, 0.0);
    blocks_ = ElementBlocks(make_elements(problem, settings), problem.hexes, problem.materials, tables_.lame_per_mu,
                            as_they_come);
  }
}

Nodes ElementForces::at(const Nodes& displacement) {
  Rows position = Rows::Zero(rest_.rows(), static_cast<Eigen::Index>(kStride)), force = position;
  position.leftCols<3>() = rest_ + displacement;
  if (ogden_) {
    std::vector<double> strain(elements_);
    ogden_->add_forces(position.data(), force.data(), strain.data(), 0, elements_);
  } else {
    local_step(blocks_, tables_, law_, shape_, position.data(), force.data(), 0, 1);
  }
  return force.leftCols<3>();
}

}  // namespace softgrip::gdfe
