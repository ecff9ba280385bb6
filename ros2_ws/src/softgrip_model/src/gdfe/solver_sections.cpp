// SPDX-License-Identifier: Apache-2.0
// The second level of an iteration: what the sections and the tensions of driven cables answer before the constant matrix does.
#include <stdexcept>

#include "softgrip/gdfe/solver.hpp"

namespace softgrip::gdfe {
namespace {

// Of the mesh's size: beyond the noise of forces, and nothing beside what bends their slopes. Soft motions are small differences
// of stiff ones: a coarser difference would not know them.
constexpr double kDifference = 1e-8;
// The tangent is measured anew after so many iterations, and after a step in which a section would have turned further [rad]:
// such a step is cut to that.
constexpr int kLasts = 40;
constexpr double kTurn = 0.1;

}  // namespace

void Solver::build_sections(const Hexes& hexes) {
  if (settings_.sections_after < 0 || unknowns_ == 0) return;
  if (!alike_ || !contact_.empty()) {
    throw std::invalid_argument(
        "sections_after: expected nodes that are free or held along all axes alike, none tied, and no obstacles; found others: leave it -1");
  }
  sections_ = std::make_unique<Sections>(hexes, nodes_, axes_[0].nodes);
}

// take(unknown, point, weight) for every free node that a cable's points hang on.
template <class Take>
void Solver::each_cable_node(std::size_t cable, const Take& take) const {
  for (std::size_t p = 0; p < cables_[cable].points.size(); ++p) {
    const CablePoint& point = cables_[cable].points[p];
    for (std::size_t k = 0; k < point.nodes.size(); ++k) {
      const std::int32_t at = axes_[0].dof[static_cast<std::size_t>(point.nodes[k])];
      if (at >= 0) take(static_cast<std::size_t>(at), p, point.weights[k]);
    }
  }
}

// At the positions of the iteration; leaves others. The cables' part is small but needed: what they pull together would buckle
// if they did not turn with it.
bool Solver::measure_sections(const Task& task, const std::vector<double>& state) {
  const std::vector<double> here = position_;
  const double step = kDifference * (rest_.colwise().maxCoeff() - rest_.colwise().minCoeff()).norm();
  const auto forces = [this](const std::vector<double>& at, std::vector<double>& force) { forces_at(at, force); };
  if (!sections_->measure(here, step, forces)) return false;
  Eigen::Index columns = 0;
  for (const Cable& cable : cables_) columns += 3 * static_cast<Eigen::Index>(cable.points.size());
  if (columns == 0) return true;
  point_reach_.setZero(static_cast<Eigen::Index>(6 * sections_->count()), columns);
  point_stiffness_.setZero(columns, columns);
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    const auto first = static_cast<Eigen::Index>(3 * first_column_[c]);
    each_cable_node(c, [&](std::size_t at, std::size_t p, double weight) {
      for (int axis = 0; axis < 3; ++axis) {
        sections_->add_force(at, weight * Eigen::Vector3d::Unit(axis), point_reach_.col(first + static_cast<Eigen::Index>(3 * p) + axis));
      }
    });
    const Eigen::MatrixXd stiffness = cable_stiffness(task, state, c, step);
    point_stiffness_.block(first, first, stiffness.rows(), stiffness.cols()) = stiffness;
  }
  return sections_->couple(point_reach_, point_stiffness_);
}

// How the forces on a cable's points fall as these move, at the tension that it has; by differences.
Eigen::MatrixXd Solver::cable_stiffness(const Task& task, const std::vector<double>& state, std::size_t cable, double step) const {
  const CableWork& work = cable_work_[cable];
  const auto size = static_cast<Eigen::Index>(3 * work.points.size());
  const auto forces = [&](const std::vector<Eigen::Vector3d>& points) {
    const CableDrive& drive = task.drives[cable];
    const CableState pull = drive.by_length ? pull_from_anchor(cables_[cable], points, state[unknowns_ + cable] / work.tension_scale)
                                            : pull_from_actuator(cables_[cable], points, drive.target);
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(pull.force.front().data(), size));
  };
  Eigen::MatrixXd stiffness(size, size);
  for (Eigen::Index k = 0; k < size; ++k) {
    std::vector<Eigen::Vector3d> less = work.points, more = work.points;
    less[static_cast<std::size_t>(k / 3)][k % 3] -= step;
    more[static_cast<std::size_t>(k / 3)][k % 3] += step;
    stiffness.col(k) = (forces(less) - forces(more)) / (2.0 * step);
  }
  return stiffness;
}

