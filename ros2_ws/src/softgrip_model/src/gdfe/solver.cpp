// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/solver.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "softgrip/gdfe/element_forces.hpp"

namespace softgrip::gdfe {
namespace {

// How often one step is halved when it leaves what the law has a value for.
constexpr int kMaxHalvings = 12;

// A vector of the iteration: the mesh's unknowns of every axis, then the cables' tensions.
std::vector<std::size_t> parts_of(const Unknowns& unknowns, std::size_t cables) {
  return {unknowns.axes[0].size, unknowns.axes[1].size, unknowns.axes[2].size, cables};
}

// What goes together. Sections are a second level of L^-1 on nodes that are free or held as a whole. Contact forces are
// found with the compliance of L^-1 alone: behind a step by the sections they would not hold the obstacles off.
void check_second_level(const Problem& problem, const Unknowns& unknowns) {
  if (unknowns.has_shared_dof_map && problem.surroundings.obstacles.empty()) return;
  throw std::invalid_argument(
      "sections_after: expected nodes that are free or held along all axes alike, none tied, and no obstacles; found "
      "others: "
      "leave it -1");
}

double largest_motion(const std::vector<double>& step, std::size_t count) {
  return Eigen::Map<const Eigen::VectorXd>(step.data(), static_cast<Eigen::Index>(count)).cwiseAbs().maxCoeff();
}

}  // namespace

Solver::Solver(const Problem& problem, const Settings& settings)
    : Solver(problem, settings, make_elements(problem, settings)) {}

Solver::Solver(const Problem& problem, const Settings& settings, const std::vector<Element>& elements)
    : settings_(settings),
      preconditioner_(problem, elements, settings),
      cables_(problem.cables, problem.rest, preconditioner_),
      forces_(problem, elements, preconditioner_.unknowns(), cables_, settings),
      anderson_(parts_of(preconditioner_.unknowns(), cables_.count()), settings.window, settings.threads) {
  const Unknowns& unknowns = preconditioner_.unknowns();
  if (settings.sections_after >= 0 && unknowns.count > 0) {
    check_second_level(problem, unknowns);
    sections_ = std::make_unique<SectionLevel>(problem, unknowns, forces_, cables_, settings.sections_after);
  }
  if (Tangent::is_fit_for(problem, settings, unknowns)) {
    tangent_ = std::make_unique<Tangent>(problem, settings, unknowns, forces_, cables_);
  }
  if (!problem.surroundings.obstacles.empty()) {
    contact_ = std::make_unique<Contact>(problem.surroundings.obstacles, problem.rest, preconditioner_);
  }
}

Outcome Solver::solve(const Task& task, const Nodes& start, const std::vector<double>& start_tension) {
  std::vector<double> x = start_solve(task, start, start_tension), z(x.size()), dx(x.size());
  Outcome outcome;
  int halvings = 0;
  for (int k = 0;; ++k) {
    forces_.compute_residual(task, x, z);  // z = -g(x)
    Balance balance = measure_balance(task, x);
    if (contact_ && std::isfinite(balance.residual)) resolve_contact(task, x, k, z, balance);
    outcome.history.push_back(balance.residual);
    outcome.iterations = k;
    outcome.residual = balance.residual;
    outcome.length_error = balance.length_error;
    outcome.converged = balance.is_converged(task);
    if (outcome.converged || k >= task.max_iterations) break;
    if (tangent_ && tangent_->has_overshot(balance.residual, balance.is_sound)) {
      back_track(x, dx, 1.0);
      continue;
    }
    if (!balance.is_sound) {
      if (k == 0 || ++halvings > kMaxHalvings) break;
      back_track(x, dx, 0.5);
      continue;
    }
    halvings = 0;
    if (tangent_ && tangent_->follow(k, balance.residual, task, x))
      anderson_.forget();                        // its history is of other steps
    if (!contact_) compute_step(task, x, k, z);  // z = L^-1 z; contact forces have been found with it
    accelerate(x, z, dx);                        // x += dx
  }
  if (tangent_ && outcome.converged) outcome.unstable_modes = tangent_->count_unstable_modes(task, x);
  report(task, x, outcome);
  return outcome;
}

// The state [displacements, anchor tensions] to start from.
std::vector<double> Solver::start_solve(const Task& task, const Nodes& start,
                                        const std::vector<double>& start_tension) {
  const Unknowns& unknowns = preconditioner_.unknowns();
  std::vector<double> x(unknowns.count + cables_.count(), 0.0);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const AxisUnknowns& a = unknowns.axes[axis];
    for (std::size_t i = 0; i < a.dof.size(); ++i) {
      if (a.dof[i] < 0) continue;
      x[a.offset + static_cast<std::size_t>(a.dof[i])] =
          start(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(axis));
    }
  }
  cables_.set_tensions(start_tension, x);
  forces_.set_task(task);
  if (contact_) contact_->set_task(task);
  if (sections_) sections_->restart();
  if (tangent_) tangent_->restart();
  anderson_.forget();
  return x;
}

