// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/contact.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::gdfe {
namespace {

// Sweeps over all touching nodes in one iteration of the solver; the forces are kept, so the next iteration goes on.
constexpr int kSweeps = 60;
// Changes of the forces below this share of the largest end the sweeps.
constexpr double kSweepTolerance = 1e-10;

Eigen::Vector3d tangential(const Eigen::Vector3d& vector, const Eigen::Vector3d& normal) {
  return vector - normal.dot(vector) * normal;
}

}  // namespace

Gap gap_to(const Obstacle& obstacle, const Eigen::Vector3d& motion, const Eigen::Vector3d& point) {
  Eigen::Vector3d offset = point - obstacle.point - motion;
  if (obstacle.kind == ObstacleKind::Plane) return {obstacle.axis.dot(offset), obstacle.axis};
  if (obstacle.kind == ObstacleKind::Cylinder) offset = tangential(offset, obstacle.axis);
  const double distance = offset.norm();
  // on the centre or axis every direction leads out alike
  const Eigen::Vector3d normal = distance > 0.0 ? Eigen::Vector3d(offset / distance) : obstacle.axis.unitOrthogonal();
  return {distance - obstacle.radius, normal};
}

Contact::Contact(std::vector<Obstacle> obstacles, const Nodes& rest, Preconditioner& preconditioner)
    : obstacles_(std::move(obstacles)),
      rest_(rest),
      preconditioner_(preconditioner),
      unknowns_(preconditioner.unknowns()),
      place_(static_cast<std::size_t>(rest.rows()), -1) {
  for (const Obstacle& obstacle : obstacles_) {
    for (const std::int32_t node : obstacle.nodes) {
      std::int32_t& place = place_[static_cast<std::size_t>(node)];
      if (place >= 0) continue;
      place = static_cast<std::int32_t>(candidates_.size());
      candidates_.push_back(node);
    }
  }
  for (auto& columns : columns_) columns.resize(candidates_.size());
}

void Contact::set_task(const Task& task) {
  motions_ = task.motions;
  motions_before_ = task.motions_before;
  before_ = rest_ + task.before;
  pairs_.clear();
  touches_.clear();
  last_force_.clear();
  for (const Obstacle& obstacle : obstacles_) last_force_.emplace_back(obstacle.nodes.size(), Eigen::Vector3d::Zero());
}

Eigen::Vector3d Contact::motion_of(const std::vector<double>& step, std::int32_t node) const {
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t dof = unknowns_.axes[axis].dof[static_cast<std::size_t>(node)];
    if (dof >= 0)
      moved[static_cast<Eigen::Index>(axis)] = step[unknowns_.axes[axis].offset + static_cast<std::size_t>(dof)];
  }
  return moved;
}

void Contact::add_force(std::int32_t node, const Eigen::Vector3d& force, std::vector<double>& residual) const {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t dof = unknowns_.axes[axis].dof[static_cast<std::size_t>(node)];
    if (dof >= 0)
      residual[unknowns_.axes[axis].offset + static_cast<std::size_t>(dof)] += force[static_cast<Eigen::Index>(axis)];
  }
}

void Contact::add_last_forces(std::vector<double>& residual) const {
  for (const Touch& touch : touches_) add_force(touch.node, touch.force, residual);
}

double Contact::compliance(std::size_t axis, std::int32_t pushed, std::int32_t moved) {
  const std::size_t first = preconditioner_.shared_dof_map(axis);
  const auto& dof = unknowns_.axes[axis].dof;
  const std::int32_t at = dof[static_cast<std::size_t>(pushed)];
  if (at < 0) return 0.0;
  auto& column = columns_[first][static_cast<std::size_t>(place_[static_cast<std::size_t>(pushed)])];
  if (column.empty()) {
    std::vector<double> full(unknowns_.axes[axis].size, 0.0);
    full[static_cast<std::size_t>(at)] = 1.0;
    preconditioner_.solve(axis, full.data());
    column.resize(candidates_.size());
    for (std::size_t c = 0; c < candidates_.size(); ++c) {
      const std::int32_t other = dof[static_cast<std::size_t>(candidates_[c])];
      column[c] = other < 0 ? 0.0 : full[static_cast<std::size_t>(other)];
    }
  }
  return column[static_cast<std::size_t>(place_[static_cast<std::size_t>(moved)])];
}

