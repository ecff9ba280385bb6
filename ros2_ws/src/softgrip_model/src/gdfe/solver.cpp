// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/solver.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace softgrip::gdfe {
namespace {

// How often one step is halved when it leaves what the law has a value for.
constexpr int kHalvings = 12;

Eigen::Map<const Eigen::VectorXd> first(const std::vector<double>& vector, std::size_t count) {
  return {vector.data(), static_cast<Eigen::Index>(count)};
}

}  // namespace

void Solver::begin_contact(const Task& task) {
  if (!contact_.empty()) contact_.begin(task.motions, task.motions_before, rest_ + task.before);
}

// Loads that follow the body, at the positions just expanded.
void Solver::add_followers(const Task& task) {
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

// What the task gives on every node, as the iteration reads it. Held nodes are placed for good.
void Solver::lay_out(const Task& task) {
  base_.assign(kStride * nodes_, 0.0);
  dead_load_.assign(kStride * nodes_, 0.0);
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto row = static_cast<Eigen::Index>(i), column = static_cast<Eigen::Index>(axis);
      base_[kStride * i + axis] = rest_(row, column) + (axes_[axis].dof[i] < 0 ? task.prescribed(row, column) : 0.0);
      dead_load_[kStride * i + axis] = task.load(row, column);
    }
  }
  position_ = base_;
  dead_load_squared_ = task.load.squaredNorm();
}

void Solver::expand(const std::vector<double>& state, std::size_t share) {
  if (alike_) {
    const std::vector<std::int32_t>& nodes = axes_[0].nodes;
    const std::size_t size = nodes.size();
    expand_rows(nodes.data(), {state.data(), state.data() + size, state.data() + 2 * size}, begin_of(share, size),
                begin_of(share + 1, size), base_.data(), position_.data());
    return;
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t* dof = axes_[axis].dof.data();
    const double *base = base_.data() + axis, *displacement = state.data() + axes_[axis].offset;
    double* position = position_.data() + axis;
    for (std::size_t i = begin_of(share, nodes_); i < begin_of(share + 1, nodes_); ++i) {
      position[kStride * i] = base[kStride * i] + (dof[i] >= 0 ? displacement[dof[i]] : 0.0);
    }
  }
}

// -g of a share of the unknowns, and its square.
void Solver::gather(std::vector<double>& residual, std::size_t share) {
  if (alike_) {
    const std::vector<std::int32_t>& nodes = axes_[0].nodes;
    const std::size_t size = nodes.size();
    free_squared_[share] = gather_rows(nodes.data(), {residual.data(), residual.data() + size, residual.data() + 2 * size},
                                       begin_of(share, size), begin_of(share + 1, size), dead_load_.data(), force_shares_);
    return;
  }
  double square = 0.0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const Axis& a = axes_[axis];
    double* out = residual.data() + a.offset;
    const auto size = static_cast<std::size_t>(a.inverse->size());
    for (std::size_t u = begin_of(share, size); u < begin_of(share + 1, size); ++u) {
      double sum = 0.0;
      for (std::int32_t k = a.first_node[u]; k < a.first_node[u + 1]; ++k) {
        const auto node = static_cast<std::size_t>(a.nodes[k]);
        sum += dead_load_[kStride * node + axis] - total_force(force_shares_, node, kStride * node + axis);
      }
      out[u] = sum;
      square += sum * sum;
    }
  }
  free_squared_[share] = square;
}

// |g on free unknowns| / |reactions|; `residual`: -g.
double Solver::out_of_balance(const Task& task, std::vector<double>& residual) {
  double held = 0.0, loads = follower_squared_ + dead_load_squared_;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (const std::int32_t i : axes_[axis].held) {
      const auto node = static_cast<std::size_t>(i);
      const double reaction = total_force(force_shares_, node, kStride * node + axis) - dead_load_[kStride * node + axis];
      held += reaction * reaction;
    }
  }
  std::fill(residual.begin() + static_cast<std::ptrdiff_t>(unknowns_), residual.end(), 0.0);
  for (const CableWork& work : cable_work_) {
    for (const Eigen::Vector3d& force : work.state.force) loads += force.squaredNorm();
  }
  const double free = std::accumulate(free_squared_.begin(), free_squared_.end(), 0.0);
  // an unloaded mesh at rest is in balance
  const double floor = std::max(task.force_floor, 1e-12 * weight_scale_);
  balance_scale_ = std::max({std::sqrt(held), std::sqrt(loads), floor});
  return std::sqrt(free) / balance_scale_;
}

void Solver::precondition(std::vector<double>& residual) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::array<double*, 3> columns{};
    int count = 0;
    bool solved = false;
    for (std::size_t other = 0; other < 3; ++other) {
      if (axes_[other].inverse != axes_[axis].inverse) continue;
      solved = solved || other < axis;
      columns[static_cast<std::size_t>(count++)] = residual.data() + axes_[other].offset;
    }
    if (!solved) axes_[axis].inverse->apply(columns.data(), count, scratch_);
  }
}

