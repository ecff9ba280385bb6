// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/sections.hpp"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>

namespace softgrip::gdfe {
namespace {

// A section of two nodes is no rigid body: one of its motions has no stiffness.
constexpr double kMinCondition = 1e-14;

// level: 0 on the support, elsewhere -1 -> distance from it in elements.
void spread(const Hexes& hexes, std::vector<std::int32_t>& level) {
  std::vector<Eigen::Index> waiting(static_cast<std::size_t>(hexes.rows()));
  for (std::size_t e = 0; e < waiting.size(); ++e) waiting[e] = static_cast<Eigen::Index>(e);
  const auto at = [&](Eigen::Index e, int c) -> std::int32_t& { return level[static_cast<std::size_t>(hexes(e, c))]; };
  for (std::int32_t front = 0;; ++front) {
    const auto done = std::remove_if(waiting.begin(), waiting.end(), [&](Eigen::Index e) {
      bool touched = false;
      for (int c = 0; c < 8; ++c) touched = touched || at(e, c) == front;
      if (!touched) return false;
      for (int c = 0; c < 8; ++c) {
        if (at(e, c) < 0) at(e, c) = front + 1;
      }
      return true;
    });
    if (done == waiting.end()) return;
    waiting.erase(done, waiting.end());
  }
}

// level: 0 on the support, elsewhere -1 -> what was given, from 1.
void take(const Hexes& hexes, const std::vector<std::int32_t>& given, std::vector<std::int32_t>& level) {
  if (given.size() != level.size()) {
    throw std::invalid_argument("sections: expected one for each of " + std::to_string(level.size()) +
                                " nodes, found " + std::to_string(given.size()));
  }
  for (std::size_t i = 0; i < level.size(); ++i) {
    if (level[i] >= 0) continue;
    if (given[i] < 0) {
      throw std::invalid_argument("sections: expected numbers from 0, found " + std::to_string(given[i]));
    }
    level[i] = given[i] + 1;
  }
  const std::int32_t last = *std::max_element(level.begin(), level.end());
  std::vector<char> has_node(static_cast<std::size_t>(std::max(last, 0)), 0);
  for (std::size_t i = 0; i < level.size(); ++i) {
    if (level[i] > 0) has_node[static_cast<std::size_t>(level[i] - 1)] = 1;
  }
  if (std::find(has_node.begin(), has_node.end(), 0) != has_node.end()) {
    throw std::invalid_argument("sections: expected nodes in each, found an empty one");
  }
  for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
    std::int32_t lowest = last, highest = 0;
    for (int c = 0; c < 8; ++c) {
      const std::int32_t own = level[static_cast<std::size_t>(hexes(e, c))];
      if (own > 0) lowest = std::min(lowest, own), highest = std::max(highest, own);
    }
    if (highest > lowest + 1) {
      throw std::invalid_argument("sections: expected that only neighbours meet in an element, found " +
                                  std::to_string(lowest - 1) + " and " + std::to_string(highest - 1) + " in element " +
                                  std::to_string(e));
    }
  }
}

}  // namespace

Sections::Sections(const Hexes& hexes, std::size_t nodes, std::vector<std::int32_t> node_of,
                   const std::vector<std::int32_t>& section_of)
    : node_of_(std::move(node_of)) {
  std::vector<std::int32_t> level(nodes, 0);
  for (const std::int32_t node : node_of_) level[static_cast<std::size_t>(node)] = -1;
  if (section_of.empty()) {
    spread(hexes, level);
  } else {
    take(hexes, section_of, level);
  }
  for (const std::int32_t node : node_of_) section_.push_back(level[static_cast<std::size_t>(node)] - 1);
  count_ = static_cast<std::size_t>(*std::max_element(level.begin(), level.end()));
}

// The section of a colour among an unknown's own and its neighbours, from 0; beyond the ends it is none's.
std::size_t Sections::neighbour(std::size_t unknown, std::size_t colour) const {
  const auto own = static_cast<std::size_t>(section_[unknown]);
  return (colour + 4 - own % 3) % 3;  // own - 1 + what is returned has the colour
}

void Sections::place_arms(const std::vector<double>& position) {
  std::vector<Eigen::Vector3d> middle(count_, Eigen::Vector3d::Zero());
  std::vector<double> members(count_, 0.0);
  arm_.resize(node_of_.size());
  for (std::size_t u = 0; u < node_of_.size(); ++u) {
    arm_[u] = Eigen::Map<const Eigen::Vector3d>(position.data() + kStride * static_cast<std::size_t>(node_of_[u]));
    middle[static_cast<std::size_t>(section_[u])] += arm_[u];
    members[static_cast<std::size_t>(section_[u])] += 1.0;
  }
  for (std::size_t u = 0; u < arm_.size(); ++u) {
    const auto own = static_cast<std::size_t>(section_[u]);
    arm_[u] -= middle[own] / members[own];
  }
}