Solver::Balance Solver::measure_balance(const Task& task, const std::vector<double>& x) const {
  Balance balance;
  balance.scale = forces_.load_scale(task);
  balance.residual = forces_.out_of_balance() / balance.scale;
  balance.length_error = cables_.length_error(task, x);
  balance.is_sound = std::isfinite(balance.residual) && cables_.are_sound();
  return balance;
}

// The step with contact forces in it: they are known with the step only, and the balance only with them. z: -g in, step
// out.
void Solver::resolve_contact(const Task& task, const std::vector<double>& x, int k, std::vector<double>& z,
                             Balance& balance) {
  contact_->add_last_forces(z);
  std::vector<double> residual = z;
  compute_step(task, x, k, z);
  contact_->resolve(forces_.position().data(), residual, z);
  const std::size_t count = preconditioner_.unknowns().count;
  const double square =
      Eigen::Map<const Eigen::VectorXd>(residual.data(), static_cast<Eigen::Index>(count)).squaredNorm();
  balance.scale = std::max(balance.scale, std::sqrt(contact_->force_squared()));
  balance.residual = std::sqrt(square) / balance.scale;
  balance.length_error = std::max(balance.length_error, contact_->gap_error());
  balance.is_sound = balance.is_sound && std::isfinite(balance.residual);
}

// z <- L^-1 z: by the sections where there are any, by the constant matrix, and by the cables' tensions; or by the
// tangent.
void Solver::compute_step(const Task& task, const std::vector<double>& x, int k, std::vector<double>& z) {
  if (tangent_ && tangent_->is_usable()) {
    tangent_->apply(z);
    return cables_.drive_lengths(task, x, z, [this](std::size_t cable, const Eigen::Matrix3Xd& force) {
      return tangent_->answer(cable, force);
    });
  }
  std::vector<double> motion;
  if (sections_) {
    if (sections_->is_update_due(k)) {
      sections_->update_tangent(task, x, k);
      anderson_.forget();  // its history is of other steps
    }
    motion = sections_->correct(task, x, z);
  }
  preconditioner_.apply(z);
  for (std::size_t i = 0; i < motion.size(); ++i) z[i] += motion[i];
  cables_.drive_lengths(task, x, z, [this](std::size_t cable, const Eigen::Matrix3Xd& force) {
    return cables_.answer_of_constant(cable, force);
  });
}

// x += dx, the accelerated step z: no node moves further than the limit, no cable pushes.
void Solver::accelerate(std::vector<double>& x, const std::vector<double>& z, std::vector<double>& dx) {
  const bool is_limited = settings_.step_limit > 0.0;
  anderson_.advance(x, z, dx, !is_limited);
  if (is_limited) {
    const double largest = largest_motion(dx, preconditioner_.unknowns().count);
    if (largest > settings_.step_limit) {
      for (double& value : dx) value *= settings_.step_limit / largest;
    }
    for (std::size_t i = 0; i < x.size(); ++i) x[i] += dx[i];
  }
  cables_.clip_tensions(x, dx);
}

// A share of the last step back.
void Solver::back_track(std::vector<double>& x, std::vector<double>& dx, double share) {
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] -= share * dx[i];
    dx[i] *= 1.0 - share;
  }
  anderson_.forget();
}

void Solver::report(const Task& task, const std::vector<double>& x, Outcome& outcome) const {
  forces_.report(task, outcome);
  cables_.report(task, x, outcome);
  if (!contact_) return;
  outcome.touches = contact_->touches();
  for (const Touch& touch : outcome.touches) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto column = static_cast<Eigen::Index>(axis);
      const bool is_held = preconditioner_.unknowns().axes[axis].dof[static_cast<std::size_t>(touch.node)] < 0;
      if (is_held) outcome.reaction(touch.node, column) -= touch.force[column];
    }
  }
}

}  // namespace softgrip::gdfe