// Forces at the positions that place(share) leaves, less those of loads(), in shares; take(share) may read them all. Every thread
// has its share; loads() is the first one's.
template <class Place, class Loads, class Take>
void Solver::sum_forces(const Place& place, const Loads& loads, const Take& take) {
  const auto threads = static_cast<std::size_t>(settings_.threads);
  const std::size_t values = kStride * nodes_;
#pragma omp parallel num_threads(settings_.threads) if (threads > 1)
  {
#pragma omp for schedule(static, 1)
    for (std::size_t t = 0; t < threads; ++t) {
      place(t);
      std::fill(force_.data() + begin_of(t, values), force_.data() + begin_of(t + 1, values), 0.0);
    }
#pragma omp for schedule(static, 1)
    for (std::size_t t = 0; t < threads; ++t) {
      const ForceShare& share = force_shares_[t];
      if (t > 0) std::fill(share.force + kStride * share.first, share.force + kStride * share.last, 0.0);
      if (t == 0) loads();
      if (ogden_) {
        ogden_->add_forces(position_.data(), share.force, ogden_strain_.data(), begin_of(t, blocks_.elements), begin_of(t + 1, blocks_.elements));
      } else {
        local_step(blocks_, tables_, settings_.law, settings_.shape, position_.data(), share.force, t, threads);
      }
    }
#pragma omp for schedule(static, 1) nowait
    for (std::size_t t = 0; t < threads; ++t) take(t);
  }
}

Outcome Solver::solve(const Task& task, const Nodes& start, const std::vector<double>& start_tension) {
  std::vector<double> state(unknowns_ + cables_.size(), 0.0), step(state.size()), residual(state.size()), unbalanced;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const Axis& a = axes_[axis];
    for (std::size_t i = 0; i < nodes_; ++i) {
      if (a.dof[i] >= 0) {
        state[a.offset + static_cast<std::size_t>(a.dof[i])] = start(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(axis));
      }
    }
  }
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    // the step of a tension counts as much as the motion of the mesh that it causes
    double square = 0.0;
    for (const Axis& a : axes_) {
      for (std::size_t p = 0; p < cables_[c].points.size(); ++p) {
        square += a.point_columns->col(static_cast<Eigen::Index>(first_column_[c] + p)).squaredNorm();
      }
    }
    cable_work_[c].tension_scale = square > 0.0 ? std::sqrt(square) : 1.0;
    state[unknowns_ + c] = start_tension[c] * cable_work_[c].tension_scale;
  }

  lay_out(task);
  begin_contact(task);
  Anderson& accelerate = *accelerate_;
  accelerate.forget();
  by_sections_ = false;
  measure_at_ = settings_.sections_after;
  Outcome outcome;
  int halvings = 0;
  for (int iteration = 0;; ++iteration) {
    sum_forces([&](std::size_t share) { expand(state, share); },
               [&] {
                 pull_cables(task, state);
                 add_followers(task);
               },
               [&](std::size_t share) { gather(residual, share); });
    outcome.residual = out_of_balance(task, residual);
    outcome.length_error = 0.0;
    if (!contact_.empty() && std::isfinite(outcome.residual)) {
      contact_.add_last_forces(residual);
      unbalanced = residual;
      precondition(residual);
      drive_lengths(task, state, residual);
      contact_.resolve(position_.data(), unbalanced, residual);
      const double square = first(unbalanced, unknowns_).squaredNorm();
      outcome.residual = std::sqrt(square) / std::max(balance_scale_, std::sqrt(contact_.force_squared()));
      outcome.length_error = contact_.gap_error();
    }
    outcome.history.push_back(outcome.residual);
    outcome.iterations = iteration;
    bool sound = std::isfinite(outcome.residual);
    for (std::size_t c = 0; c < cables_.size(); ++c) {
      const CableState& cable = cable_work_[c].state;
      sound = sound && cable.sound;
      if (!task.drives[c].by_length) continue;
      const double gap = cable.length + cable.entry_length - (cable_work_[c].rest_length - task.drives[c].target);
      const bool slack = state[unknowns_ + c] <= 0.0 && gap < 0.0;
      if (!slack) outcome.length_error = std::max(outcome.length_error, std::abs(gap));
    }
    outcome.converged = sound && outcome.residual <= task.tolerance && outcome.length_error <= task.length_tolerance;
    if (outcome.converged || iteration >= task.max_iterations) break;
    if (!sound) {  // an element turned inside out, or the cable wrapped too far: half the way back
      if (iteration == 0 || ++halvings > kHalvings) break;
      for (std::size_t i = 0; i < state.size(); ++i) state[i] -= step[i] *= 0.5;
      accelerate.forget();
      continue;
    }
    halvings = 0;

    if (contact_.empty()) answer(task, state, iteration, residual);
    const bool limited = settings_.step_limit > 0.0;
    accelerate.advance(state, residual, step, !limited);
    if (limited) {
      const double largest = first(step, unknowns_).cwiseAbs().maxCoeff();
      if (largest > settings_.step_limit) {
        for (double& value : step) value *= settings_.step_limit / largest;
      }
      Eigen::Map<Eigen::VectorXd>(state.data(), static_cast<Eigen::Index>(state.size())) += first(step, step.size());
    }
    for (std::size_t c = 0; c < cables_.size(); ++c) {
      double& tension = state[unknowns_ + c];
      if (tension < 0.0) step[unknowns_ + c] -= tension, tension = 0.0;
    }
  }
  Outcome full = report(task, state);
  full.converged = outcome.converged;
  full.iterations = outcome.iterations;
  full.residual = outcome.residual;
  full.length_error = outcome.length_error;
  full.history = std::move(outcome.history);
  return full;
}

