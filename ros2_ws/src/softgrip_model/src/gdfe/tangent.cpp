// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/tangent.hpp"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace softgrip::gdfe {
namespace {

// A factor is worth its cost as long as an iteration leaves less than this of the residual.
constexpr double kShrinks = 0.5;
// A step that leaves so many times the residual before, or the reactions, has left where the tangent holds.
constexpr double kOvershot = 30.0;
// Iterations with the constant matrix where the tangent is not positive definite or has overshot; fewer once they have
// left this share of the residual: often it is a start's short waves alone that spoil it.
constexpr int kWait = 20;
constexpr double kSmoothed = 0.1;
// Iterations that cross-sections have first: nearer to nu = 0.3 they are through by then, each at a tenth of a factor's
// cost.
constexpr int kAfterSections = 60;

// A matrix whose zeros count as entries, so that what is made of it has the same pattern whatever its values.
SparseMatrix with_zeros(const Eigen::MatrixXd& values) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<std::size_t>(values.size()));
  for (Eigen::Index j = 0; j < values.cols(); ++j) {
    for (Eigen::Index i = 0; i < values.rows(); ++i) entries.emplace_back(i, j, values(i, j));
  }
  SparseMatrix found(values.rows(), values.cols());
  found.setFromTriplets(entries.begin(), entries.end());
  return found;
}

}  // namespace

bool Tangent::is_fit_for(const Problem& problem, const Settings& settings, const Unknowns& unknowns) {
  const Surroundings& around = problem.surroundings;
  return settings.law == Law::Rigorous && around.pressed.empty() && around.followers.empty() &&
         around.obstacles.empty() && unknowns.count > 0 &&
         unknowns.count <= static_cast<std::size_t>(std::max(0, settings.max_tangent_unknowns));
}

Tangent::Tangent(const Problem& problem, const Settings& settings, const Unknowns& unknowns,
                 const ForceAssembly& forces, const CableSystem& cables)
    : hexes_(problem.hexes),
      unknowns_(unknowns),
      forces_(forces),
      cables_(cables),
      reach_(cables.point_reach()),
      first_iteration_(settings.sections_after < 0 ? 0 : kAfterSections) {}

void Tangent::restart() {
  is_usable_ = false;
  wait_ = 0;
  last_residual_ = std::numeric_limits<double>::infinity();
}

bool Tangent::follow(int k, double residual, const Task& task, const std::vector<double>& x) {
  if (k < first_iteration_) return false;
  const bool is_slow = residual > kShrinks * last_residual_;
  last_residual_ = residual;
  if (wait_ > 0 && residual > kSmoothed * refused_residual_) {
    --wait_;
    return false;
  }
  if (is_usable_ && !is_slow) return false;
  const bool was_usable = is_usable_;
  is_usable_ = factorise(task, x);
  if (!is_usable_) refuse(residual);
  return is_usable_ || was_usable;
}

bool Tangent::has_overshot(double residual, bool is_sound) {
  if (!is_usable_ || (is_sound && residual <= kOvershot * std::max(1.0, last_residual_))) return false;
  refuse(last_residual_);
  return true;
}

void Tangent::refuse(double residual) {
  is_usable_ = false;
  wait_ = kWait;
  refused_residual_ = residual;
}

void Tangent::apply(std::vector<double>& residual) const {
  Eigen::Map<Eigen::VectorXd> values(residual.data(), static_cast<Eigen::Index>(unknowns_.count));
  factor_.solve(values);
  if (reach_.cols() == 0) return;
  const Eigen::VectorXd held = coupling_.solve(unsymmetric_ * (reach_.transpose() * values));
  values -= columns_ * held;
}

Eigen::VectorXd Tangent::answer(std::size_t cable, const Eigen::Matrix3Xd& force) const {
  Eigen::VectorXd amounts = Eigen::VectorXd::Zero(reach_.cols());
  amounts.segment(3 * static_cast<Eigen::Index>(cables_.first_point(cable)), force.size()) = force.reshaped();
  amounts -= coupling_.solve(unsymmetric_ * (point_answer_ * amounts));
  return columns_ * amounts;
}

int Tangent::count_unstable_modes(const Task& task, const std::vector<double>& x) {
  is_usable_ = false;
  if (cables_.count() > 0 || !assemble(task, x)) return -1;
  const Eigen::SimplicialLDLT<SparseMatrix> factor(matrix_);
  return factor.info() == Eigen::Success ? static_cast<int>((factor.vectorD().array() < 0.0).count()) : -1;
}

bool Tangent::factorise(const Task& task, const std::vector<double>& x) {
  if (!assemble(task, x) || !factor_.factorise(matrix_)) return false;
  if (reach_.cols() == 0) return true;
  columns_ = reach_;
  factor_.solve(columns_);
  point_answer_ = reach_.transpose() * columns_;
  coupling_.compute(Eigen::MatrixXd::Identity(reach_.cols(), reach_.cols()) + unsymmetric_ * point_answer_);
  return columns_.allFinite();
}

// B and N; returns whether they have values.
bool Tangent::assemble(const Task& task, const std::vector<double>& x) {
  const std::vector<Eigen::Triplet<double>> entries = element_entries();
  const Eigen::MatrixXd stiffness = cable_stiffness(task, x);
  const bool is_finite =
      std::all_of(entries.begin(), entries.end(), [](const auto& e) { return std::isfinite(e.value()); });
  if (!is_finite || !stiffness.allFinite()) return false;
  const auto size = static_cast<Eigen::Index>(unknowns_.count);
  matrix_.resize(size, size);
  matrix_.setFromTriplets(entries.begin(), entries.end());
  if (stiffness.size() == 0) return true;
  const SparseMatrix symmetric = with_zeros(0.5 * (stiffness + stiffness.transpose()));
  matrix_ += SparseMatrix(reach_ * symmetric * reach_.transpose());
  unsymmetric_ = 0.5 * (stiffness - stiffness.transpose());
  return true;
}

// Those of K.
std::vector<Eigen::Triplet<double>> Tangent::element_entries() const {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<std::size_t>(hexes_.rows()) * 576);
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
    for (std::size_t i = 0; i < 24; ++i) {
      for (std::size_t j = 0; j < 24; ++j) {
        if (place[i] < 0 || place[j] < 0) continue;
        entries.emplace_back(place[i], place[j], tangent(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)));
      }
    }
  }
  return entries;
}

// S of all cables.
Eigen::MatrixXd Tangent::cable_stiffness(const Task& task, const std::vector<double>& x) const {
  Eigen::MatrixXd stiffness = Eigen::MatrixXd::Zero(reach_.cols(), reach_.cols());
  for (std::size_t c = 0; c < cables_.count(); ++c) {
    const Eigen::MatrixXd of_cable = cables_.stiffness(task, x, c);
    const auto first = 3 * static_cast<Eigen::Index>(cables_.first_point(c));
    stiffness.block(first, first, of_cable.rows(), of_cable.cols()) = of_cable;
  }
  return stiffness;
}

}  // namespace softgrip::gdfe