bool Sections::measure(const std::vector<double>& position, double step, const Forces& forces) {
  place_arms(position);
  const std::size_t size = node_of_.size();
  std::vector<double> here, there, moved;
  forces(position, here);
  tangent_.assign(size * kReach * kLanes, 0.0F);
  std::vector<std::array<Matrix6, 3>> blocks(count_, {Matrix6::Zero(), Matrix6::Zero(), Matrix6::Zero()});
  for (std::size_t colour = 0; colour < 3; ++colour) {
    for (int motion = 0; motion < 6; ++motion) {
      moved = position;
      const Eigen::Vector3d along =
          motion < 3 ? Eigen::Vector3d(step * Eigen::Vector3d::Unit(motion)) : Eigen::Vector3d::Zero();
      const Eigen::Vector3d about =
          motion < 3 ? Eigen::Vector3d::Zero() : Eigen::Vector3d(step * Eigen::Vector3d::Unit(motion - 3));
      for (std::size_t u = 0; u < size; ++u) {
        if (static_cast<std::size_t>(section_[u]) % 3 != colour) continue;
        Eigen::Map<Eigen::Vector3d>(moved.data() + kStride * static_cast<std::size_t>(node_of_[u])) +=
            along + about.cross(arm_[u]);
      }
      forces(moved, there);
      for (std::size_t u = 0; u < size; ++u) {
        const std::size_t beside = neighbour(u, colour);
        const auto own = static_cast<std::size_t>(section_[u]);
        if (own + beside < 1 || own + beside > count_) continue;
        const Eigen::Vector3d stiffness = Eigen::Vector3d(here[u] - there[u], here[size + u] - there[size + u],
                                                          here[2 * size + u] - there[2 * size + u]) /
                                          step;
        float* row = tangent_.data() + (u * kReach + 6 * beside + static_cast<std::size_t>(motion)) * kLanes;
        for (int axis = 0; axis < 3; ++axis) row[axis] = static_cast<float>(stiffness[axis]);
        blocks[own][beside].col(motion).head<3>() += stiffness;
        blocks[own][beside].col(motion).tail<3>() += arm_[u].cross(stiffness);
      }
    }
  }
  reach_.resize(0, 0), answer_.resize(0, 0);
  return factor(std::move(blocks));
}

// By Woodbury's formula: the coupling reaches far, but few.
bool Sections::couple(const Eigen::MatrixXd& reach, const Eigen::MatrixXd& stiffness) {
  reach_ = reach;
  Eigen::MatrixXd blocks = reach;
  solve_blocks(blocks);
  const Eigen::MatrixXd small =
      Eigen::MatrixXd::Identity(reach.cols(), reach.cols()) + reach.transpose() * blocks * stiffness;
  answer_ = blocks * stiffness * small.inverse();
  return answer_.allFinite();
}

bool Sections::factor(std::vector<std::array<Matrix6, 3>> blocks) {
  diagonal_.clear(), lower_.clear(), upper_.clear();
  for (std::size_t s = 0; s < count_; ++s) {
    Matrix6 diagonal = blocks[s][1];
    if (s > 0) diagonal -= blocks[s][0] * upper_.back();
    diagonal_.emplace_back(diagonal);
    lower_.push_back(blocks[s][0]);
    upper_.push_back(diagonal_.back().solve(blocks[s][2]));
    if (!upper_.back().allFinite() || !(diagonal_.back().rcond() > kMinCondition)) return false;
  }
  return true;
}

Eigen::VectorXd Sections::restricted(const std::vector<double>& residual) const {
  const std::size_t size = node_of_.size();
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(6 * count_));
  for (std::size_t u = 0; u < size; ++u) add_force(u, {residual[u], residual[size + u], residual[2 * size + u]}, sum);
  return sum;
}

void Sections::add_force(std::size_t unknown, const Eigen::Vector3d& force, Eigen::Ref<Eigen::VectorXd> sum) const {
  const auto first = Eigen::Index{6} * section_[unknown];
  sum.segment<3>(first) += force;
  sum.segment<3>(first + 3) += arm_[unknown].cross(force);
}

void Sections::solve(Eigen::MatrixXd& right) const {
  solve_blocks(right);
  if (reach_.cols() > 0) right -= answer_ * (reach_.transpose() * right).eval();
}

void Sections::solve_blocks(Eigen::MatrixXd& right) const {
  const auto rows = [&](std::size_t s) { return right.middleRows(static_cast<Eigen::Index>(6 * s), 6); };
  for (std::size_t s = 0; s < count_; ++s) {
    if (s > 0) rows(s) -= lower_[s] * rows(s - 1);
    rows(s) = diagonal_[s].solve(rows(s)).eval();
  }
  for (std::size_t s = count_ - 1; s-- > 0;) rows(s) -= upper_[s] * rows(s + 1);
}

double Sections::largest_turn(const Eigen::VectorXd& amounts) const {
  double largest = 0.0;
  for (std::size_t s = 0; s < count_; ++s)
    largest = std::max(largest, amounts.segment<3>(static_cast<Eigen::Index>(6 * s + 3)).norm());
  return largest;
}

void Sections::move(const Eigen::VectorXd& amounts, std::vector<double>& motion, std::vector<double>& residual) const {
  const std::size_t size = node_of_.size();
  // an empty section before the first and after the last
  std::vector<float> near(6 * (count_ + 2), 0.0F);
  std::transform(amounts.data(), amounts.data() + amounts.size(), near.begin() + 6,
                 [](double a) { return static_cast<float>(a); });
  for (std::size_t u = 0; u < size; ++u) {
    const auto own = static_cast<std::size_t>(section_[u]);
    const Eigen::Vector3d turn = amounts.segment<3>(static_cast<Eigen::Index>(6 * own) + 3);
    const Eigen::Vector3d by = amounts.segment<3>(static_cast<Eigen::Index>(6 * own)) + turn.cross(arm_[u]);
    std::array<float, kLanes> answer{};
    const float* row = tangent_.data() + u * kReach * kLanes;
    for (std::size_t j = 0; j < kReach; ++j) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) answer[lane] += near[6 * own + j] * row[j * kLanes + lane];
    }
    for (std::size_t axis = 0; axis < 3; ++axis) {
      motion[axis * size + u] = by[static_cast<Eigen::Index>(axis)];
      residual[axis * size + u] -= static_cast<double>(answer[axis]);
    }
  }
}

}  // namespace softgrip::gdfe
