// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/cable_system.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::gdfe {

CableSystem::CableSystem(std::vector<Cable> cables, const Nodes& rest, Preconditioner& preconditioner)
    : cables_(std::move(cables)),
      unknowns_(preconditioner.unknowns()),
      difference_(difference_step(rest)),
      states_(cables_.size()),
      first_point_{0} {
  for (const Cable& cable : cables_) first_point_.push_back(first_point_.back() + cable.points.size());
  if (points() > 0) solve_point_columns(preconditioner);
  measure_rest_lengths(rest);
}

void CableSystem::solve_point_columns(Preconditioner& preconditioner) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (preconditioner.shared_dof_map(axis) != axis) {
      point_columns_[axis] = point_columns_[preconditioner.shared_dof_map(axis)];
      continue;
    }
    const AxisUnknowns& a = unknowns_.axes[axis];
    auto matrix = std::make_shared<Eigen::MatrixXd>(
        Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(a.size), static_cast<Eigen::Index>(points())));
    for (std::size_t c = 0; c < cables_.size(); ++c) {
      for (std::size_t p = 0; p < cables_[c].points.size(); ++p) {
        const CablePoint& point = cables_[c].points[p];
        auto column = matrix->col(static_cast<Eigen::Index>(first_point_[c] + p));
        for (std::size_t k = 0; k < point.nodes.size(); ++k) {
          const int dof = a.dof[static_cast<std::size_t>(point.nodes[k])];
          if (dof >= 0) column(dof) += point.weights[k];
        }
        preconditioner.solve(axis, column.data());
      }
    }
    point_columns_[axis] = matrix;
  }
}

void CableSystem::measure_rest_lengths(const Nodes& rest) {
  std::vector<double> position(kStride * static_cast<std::size_t>(rest.rows()));
  for (Eigen::Index i = 0; i < rest.rows(); ++i) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      position[kStride * static_cast<std::size_t>(i) + static_cast<std::size_t>(axis)] = rest(i, axis);
    }
  }
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    locate_points(c, position.data(), states_[c].points);
    const CableState slack = pull_from_anchor(cables_[c], states_[c].points, 0.0);
    states_[c].rest_length = slack.length + slack.entry_length;
  }
}

void CableSystem::set_tensions(const std::vector<double>& anchor_tension, std::vector<double>& x) {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    // the step of a tension counts as much as the motion of the mesh that it causes
    double square = 0.0;
    for (const auto& columns : point_columns_) {
      for (std::size_t p = first_point_[c]; p < first_point_[c + 1]; ++p) {
        square += columns->col(static_cast<Eigen::Index>(p)).squaredNorm();
      }
    }
    states_[c].tension_scale = square > 0.0 ? std::sqrt(square) : 1.0;
    x[unknowns_.count + c] = anchor_tension[c] * states_[c].tension_scale;
  }
}

void CableSystem::locate_points(std::size_t cable, const double* position, std::vector<Eigen::Vector3d>& points) const {
  points.resize(cables_[cable].points.size());
  for (std::size_t p = 0; p < points.size(); ++p) {
    const CablePoint& point = cables_[cable].points[p];
    points[p] = point.fixed;
    for (std::size_t k = 0; k < point.nodes.size(); ++k) {
      const double* node = position + kStride * static_cast<std::size_t>(point.nodes[k]);
      points[p] += point.weights[k] * Eigen::Vector3d(node[0], node[1], node[2]);
    }
  }
}

double CableSystem::tension(const std::vector<double>& x, std::size_t cable) const {
  return x[unknowns_.count + cable] / states_[cable].tension_scale;
}

CableState CableSystem::forces_at(const Task& task, const std::vector<double>& x, std::size_t cable,
                                  const std::vector<Eigen::Vector3d>& points) const {
  const CableDrive& drive = task.drives[cable];
  return drive.by_length ? pull_from_anchor(cables_[cable], points, tension(x, cable))
                         : pull_from_actuator(cables_[cable], points, drive.target);
}

void CableSystem::subtract_forces(const Task& task, const std::vector<double>& x, const double* position,
                                  double* force) {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    IterationState& state = states_[c];
    locate_points(c, position, state.points);
    state.forces = forces_at(task, x, c, state.points);
    for (std::size_t p = 0; p < state.points.size(); ++p) {
      const CablePoint& point = cables_[c].points[p];
      for (std::size_t k = 0; k < point.nodes.size(); ++k) {
        double* node = force + kStride * static_cast<std::size_t>(point.nodes[k]);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          node[axis] -= point.weights[k] * state.forces.force[p][static_cast<Eigen::Index>(axis)];
        }
      }
    }
  }
}

bool CableSystem::are_sound() const {
  return std::all_of(states_.begin(), states_.end(), [](const IterationState& state) { return state.forces.sound; });
}

double CableSystem::add_force_squares(double sum) const {
  for (const IterationState& state : states_) {
    for (const Eigen::Vector3d& force : state.forces.force) sum += force.squaredNorm();
  }
  return sum;
}

