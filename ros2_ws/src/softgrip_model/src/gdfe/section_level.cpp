// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/section_level.hpp"

#include <algorithm>

namespace softgrip::gdfe {
namespace {

// The tangent is measured again after so many iterations, and after a step in which a section would have turned further
// [rad]: such a step is cut to that.
constexpr int kTangentLifetime = 40;
constexpr double kMaxTurn_rad = 0.1;

}  // namespace

SectionLevel::SectionLevel(const Problem& problem, const Unknowns& unknowns, ForceAssembly& forces, CableSystem& cables,
                           int first_iteration)
    : unknowns_(unknowns),
      forces_(forces),
      cables_(cables),
      sections_(problem.hexes, static_cast<std::size_t>(problem.rest.rows()), unknowns.axes[0].nodes, problem.sections),
      first_iteration_(first_iteration),
      difference_(difference_step(problem.rest)) {}

void SectionLevel::restart() {
  has_tangent_ = false;
  next_update_ = first_iteration_;
}

void SectionLevel::update_tangent(const Task& task, const std::vector<double>& x, int k) {
  has_tangent_ = measure_tangent(task, x);
  next_update_ = k + kTangentLifetime;
}

// The cables' part is small but needed: what they pull together would buckle if they did not turn with it.
bool SectionLevel::measure_tangent(const Task& task, const std::vector<double>& x) {
  const std::vector<double> here = forces_.position();
  const auto forces = [this](const std::vector<double>& at, std::vector<double>& force) {
    forces_.compute_element_residual(at, force);
  };
  if (!sections_.measure(here, difference_, forces)) return false;
  const auto columns = 3 * static_cast<Eigen::Index>(cables_.points());
  if (columns == 0) return true;
  point_reach_.setZero(static_cast<Eigen::Index>(6 * sections_.count()), columns);
  point_stiffness_.setZero(columns, columns);
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    const auto first = static_cast<Eigen::Index>(3 * cables_.first_point(c));
    cables_.for_each_free_node(c, [&](std::size_t dof, std::size_t p, double weight) {
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Index column = first + static_cast<Eigen::Index>(3 * p) + axis;
        sections_.add_force(dof, weight * Eigen::Vector3d::Unit(axis), point_reach_.col(column));
      }
    });
    const Eigen::MatrixXd stiffness = cables_.stiffness(task, x, c);
    point_stiffness_.block(first, first, stiffness.rows(), stiffness.cols()) = stiffness;
  }
  return sections_.couple(point_reach_, point_stiffness_);
}

std::vector<double> SectionLevel::correct(const Task& task, const std::vector<double>& x,
                                          std::vector<double>& residual) {
  if (!has_tangent_) return {};
  std::vector<CableState> unit_forces(cables_.count());  // of driven cables
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    if (task.drives[c].by_length) unit_forces[c] = cables_.unit_forces(x, c);
  }
  Answer answer = solve_motions(task, x, residual, unit_forces);
  if (!answer.amounts.allFinite()) return {};
  limit_turn(answer);
  std::vector<double> motion(unknowns_.count + cables_.count(), 0.0);
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    if (unit_forces[c].force.empty()) continue;
    const double change = answer.tensions(static_cast<Eigen::Index>(c));
    motion[unknowns_.count + c] = change * cables_.tension_scale(c);
    cables_.for_each_free_node(c, [&](std::size_t dof, std::size_t p, double weight) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double force = unit_forces[c].force[p][static_cast<Eigen::Index>(axis)];
        residual[unknowns_.axes[axis].offset + dof] += change * weight * force;
      }
    });
  }
  sections_.move(answer.amounts, motion, residual);
  if (cables_.count() == 0) return motion;
  const Eigen::VectorXd lost = point_stiffness_ * (point_reach_.transpose() * answer.amounts);
  for (std::size_t c = 0; c < cables_.count(); ++c) subtract_point_forces(c, lost, residual);
  return motion;
}

// Motions that answer the residual, and tensions that bring the cables to their lengths, together.
SectionLevel::Answer SectionLevel::solve_motions(const Task& task, const std::vector<double>& x,
                                                 const std::vector<double>& residual,
                                                 const std::vector<CableState>& unit_forces) const {
  const auto cables = static_cast<Eigen::Index>(cables_.count());
  Eigen::MatrixXd answers = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(6 * sections_.count()), 1 + cables);
  Eigen::MatrixXd slopes = Eigen::MatrixXd::Zero(answers.rows(), cables);
  Eigen::VectorXd missing = Eigen::VectorXd::Zero(cables);
  answers.col(0) = sections_.restricted(residual);
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    if (!task.drives[c].by_length) continue;
    const auto column = static_cast<Eigen::Index>(c);
    cables_.for_each_free_node(c, [&](std::size_t dof, std::size_t p, double weight) {
      sections_.add_force(dof, weight * unit_forces[c].force[p], answers.col(1 + column));
      sections_.add_force(dof, weight * unit_forces[c].slope[p], slopes.col(column));
    });
    missing(column) = cables_.missing_length(task, c);
  }
  sections_.solve(answers);
  Answer answer{answers.col(0), Eigen::VectorXd::Zero(cables)};
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    // cables hardly meet in their sections: one after the other
    const auto column = static_cast<Eigen::Index>(c);
    const double gain = slopes.col(column).dot(answers.col(1 + column));
    if (!(gain < 0.0)) continue;
    const double change =
        std::max(-cables_.tension(x, c), (missing(column) - slopes.col(column).dot(answer.amounts)) / gain);
    answer.amounts += change * answers.col(1 + column);
    answer.tensions(column) = change;
  }
  return answer;
}

void SectionLevel::limit_turn(Answer& answer) {
  const double share = std::min(1.0, kMaxTurn_rad / sections_.largest_turn(answer.amounts));
  if (share < 1.0) next_update_ = 0;
  answer.amounts *= share;
  answer.tensions *= share;
}

void SectionLevel::subtract_point_forces(std::size_t cable, const Eigen::VectorXd& force,
                                         std::vector<double>& residual) const {
  cables_.for_each_free_node(cable, [&](std::size_t dof, std::size_t p, double weight) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto row = static_cast<Eigen::Index>(3 * (cables_.first_point(cable) + p) + axis);
      residual[unknowns_.axes[axis].offset + dof] -= weight * force(row);
    }
  });
}

}  // namespace softgrip::gdfe
