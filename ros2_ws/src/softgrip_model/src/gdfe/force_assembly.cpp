// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/force_assembly.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace softgrip::gdfe {
namespace {

// Where the inverse's order has the nodes of an element, on average: threads that share elements and unknowns in that
// order have most of what they read from their own cache.
std::vector<double> elimination_places(const Hexes& hexes, const DofMap& dofs) {
  std::vector<double> places(static_cast<std::size_t>(hexes.rows()), 0.0);
  for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
    double sum = 0.0, count = 0.0;
    for (int c = 0; c < 8; ++c) {
      const std::int32_t dof = dofs[static_cast<std::size_t>(hexes(e, c))];
      if (dof >= 0) sum += dof, count += 1.0;
    }
    if (count > 0.0) places[static_cast<std::size_t>(e)] = sum / count;
  }
  return places;
}

}  // namespace

ForceAssembly::ForceAssembly(const Problem& problem, const std::vector<Element>& elements, const Unknowns& unknowns,
                             CableSystem& cables, const Settings& settings)
    : rest_(problem.rest),
      unknowns_(unknowns),
      cables_(cables),
      surroundings_(problem.surroundings),
      law_(settings.law),
      shape_(settings.shape),
      nodes_(static_cast<std::size_t>(rest_.rows())),
      threads_(static_cast<std::size_t>(settings.threads)),
      tables_(problem.tables),
      blocks_(elements, problem.hexes, problem.materials, tables_.lame_per_mu,
              elimination_places(problem.hexes, unknowns.axes[0].dof)) {
  for (std::size_t e = 0; e < elements.size(); ++e)
    weight_scale_ += problem.matrix_weight[e] * std::cbrt(elements[e].volume);
  if (law_ == Law::Rigorous) {
    ogden_ = std::make_unique<OgdenElements>(rest_, problem.hexes, problem.materials, problem.ogden);
    ogden_strain_.resize(elements.size());
  }
  position_.resize(kStride * nodes_);
  force_.resize(kStride * nodes_);
  share_nodes(problem.hexes);
}

// The nodes that every thread's elements reach: the rest of its forces is never touched. The first one has loads too,
// anywhere.
void ForceAssembly::share_nodes(const Hexes& hexes) {
  shares_.resize(kStride * nodes_ * (threads_ - 1));
  free_squared_.assign(threads_, 0.0);
  force_shares_.push_back({force_.data(), 0, nodes_});
  for (std::size_t t = 1; t < threads_; ++t) {
    std::size_t first = nodes_, last = 0;
    const auto reach = [&](std::int32_t node) {
      first = std::min(first, static_cast<std::size_t>(node));
      last = std::max(last, static_cast<std::size_t>(node) + 1);
    };
    if (ogden_) {
      for (std::size_t e = begin_of(t, blocks_.elements); e < begin_of(t + 1, blocks_.elements); ++e) {
        for (int c = 0; c < 8; ++c) reach(hexes(static_cast<Eigen::Index>(e), c));
      }
    } else {
      for (const auto& [from, to] : block_shares(blocks_, t, threads_)) {
        std::for_each(blocks_.corner.data() + from * 8 * kBlock, blocks_.corner.data() + to * 8 * kBlock, reach);
      }
    }
    force_shares_.push_back({shares_.data() + (t - 1) * kStride * nodes_, std::min(first, last), last});
  }
}

void ForceAssembly::set_task(const Task& task) {
  base_.assign(kStride * nodes_, 0.0);
  dead_load_.assign(kStride * nodes_, 0.0);
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto row = static_cast<Eigen::Index>(i), column = static_cast<Eigen::Index>(axis);
      const bool is_prescribed = unknowns_.axes[axis].dof[i] < 0;
      base_[kStride * i + axis] = rest_(row, column) + (is_prescribed ? task.prescribed(row, column) : 0.0);
      dead_load_[kStride * i + axis] = task.load(row, column);
    }
  }
  position_ = base_;
  dead_load_squared_ = task.load.squaredNorm();
}