// Pairs that touch, would after the step, or did in the last iteration.
void Contact::find_pairs(const double* position, const std::vector<double>& step) {
  pairs_.clear();
  gap_error_ = 0.0;
  for (std::size_t o = 0; o < obstacles_.size(); ++o) {
    const Obstacle& obstacle = obstacles_[o];
    for (std::size_t k = 0; k < obstacle.nodes.size(); ++k) {
      const std::int32_t node = obstacle.nodes[k];
      const double* p = position + kStride * static_cast<std::size_t>(node);
      const Eigen::Vector3d here(p[0], p[1], p[2]);
      const Gap gap = gap_to(obstacle, motions_[o], here);
      const Eigen::Vector3d free_step = motion_of(step, node);
      const Eigen::Vector3d& last = last_force_[o][k];
      const bool pushed = last.squaredNorm() > 0.0;
      gap_error_ = std::max(gap_error_, pushed ? std::abs(gap.distance) : -gap.distance);
      if (!pushed && gap.distance + gap.normal.dot(free_step) >= 0.0) continue;
      const Eigen::Vector3d moved =
          here - before_.row(node).transpose() - (motions_[o] - motions_before_[o]) + free_step;
      const double normal_force = std::max(0.0, gap.normal.dot(last));
      Eigen::Vector3d friction = tangential(last, gap.normal);
      const double limit = obstacle.friction * normal_force, size = friction.norm();
      if (size > limit) friction *= size > 0.0 ? limit / size : 0.0;
      pairs_.push_back({static_cast<std::int32_t>(o), node, gap, last, normal_force * gap.normal + friction, free_step,
                        tangential(moved, gap.normal), false});
    }
  }
}

void Contact::solve_forces() {
  const std::size_t count = pairs_.size();
  std::vector<Eigen::Matrix<double, 3, Eigen::Dynamic>> answer(
      count);  // of every pair to a unit force on one, per axis
  std::vector<Eigen::Vector3d> moved(count, Eigen::Vector3d::Zero());
  for (std::size_t j = 0; j < count; ++j) {
    answer[j].resize(3, static_cast<Eigen::Index>(count));
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        answer[j](static_cast<Eigen::Index>(axis), static_cast<Eigen::Index>(i)) =
            unknowns_.axes[axis].dof[static_cast<std::size_t>(pairs_[i].node)] < 0
                ? 0.0
                : compliance(axis, pairs_[j].node, pairs_[i].node);
      }
    }
  }
  const auto push = [&](std::size_t j, const Eigen::Vector3d& change) {
    for (std::size_t i = 0; i < count; ++i)
      moved[i] += answer[j].col(static_cast<Eigen::Index>(i)).cwiseProduct(change);
  };
  for (std::size_t j = 0; j < count; ++j) {
    if (pairs_[j].force != pairs_[j].last) push(j, pairs_[j].force - pairs_[j].last);
  }
  for (int round = 0; round < kSweeps; ++round) {
    double largest = 0.0, max_change = 0.0;
    for (std::size_t j = 0; j < count; ++j) {
      Pair& pair = pairs_[j];
      const Eigen::Vector3d own = answer[j].col(static_cast<Eigen::Index>(j));
      const double along = own.cwiseProduct(pair.gap.normal).dot(pair.gap.normal);
      if (!(along > 0.0)) continue;  // held where the obstacle would push
      const Eigen::Vector3d& n = pair.gap.normal;
      const double gap = pair.gap.distance + n.dot(pair.free_step + moved[j]);
      const double normal_force = std::max(0.0, n.dot(pair.force) - gap / along);
      const double limit = obstacles_[static_cast<std::size_t>(pair.obstacle)].friction * normal_force;
      Eigen::Vector3d friction = Eigen::Vector3d::Zero();
      pair.sliding = true;
      if (limit > 0.0) {
        friction = tangential(pair.force - (pair.slip + tangential(moved[j], n)) / own.maxCoeff(), n);
        const double size = friction.norm();
        pair.sliding = size > limit;
        if (pair.sliding) friction *= limit / size;
      }
      const Eigen::Vector3d now = normal_force * n + friction, change = now - pair.force;
      if (change.squaredNorm() > 0.0) push(j, change);
      pair.force = now;
      largest = std::max(largest, now.squaredNorm());
      max_change = std::max(max_change, change.squaredNorm());
    }
    if (max_change <= kSweepTolerance * kSweepTolerance * largest) break;
  }
}

void Contact::resolve(const double* position, std::vector<double>& residual, std::vector<double>& step) {
  find_pairs(position, step);
  solve_forces();
  std::vector<double> push(residual.size(), 0.0);
  touches_.clear();
  std::size_t next = 0;
  for (std::size_t o = 0; o < obstacles_.size(); ++o) {
    for (std::size_t k = 0; k < obstacles_[o].nodes.size(); ++k) {
      Eigen::Vector3d& kept = last_force_[o][k];
      kept.setZero();
      if (next == pairs_.size() || pairs_[next].obstacle != static_cast<std::int32_t>(o) ||
          pairs_[next].node != obstacles_[o].nodes[k])
        continue;
      const Pair& pair = pairs_[next++];
      add_force(pair.node, pair.force - pair.last, push);
      if (pair.force.squaredNorm() == 0.0) continue;
      kept = pair.force;
      touches_.push_back({pair.obstacle, pair.node, pair.gap.distance, pair.force, pair.sliding});
    }
  }
  if (next == 0) return;
  for (std::size_t i = 0; i < push.size(); ++i) residual[i] += push[i];
  for (std::size_t axis = 0; axis < 3; ++axis) preconditioner_.solve(axis, push.data() + unknowns_.axes[axis].offset);
  for (std::size_t i = 0; i < push.size(); ++i) step[i] += push[i];
}

double Contact::force_squared() const {
  double sum = 0.0;
  for (const Touch& touch : touches_) sum += touch.force.squaredNorm();
  return sum;
}

}  // namespace softgrip::gdfe
