// SPDX-License-Identifier: Apache-2.0
// What cables do in an iteration: where their points are, how they pull, and the tension that brings a driven one to its length.
#include <algorithm>

#include "softgrip/gdfe/solver.hpp"

namespace softgrip::gdfe {

void Solver::cable_points(std::size_t index, const double* position, std::vector<Eigen::Vector3d>& points) const {
  const Cable& cable = cables_[index];
  points.resize(cable.points.size());
  for (std::size_t p = 0; p < points.size(); ++p) {
    const CablePoint& point = cable.points[p];
    points[p] = point.fixed;
    for (std::size_t k = 0; k < point.nodes.size(); ++k) {
      const double* node = position + kStride * static_cast<std::size_t>(point.nodes[k]);
      points[p] += point.weights[k] * Eigen::Vector3d(node[0], node[1], node[2]);
    }
  }
}

void Solver::pull_cables(const Task& task, const std::vector<double>& state) {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    CableWork& work = cable_work_[c];
    cable_points(c, position_.data(), work.points);
    const CableDrive& drive = task.drives[c];
    work.state = drive.by_length ? pull_from_anchor(cables_[c], work.points, state[unknowns_ + c] / work.tension_scale)
                                 : pull_from_actuator(cables_[c], work.points, drive.target);
    for (std::size_t p = 0; p < work.points.size(); ++p) {
      const CablePoint& point = cables_[c].points[p];
      for (std::size_t k = 0; k < point.nodes.size(); ++k) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
          force_[kStride * static_cast<std::size_t>(point.nodes[k]) + axis] -=
              point.weights[k] * work.state.force[p][static_cast<Eigen::Index>(axis)];
        }
      }
    }
  }
}

// How a cable pulls with a unit tension at its anchor; a slack one has its direction at the friction law's floor.
CableState Solver::unit_pull(const std::vector<double>& state, std::size_t cable) const {
  const CableWork& work = cable_work_[cable];
  const double tension = state[unknowns_ + cable] / work.tension_scale, unit = std::max(tension, friction::kTensionFloor_N);
  CableState pull = tension >= friction::kTensionFloor_N ? work.state : pull_from_anchor(cables_[cable], work.points, unit);
  for (Eigen::Vector3d& force : pull.force) force /= unit;
  return pull;
}

// Adds to the step what brings every driven cable to its length, and the tension that does it.
void Solver::drive_lengths(const Task& task, const std::vector<double>& state, std::vector<double>& step) {
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    const CableDrive& drive = task.drives[c];
    CableWork& work = cable_work_[c];
    if (!drive.by_length) {
      step[unknowns_ + c] = 0.0;
      continue;
    }
    const double tension = (state[unknowns_ + c] + step[unknowns_ + c]) / work.tension_scale;
    const CableState pull = unit_pull(state, c);
    double gain = 0.0, moved = 0.0;
    std::array<Eigen::VectorXd, 3> response;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Axis& a = axes_[axis];
      const auto column = static_cast<Eigen::Index>(axis);
      const auto points = static_cast<Eigen::Index>(work.points.size());
      Eigen::VectorXd force(points);
      for (Eigen::Index p = 0; p < points; ++p) force(p) = pull.force[static_cast<std::size_t>(p)][column];
      response[axis] = a.point_columns->middleCols(static_cast<Eigen::Index>(first_column_[c]), points) * force;
      for (std::size_t p = 0; p < work.points.size(); ++p) {
        const CablePoint& point = cables_[c].points[p];
        for (std::size_t k = 0; k < point.nodes.size(); ++k) {
          const int dof = a.dof[static_cast<std::size_t>(point.nodes[k])];
          if (dof < 0) continue;
          const double slope = pull.slope[p][column] * point.weights[k];
          gain += slope * response[axis](dof);
          moved += slope * step[a.offset + static_cast<std::size_t>(dof)];
        }
      }
    }
    const double gap = work.rest_length - drive.target - (work.state.length + work.state.entry_length) - moved;
    double change = gain < 0.0 ? gap / gain : 0.0;
    change = std::max(change, -tension);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Axis& a = axes_[axis];
      for (Eigen::Index i = 0; i < response[axis].size(); ++i) step[a.offset + static_cast<std::size_t>(i)] += change * response[axis](i);
    }
    step[unknowns_ + c] += change * work.tension_scale;
  }
}

}  // namespace softgrip::gdfe
