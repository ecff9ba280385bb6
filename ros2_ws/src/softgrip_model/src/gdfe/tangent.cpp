// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/tangent.hpp"

#include <algorithm>
#include <array>
#include <limits>

namespace softgrip::gdfe {
namespace {

// A factor is worth its cost as long as an iteration leaves less than this of the residual.
constexpr double kShrinks = 0.5;
// Iterations with the constant matrix where the tangent is not positive definite.
constexpr int kWait = 20;

}  // namespace

bool Tangent::is_fit_for(const Problem& problem, const Settings& settings, const Unknowns& unknowns) {
  const Surroundings& around = problem.surroundings;
  return settings.law == Law::Rigorous && settings.sections_after < 0 && problem.cables.empty() &&
         around.pressed.empty() && around.followers.empty() && around.obstacles.empty() && unknowns.count > 0 &&
         unknowns.count <= static_cast<std::size_t>(std::max(0, settings.max_tangent_unknowns));
}

Tangent::Tangent(const Problem& problem, const Unknowns& unknowns, const ForceAssembly& forces)
    : hexes_(problem.hexes), unknowns_(unknowns), forces_(forces) {}

void Tangent::restart() {
  is_usable_ = false;
  wait_ = 0;
  last_residual_ = std::numeric_limits<double>::infinity();
}

bool Tangent::follow(double residual) {
  const bool is_slow = residual > kShrinks * last_residual_;
  last_residual_ = residual;
  if (wait_ > 0) {
    --wait_;
    return false;
  }
  if (is_usable_ && !is_slow) return false;
  const bool was_usable = is_usable_;
  is_usable_ = factorise() && factor_.vectorD().minCoeff() > 0.0;
  if (!is_usable_) wait_ = kWait;
  return is_usable_ || was_usable;
}

void Tangent::apply(std::vector<double>& residual) const {
  Eigen::Map<Eigen::VectorXd> values(residual.data(), static_cast<Eigen::Index>(unknowns_.count));
  values = factor_.solve(values).eval();
}

int Tangent::count_unstable_modes() {
  is_usable_ = false;
  if (!factorise()) return -1;
  return static_cast<int>((factor_.vectorD().array() < 0.0).count());
}

bool Tangent::factorise() {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<std::size_t>(hexes_.rows()) * 300);
  for (Eigen::Index e = 0; e < hexes_.rows(); ++e) {
    std::array<Eigen::Index, 24> place{};
    for (int c = 0; c < 8; ++c) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const AxisUnknowns& a = unknowns_.axes[axis];
        const std::int32_t dof = a.dof[static_cast<std::size_t>(hexes_(e, c))];
        place[3 * static_cast<std::size_t>(c) + axis] = dof < 0 ? -1 : static_cast<Eigen::Index>(a.offset) + dof;
      }
    }
    const ElementTangent tangent = forces_.element_tangent(static_cast<std::size_t>(e));
    if (!tangent.allFinite()) return false;
    for (std::size_t i = 0; i < 24; ++i) {
      for (std::size_t j = 0; j < 24; ++j) {
        if (place[j] < 0 || place[i] < place[j]) continue;
        entries.emplace_back(place[i], place[j], tangent(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)));
      }
    }
  }
  const auto size = static_cast<Eigen::Index>(unknowns_.count);
  matrix_.resize(size, size);
  matrix_.setFromTriplets(entries.begin(), entries.end());
  if (!has_pattern_) factor_.analyzePattern(matrix_);
  has_pattern_ = true;
  factor_.factorize(matrix_);
  return factor_.info() == Eigen::Success;
}

}  // namespace softgrip::gdfe
