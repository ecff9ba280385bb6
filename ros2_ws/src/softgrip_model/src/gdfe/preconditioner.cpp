// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/preconditioner.hpp"

#include <algorithm>
#include <exception>

#include "softgrip/gdfe/assembly.hpp"
#include "softgrip/gdfe/multigrid.hpp"

namespace softgrip::gdfe {
namespace {

// Mean place at rest of the nodes of every unknown.
Eigen::MatrixX3d places_of(const DofMap& map, const Nodes& rest, Eigen::Index size) {
  Eigen::MatrixX3d places = Eigen::MatrixX3d::Zero(size, 3);
  Eigen::VectorXd members = Eigen::VectorXd::Zero(size);
  for (std::size_t i = 0; i < map.size(); ++i) {
    if (map[i] < 0) continue;
    places.row(map[i]) += rest.row(static_cast<Eigen::Index>(i));
    members(map[i]) += 1.0;
  }
  return members.cwiseInverse().asDiagonal() * places;
}

std::shared_ptr<const ConstantInverse> make_inverse(const Problem& problem, const std::vector<Element>& elements,
                                                    const DofMap& map, const Settings& settings) {
  const int size = map.empty() ? 0 : std::max(0, *std::max_element(map.begin(), map.end()) + 1);
  const SparseMatrix matrix = assembled(elements, problem.hexes, problem.matrix_weight, map, size);
  const bool is_large = settings.method == Method::Automatic && matrix.rows() > kMultigridAbove;
  if (settings.method == Method::Multigrid || is_large) {
    return std::make_shared<Multigrid>(matrix, places_of(map, problem.rest, matrix.rows()),
                                       settings.single_precision_factor, settings.threads);
  }
  return std::make_shared<Factor>(matrix, settings.single_precision_factor, settings.ordering, settings.threads);
}

}  // namespace

Preconditioner::Preconditioner(const Problem& problem, const std::vector<Element>& elements, const Settings& settings) {
  const std::array<DofMap, 3>& maps = problem.maps;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    shared_dof_map_[axis] = static_cast<std::size_t>(std::find(maps.begin(), maps.end(), maps[axis]) - maps.begin());
  }
  const bool differ = shared_dof_map_ != decltype(shared_dof_map_){};
  std::exception_ptr failure;  // must not leave the threads' region
#pragma omp parallel for schedule(dynamic) num_threads(settings.threads) if (settings.threads > 1 && differ)
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (shared_dof_map_[axis] != axis) continue;
    try {
      inverse_[axis] = make_inverse(problem, elements, maps[axis], settings);
    } catch (...) {
#pragma omp critical
      failure = std::current_exception();
    }
  }
  if (failure) std::rethrow_exception(failure);
  std::array<const std::vector<int>*, 3> position{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    inverse_[axis] = inverse_[shared_dof_map_[axis]];
    position[axis] = &inverse_[axis]->position();
  }
  unknowns_ = Unknowns(maps, position);
}

// Axes with the same matrix go through its inverse together.
void Preconditioner::apply(std::vector<double>& residual) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (shared_dof_map_[axis] != axis) continue;
    std::array<double*, 3> columns{};
    int count = 0;
    for (std::size_t other = axis; other < 3; ++other) {
      if (shared_dof_map_[other] != axis) continue;
      columns[static_cast<std::size_t>(count++)] = residual.data() + unknowns_.axes[other].offset;
    }
    inverse_[axis]->apply(columns.data(), count, scratch_);
  }
}

}  // namespace softgrip::gdfe