double CableSystem::length_error(const Task& task, const std::vector<double>& x) const {
  double largest = 0.0;
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    if (!task.drives[c].by_length) continue;
    const double overlength = -missing_length(task, c);
    const bool is_slack = x[unknowns_.count + c] <= 0.0 && overlength < 0.0;
    if (!is_slack) largest = std::max(largest, std::abs(overlength));
  }
  return largest;
}

double CableSystem::missing_length(const Task& task, std::size_t cable) const {
  const IterationState& state = states_[cable];
  return state.rest_length - task.drives[cable].target - (state.forces.length + state.forces.entry_length);
}

CableState CableSystem::unit_forces(const std::vector<double>& x, std::size_t cable) const {
  const double tension = this->tension(x, cable), unit = std::max(tension, friction::kTensionFloor_N);
  CableState forces = tension >= friction::kTensionFloor_N
                          ? states_[cable].forces
                          : pull_from_anchor(cables_[cable], states_[cable].points, unit);
  for (Eigen::Vector3d& force : forces.force) force /= unit;
  return forces;
}

Eigen::VectorXd CableSystem::answer_of_constant(std::size_t cable, const Eigen::Matrix3Xd& force) const {
  Eigen::VectorXd motion(static_cast<Eigen::Index>(unknowns_.count));
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const AxisUnknowns& a = unknowns_.axes[axis];
    const Eigen::VectorXd along = force.row(static_cast<Eigen::Index>(axis));
    motion.segment(static_cast<Eigen::Index>(a.offset), static_cast<Eigen::Index>(a.size)).noalias() =
        point_columns_[axis]->middleCols(static_cast<Eigen::Index>(first_point_[cable]), along.size()) * along;
  }
  return motion;
}

void CableSystem::drive_lengths(const Task& task, const std::vector<double>& x, std::vector<double>& step,
                                const PointAnswer& answer) const {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    double& tension_step = step[unknowns_.count + c];
    if (!task.drives[c].by_length) {
      tension_step = 0.0;
      continue;
    }
    const double scale = states_[c].tension_scale, tension = (x[unknowns_.count + c] + tension_step) / scale;
    const CableState unit = unit_forces(x, c);
    Eigen::Matrix3Xd force(3, static_cast<Eigen::Index>(unit.force.size()));
    for (std::size_t p = 0; p < unit.force.size(); ++p) force.col(static_cast<Eigen::Index>(p)) = unit.force[p];
    const Eigen::VectorXd motion = answer(c, force);
    double gain = 0.0, moved = 0.0;
    for_each_unknown(c, [&](std::size_t unknown, std::size_t axis, std::size_t p, double weight) {
      const double slope = unit.slope[p][static_cast<Eigen::Index>(axis)] * weight;
      gain += slope * motion(static_cast<Eigen::Index>(unknown));
      moved += slope * step[unknown];
    });
    double change = gain < 0.0 ? (missing_length(task, c) - moved) / gain : 0.0;
    change = std::max(change, -tension);
    for (Eigen::Index i = 0; i < motion.size(); ++i) step[static_cast<std::size_t>(i)] += change * motion(i);
    tension_step += change * scale;
  }
}

void CableSystem::clip_tensions(std::vector<double>& x, std::vector<double>& step) const {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    double& tension = x[unknowns_.count + c];
    if (tension < 0.0) step[unknowns_.count + c] -= tension, tension = 0.0;
  }
}

Eigen::SparseMatrix<double> CableSystem::point_reach() const {
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    for_each_unknown(c, [&](std::size_t unknown, std::size_t axis, std::size_t p, double weight) {
      entries.emplace_back(static_cast<Eigen::Index>(unknown),
                           static_cast<Eigen::Index>(3 * (first_point_[c] + p) + axis), weight);
    });
  }
  Eigen::SparseMatrix<double> reach(static_cast<Eigen::Index>(unknowns_.count),
                                    static_cast<Eigen::Index>(3 * points()));
  reach.setFromTriplets(entries.begin(), entries.end());
  return reach;
}

Eigen::MatrixXd CableSystem::stiffness(const Task& task, const std::vector<double>& x, std::size_t cable) const {
  const std::vector<Eigen::Vector3d>& points = states_[cable].points;
  const auto size = static_cast<Eigen::Index>(3 * points.size());
  const auto forces = [&](const std::vector<Eigen::Vector3d>& at) {
    const CableState state = forces_at(task, x, cable, at);
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(state.force.front().data(), size));
  };
  Eigen::MatrixXd stiffness(size, size);
  for (Eigen::Index k = 0; k < size; ++k) {
    std::vector<Eigen::Vector3d> less = points, more = points;
    less[static_cast<std::size_t>(k / 3)][k % 3] -= difference_;
    more[static_cast<std::size_t>(k / 3)][k % 3] += difference_;
    stiffness.col(k) = (forces(less) - forces(more)) / (2.0 * difference_);
  }
  return stiffness;
}

void CableSystem::report(const Task& task, const std::vector<double>& x, Outcome& outcome) const {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    const CableState& forces = states_[c].forces;
    outcome.anchor_tension.push_back(task.drives[c].by_length ? tension(x, c) : forces.tension.back());
    outcome.tension.push_back(forces.tension);
    outcome.shortening.push_back(states_[c].rest_length - forces.length - forces.entry_length);
  }
}

}  // namespace softgrip::gdfe
