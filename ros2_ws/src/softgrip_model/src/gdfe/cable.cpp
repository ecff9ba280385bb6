// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/cable.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::gdfe {
namespace {

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

}  // namespace

CableState pull_from_anchor(const Cable& cable, const std::vector<Eigen::Vector3d>& points, double anchor_tension) {
  const std::size_t count = points.size();
  const bool entry = cable.entry.squaredNorm() > 0.0;
  CableState state;
  state.force.assign(count, Eigen::Vector3d::Zero());
  state.slope.assign(count, Eigen::Vector3d::Zero());
  std::vector<Eigen::Vector3d> direction(count - 1);
  for (std::size_t k = 0; k + 1 < count; ++k) {
    const Eigen::Vector3d span = points[k + 1] - points[k];
    const double length = span.norm();
    state.length += length;
    direction[k] = length > 0.0 ? Eigen::Vector3d(span / length) : Eigen::Vector3d::Zero();
    state.slope[k] -= direction[k];
    state.slope[k + 1] += direction[k];
  }
  if (entry) {
    state.slope[0] -= cable.entry;
    state.entry_length = -cable.entry.dot(points[0]);
  }
  double tension = anchor_tension;
  state.tension.push_back(tension);
  for (std::size_t k = count - 1; k-- > 0;) {
    state.force[k] += tension * direction[k];
    state.force[k + 1] -= tension * direction[k];
    if (k == 0 && !entry) break;
    const Eigen::Vector3d before = k > 0 ? direction[k - 1] : Eigen::Vector3d(-cable.entry);
    const auto value = friction::evaluate(cable.friction, angle_between(before, direction[k]),
                                          std::max(tension, friction::kTensionFloor_N));
    if (!value.has_value()) {
      state.sound = false;
      return state;
    }
    tension *= value.ratio();
    state.tension.push_back(tension);
  }
  if (entry) state.force[0] += tension * cable.entry;
  std::reverse(state.tension.begin(), state.tension.end());
  return state;
}

CableState pull_from_actuator(const Cable& cable, const std::vector<Eigen::Vector3d>& points, double tension) {
  double anchor = tension;
  CableState state = pull_from_anchor(cable, points, anchor);
  // Rf falls slowly with tension, so the fixed point contracts well
  for (int iteration = 0; iteration < 60 && state.sound; ++iteration) {
    const double got = state.tension.front();
    if (std::abs(got - tension) <= 1e-13 * tension || got <= 0.0) break;
    anchor *= tension / got;
    state = pull_from_anchor(cable, points, anchor);
  }
  return state;
}

}  // namespace softgrip::gdfe