// position = base + x, of one share of the unknowns.
void ForceAssembly::scatter_state(const std::vector<double>& x, std::size_t share) {
  if (unknowns_.has_shared_dof_map) {
    const AxisUnknowns& a = unknowns_.axes[0];
    expand_rows(a.nodes.data(), {x.data(), x.data() + a.size, x.data() + 2 * a.size}, begin_of(share, a.size),
                begin_of(share + 1, a.size), base_.data(), position_.data());
    return;
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t* dof = unknowns_.axes[axis].dof.data();
    const double *base = base_.data() + axis, *displacement = x.data() + unknowns_.axes[axis].offset;
    double* position = position_.data() + axis;
    for (std::size_t i = begin_of(share, nodes_); i < begin_of(share + 1, nodes_); ++i) {
      position[kStride * i] = base[kStride * i] + (dof[i] >= 0 ? displacement[dof[i]] : 0.0);
    }
  }
}

// residual = dead load - force, of one share of the unknowns, and its square.
void ForceAssembly::gather_residual(std::vector<double>& residual, std::size_t share) {
  if (unknowns_.has_shared_dof_map) {
    const AxisUnknowns& a = unknowns_.axes[0];
    free_squared_[share] =
        gather_rows(a.nodes.data(), {residual.data(), residual.data() + a.size, residual.data() + 2 * a.size},
                    begin_of(share, a.size), begin_of(share + 1, a.size), dead_load_.data(), force_shares_);
    return;
  }
  double square = 0.0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const AxisUnknowns& a = unknowns_.axes[axis];
    double* of_axis = residual.data() + a.offset;
    for (std::size_t u = begin_of(share, a.size); u < begin_of(share + 1, a.size); ++u) {
      double sum = 0.0;
      for (std::int32_t k = a.first_node[u]; k < a.first_node[u + 1]; ++k) {
        const auto node = static_cast<std::size_t>(a.nodes[k]);
        sum += dead_load_[kStride * node + axis] - total_force_at(node, axis);
      }
      of_axis[u] = sum;
      square += sum * sum;
    }
  }
  free_squared_[share] = square;
}

void ForceAssembly::subtract_followers(const Task& task) {
  follower_squared_ = 0.0;
  if (surroundings_.pressed.empty() && surroundings_.followers.empty()) return;
  follower_.assign(kStride * nodes_, 0.0);
  for (std::size_t k = 0; k < surroundings_.pressed.size(); ++k) {
    add_pressure(surroundings_.pressed[k], task.pressures[k], position_.data(), follower_.data());
  }
  for (std::size_t k = 0; k < surroundings_.followers.size(); ++k) {
    add_follower_force(surroundings_.followers[k], task.follower_forces[k], rest_, position_.data(), follower_.data());
  }
  for (std::size_t i = 0; i < follower_.size(); ++i) {
    force_[i] -= follower_[i];
    follower_squared_ += follower_[i] * follower_[i];
  }
}

void ForceAssembly::add_element_forces(std::size_t share) {
  double* force = force_shares_[share].force;
  if (ogden_) {
    ogden_->add_forces(position_.data(), force, ogden_strain_.data(), begin_of(share, blocks_.elements),
                       begin_of(share + 1, blocks_.elements));
  } else {
    local_step(blocks_, tables_, law_, shape_, position_.data(), force, share, threads_);
  }
}

// Forces at the positions that place(share) leaves, less those of loads(); gather(share) may read them all. Every
// thread has its share; loads() is the first one's.
template <class Place, class Loads, class Gather>
void ForceAssembly::assemble(const Place& place, const Loads& loads, const Gather& gather) {
  const std::size_t values = kStride * nodes_;
#pragma omp parallel num_threads(static_cast<int>(threads_)) if (threads_ > 1)
  {
#pragma omp for schedule(static, 1)
    for (std::size_t t = 0; t < threads_; ++t) {
      place(t);
      std::fill(force_.data() + begin_of(t, values), force_.data() + begin_of(t + 1, values), 0.0);
    }
#pragma omp for schedule(static, 1)
    for (std::size_t t = 0; t < threads_; ++t) {
      const ForceShare& share = force_shares_[t];
      if (t > 0) std::fill(share.force + kStride * share.first, share.force + kStride * share.last, 0.0);
      if (t == 0) loads();
      add_element_forces(t);
    }
#pragma omp for schedule(static, 1) nowait
    for (std::size_t t = 0; t < threads_; ++t) gather(t);
  }
}