// The step that answers an out-of-balance force, in its place.
void Solver::answer(const Task& task, const std::vector<double>& state, int iteration, std::vector<double>& residual) {
  if (sections_ && iteration >= measure_at_) {
    by_sections_ = measure_sections(task, state);
    measure_at_ = iteration + kLasts;
    accelerate_->forget();  // it knows other steps
  }
  std::vector<double> motion;
  if (by_sections_) motion = answer_of_sections(task, state, residual);
  precondition(residual);
  for (std::size_t i = 0; i < motion.size(); ++i) residual[i] += motion[i];
  drive_lengths(task, state, residual);
}

// Motions of the sections and tensions that bring the cables to their lengths, together; `residual` becomes what they leave.
std::vector<double> Solver::answer_of_sections(const Task& task, const std::vector<double>& state, std::vector<double>& residual) {
  const auto cables = static_cast<Eigen::Index>(cables_.size());
  Eigen::MatrixXd answers(static_cast<Eigen::Index>(6 * sections_->count()), 1 + cables);
  Eigen::MatrixXd slopes = Eigen::MatrixXd::Zero(answers.rows(), cables);
  Eigen::VectorXd missing = Eigen::VectorXd::Zero(cables);
  std::vector<CableState> pulls(cables_.size());
  answers.setZero();
  answers.col(0) = sections_->restricted(residual);
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    if (!task.drives[c].by_length) continue;
    const auto column = static_cast<Eigen::Index>(c);
    const CableWork& work = cable_work_[c];
    pulls[c] = unit_pull(state, c);
    each_cable_node(c, [&](std::size_t at, std::size_t p, double weight) {
      sections_->add_force(at, weight * pulls[c].force[p], answers.col(1 + column));
      sections_->add_force(at, weight * pulls[c].slope[p], slopes.col(column));
    });
    missing(column) = work.rest_length - task.drives[c].target - (work.state.length + work.state.entry_length);
  }
  sections_->solve(answers);
  Eigen::VectorXd amounts = answers.col(0), changes = Eigen::VectorXd::Zero(cables);
  std::vector<double> motion(unknowns_ + cables_.size(), 0.0);
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    // cables hardly meet in their sections: one after the other
    const auto column = static_cast<Eigen::Index>(c);
    const double gain = slopes.col(column).dot(answers.col(1 + column));
    if (!(gain < 0.0)) continue;
    const double tension = state[unknowns_ + c] / cable_work_[c].tension_scale;
    const double change = std::max(-tension, (missing(column) - slopes.col(column).dot(amounts)) / gain);
    amounts += change * answers.col(1 + column);
    changes(column) = change;
  }
  if (!amounts.allFinite()) return {};
  const double turn = sections_->largest_turn(amounts), share = std::min(1.0, kTurn / turn);
  if (share < 1.0) measure_at_ = 0;
  amounts *= share;
  changes *= share;
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    if (pulls[c].force.empty()) continue;
    const double change = changes(static_cast<Eigen::Index>(c));
    motion[unknowns_ + c] = change * cable_work_[c].tension_scale;
    each_cable_node(c, [&](std::size_t at, std::size_t p, double weight) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        residual[axes_[axis].offset + at] += change * weight * pulls[c].force[p][static_cast<Eigen::Index>(axis)];
      }
    });
  }
  sections_->move(amounts, motion, residual);
  Eigen::VectorXd turned;
  if (!cables_.empty()) turned = point_stiffness_ * (point_reach_.transpose() * amounts);
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    each_cable_node(c, [&](std::size_t at, std::size_t p, double weight) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        residual[axes_[axis].offset + at] -= weight * turned(static_cast<Eigen::Index>(3 * (first_column_[c] + p) + axis));
      }
    });
  }
  return motion;
}

}  // namespace softgrip::gdfe