Outcome Solver::report(const Task& task, const std::vector<double>& state) const {
  Outcome outcome;
  outcome.displacement = Nodes::Zero(static_cast<Eigen::Index>(nodes_), 3);
  outcome.reaction = Nodes::Zero(static_cast<Eigen::Index>(nodes_), 3);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (std::size_t i = 0; i < nodes_; ++i) {
      const auto row = static_cast<Eigen::Index>(i), column = static_cast<Eigen::Index>(axis);
      outcome.displacement(row, column) = position_[kStride * i + axis] - rest_(row, column);
      if (axes_[axis].dof[i] < 0) outcome.reaction(row, column) = total_force(force_shares_, i, kStride * i + axis) - task.load(row, column);
    }
  }
  outcome.touches = contact_.touches();
  for (const Touch& touch : outcome.touches) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto column = static_cast<Eigen::Index>(axis);
      if (axes_[axis].dof[static_cast<std::size_t>(touch.node)] < 0) outcome.reaction(touch.node, column) -= touch.force[column];
    }
  }
  outcome.strain = strain();
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    const CableWork& work = cable_work_[c];
    outcome.anchor_tension.push_back(task.drives[c].by_length ? state[unknowns_ + c] / work.tension_scale : work.state.tension.back());
    outcome.tension.push_back(work.state.tension);
    outcome.shortening.push_back(work.rest_length - work.state.length - work.state.entry_length);
  }
  return outcome;
}

std::vector<double> Solver::strain() const {
  if (ogden_) return ogden_strain_;
  std::vector<double> strain(blocks_.elements);
  for (std::size_t slot = 0; slot < blocks_.elements; ++slot) strain[static_cast<std::size_t>(blocks_.element[slot])] = blocks_.strain[slot];
  return strain;
}

void Solver::set_thesis_state(const std::vector<double>& omega, const std::vector<double>& last_strain) {
  for (std::size_t slot = 0; slot < blocks_.element.size(); ++slot) {
    const auto e = static_cast<std::size_t>(blocks_.element[slot]);
    blocks_.omega[slot] = omega.at(e);
    blocks_.last_strain[slot] = last_strain.at(e);
  }
}

void Solver::place(const Nodes& displacement) {
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto column = static_cast<Eigen::Index>(axis);
      position_[kStride * i + axis] = rest_(static_cast<Eigen::Index>(i), column) + displacement(static_cast<Eigen::Index>(i), column);
    }
  }
}

double Solver::energy(const Nodes& displacement) {
  if (!ogden_) throw std::logic_error("only the rigorous law has an energy");
  place(displacement);
  return ogden_->energy(position_.data());
}

void Solver::forces_at(const std::vector<double>& position, std::vector<double>& force) {
  force.resize(unknowns_);
  const std::size_t values = kStride * nodes_;
  const auto place = [&](std::size_t share) {
    const auto first = static_cast<std::ptrdiff_t>(begin_of(share, values)), last = static_cast<std::ptrdiff_t>(begin_of(share + 1, values));
    std::copy(position.begin() + first, position.begin() + last, position_.begin() + first);
  };
  sum_forces(place, [] {}, [&](std::size_t share) { gather(force, share); });
}

Nodes Solver::internal_force(const Nodes& displacement) {
  place(displacement);
  const auto nothing = [](std::size_t) {};
  sum_forces(nothing, [] {}, nothing);
  Nodes force(static_cast<Eigen::Index>(nodes_), 3);
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      force(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(axis)) = total_force(force_shares_, i, kStride * i + axis);
    }
  }
  return force;
}

}  // namespace softgrip::gdfe