void ForceAssembly::compute_residual(const Task& task, const std::vector<double>& x, std::vector<double>& residual) {
  assemble([&](std::size_t share) { scatter_state(x, share); },
           [&] {
             cables_.subtract_forces(task, x, position_.data(), force_.data());
             subtract_followers(task);
           },
           [&](std::size_t share) { gather_residual(residual, share); });
  std::fill(residual.begin() + static_cast<std::ptrdiff_t>(unknowns_.count), residual.end(), 0.0);
}

void ForceAssembly::compute_element_residual(const std::vector<double>& position, std::vector<double>& residual) {
  residual.resize(unknowns_.count);
  const std::size_t values = kStride * nodes_;
  const auto place = [&](std::size_t share) {
    const auto first = static_cast<std::ptrdiff_t>(begin_of(share, values));
    const auto last = static_cast<std::ptrdiff_t>(begin_of(share + 1, values));
    std::copy(position.begin() + first, position.begin() + last, position_.begin() + first);
  };
  assemble(place, [] {}, [&](std::size_t share) { gather_residual(residual, share); });
}

double ForceAssembly::out_of_balance() const {
  return std::sqrt(std::accumulate(free_squared_.begin(), free_squared_.end(), 0.0));
}

double ForceAssembly::load_scale(const Task& task) const {
  double held = 0.0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (const std::int32_t i : unknowns_.axes[axis].held) {
      const auto node = static_cast<std::size_t>(i);
      const double reaction = total_force_at(node, axis) - dead_load_[kStride * node + axis];
      held += reaction * reaction;
    }
  }
  const double loads = cables_.add_force_squares(follower_squared_ + dead_load_squared_);
  // an unloaded mesh at rest is in balance
  const double floor = std::max(task.force_floor, 1e-12 * weight_scale_);
  return std::max({std::sqrt(held), std::sqrt(loads), floor});
}

void ForceAssembly::report(const Task& task, Outcome& outcome) const {
  outcome.displacement = Nodes::Zero(static_cast<Eigen::Index>(nodes_), 3);
  outcome.reaction = Nodes::Zero(static_cast<Eigen::Index>(nodes_), 3);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (std::size_t i = 0; i < nodes_; ++i) {
      const auto row = static_cast<Eigen::Index>(i), column = static_cast<Eigen::Index>(axis);
      outcome.displacement(row, column) = position_[kStride * i + axis] - rest_(row, column);
      if (unknowns_.axes[axis].dof[i] < 0)
        outcome.reaction(row, column) = total_force_at(i, axis) - task.load(row, column);
    }
  }
  outcome.strain = strain();
}

void ForceAssembly::place_nodes(const Nodes& displacement) {
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto row = static_cast<Eigen::Index>(i), column = static_cast<Eigen::Index>(axis);
      position_[kStride * i + axis] = rest_(row, column) + displacement(row, column);
    }
  }
}

Nodes ForceAssembly::internal_force(const Nodes& displacement) {
  place_nodes(displacement);
  const auto nothing = [](std::size_t) {};
  assemble(nothing, [] {}, nothing);
  Nodes force(static_cast<Eigen::Index>(nodes_), 3);
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      force(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(axis)) = total_force_at(i, axis);
    }
  }
  return force;
}

double ForceAssembly::energy(const Nodes& displacement) {
  if (!ogden_) throw std::logic_error("only the rigorous law has an energy");
  place_nodes(displacement);
  return ogden_->energy(position_.data());
}

std::vector<double> ForceAssembly::strain() const {
  if (ogden_) return ogden_strain_;
  std::vector<double> strain(blocks_.elements);
  for (std::size_t slot = 0; slot < blocks_.elements; ++slot) {
    strain[static_cast<std::size_t>(blocks_.element[slot])] = blocks_.strain[slot];
  }
  return strain;
}

void ForceAssembly::set_thesis_state(const std::vector<double>& omega, const std::vector<double>& last_strain) {
  for (std::size_t slot = 0; slot < blocks_.element.size(); ++slot) {
    const auto e = static_cast<std::size_t>(blocks_.element[slot]);
    blocks_.omega[slot] = omega.at(e);
    blocks_.last_strain[slot] = last_strain.at(e);
  }
}

}  // namespace softgrip::gdfe
