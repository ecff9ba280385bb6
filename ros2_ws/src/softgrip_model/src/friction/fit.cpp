// SPDX-License-Identifier: Apache-2.0
#include "fit.hpp"

#include <algorithm>
#include <vector>

namespace softgrip::friction {
namespace {

constexpr int kMaxIterations = 200;
constexpr double kFirstDamping = 1e-3;
constexpr double kMaxDamping = 1e14;
constexpr double kStepTolerance = 1e-11;
// n and lambda trade off (correlation 0.75-0.86, finger.md), so the ladder is denser where cables lie.
constexpr std::array<double, 7> kLadderOfN = {0.05, 0.25, 0.45, 0.60, 0.75, 0.88, 0.97};

// Surface term at the highest load above which no kink is near: three standard deviations of a nine-point fit.
constexpr double kNoKinkAbove = 0.05;
// Offset of epsilon to either side of a kink.
constexpr double kBesideKink = 0.005;
// More loads than any rig has: continuous data have no kinks worth searching one by one.
constexpr std::size_t kMaxKinks = 16;

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxCoefficients, kMaxCoefficients>;
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxCoefficients, 1>;

struct NormalEquations {
  double cost = std::numeric_limits<double>::infinity();
  Matrix hessian;   // J^T J
  Vector gradient;  // J^T r
};

NormalEquations assemble(const Model& model, const Data& data, Loss loss) {
  const int count = coefficient_count(model.law);
  NormalEquations normal{0.0, Matrix::Zero(count, count), Vector::Zero(count)};
  for (Eigen::Index i = 0; i < data.size(); ++i) {
    const Evaluation value = evaluate(model, data.angle_rad[i], data.tension_N[i]);
    if (!value.has_value()) return {std::numeric_limits<double>::infinity(), {}, {}};
    const bool relative = loss == Loss::Relative;
    const double gain = data.weight[i] * (relative ? 1.0 : value.ratio());
    const double residual =
        data.weight[i] * (relative ? value.log_ratio - std::log(data.ratio[i]) : value.ratio() - data.ratio[i]);
    const Vector row = gain * Eigen::Map<const Eigen::VectorXd>(value.d_coefficients.data(), count);
    normal.cost += 0.5 * residual * residual;
    normal.hessian += row * row.transpose();
    normal.gradient += residual * row;
  }
  return normal;
}

// Damped Gauss-Newton step; coefficients that a bound holds back stay where they are.
Vector damped_step(const NormalEquations& normal, double damping, const Vector& at, const Bounds& bounds) {
  Matrix system = normal.hessian;
  Vector right = -normal.gradient;
  for (Eigen::Index i = 0; i < at.size(); ++i) {
    system(i, i) += damping * std::max(normal.hessian(i, i), 1e-12);
    const bool held = (at[i] <= bounds.lower[i] && right[i] < 0.0) || (at[i] >= bounds.upper[i] && right[i] > 0.0);
    if (held) {
      system.row(i).setZero();
      system.col(i).setZero();
      system(i, i) = 1.0;
      right[i] = 0.0;
    }
  }
  return system.ldlt().solve(right);
}

// Damped Gauss-Newton step within the span of a basis.
Vector step_within(const NormalEquations& normal, double damping, const Matrix& basis) {
  Matrix system = basis.transpose() * normal.hessian * basis;
  system.diagonal() += damping * system.diagonal().cwiseMax(1e-12);
  return basis * system.ldlt().solve(-basis.transpose() * normal.gradient);
}

// Linear least squares of ln Rf for (alpha, epsilon, lambda) in the K -> 0 law with n fixed.
Coefficients linear_start(const Model& model, const Data& data, double n) {
  const bool matte = model.law == Law::Matte;
  const double m = 1.0 - n;
  Eigen::Matrix3d system = Eigen::Matrix3d::Identity() * 1e-9;
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (Eigen::Index i = 0; i < data.size(); ++i) {
    const double log_tension = std::log(std::max(data.tension_N[i], kTensionFloor_N));
    const double slope = std::exp(m * (std::log(model.radius_mm) - log_tension)) * data.angle_rad[i];
    const Eigen::Vector3d row(slope, matte ? 1.0 : 0.0, matte ? -log_tension : 0.0);
    system += row * row.transpose();
    right += std::log(data.ratio[i]) * row;
  }
  const Eigen::Vector3d solution = system.ldlt().solve(right);
  return {solution[0], n, solution[1], solution[2]};
}

Coefficients capstan_start(const Data& data) {
  const double square = data.angle_rad.squaredNorm();
  return {square > 0.0 ? data.angle_rad.dot(data.ratio.array().log().matrix()) / square : 0.0, 0.0, 0.0, 0.0};
}

Vector clamp(const Vector& value, const Bounds& bounds) {
  Vector out = value;
  for (Eigen::Index i = 0; i < value.size(); ++i) out[i] = std::clamp(value[i], bounds.lower[i], bounds.upper[i]);
  return out;
}

Model with_coefficients(const Model& model, const Vector& coefficients) {
  Model out = model;
  std::copy(coefficients.begin(), coefficients.end(), out.coefficients.begin());
  return out;
}

Fit descend(const Model& model, const Data& data, Loss loss, const Bounds& bounds, const Coefficients& start,
            const Matrix* basis) {
  const int count = coefficient_count(model.law);
  Vector at = clamp(Eigen::Map<const Eigen::VectorXd>(start.data(), count), bounds);
  NormalEquations normal = assemble(with_coefficients(model, at), data, loss);
  Fit out;
  double damping = kFirstDamping;
  while (std::isfinite(normal.cost) && !out.converged && out.iterations < kMaxIterations && damping < kMaxDamping) {
    ++out.iterations;
    const Vector step = basis ? step_within(normal, damping, *basis) : damped_step(normal, damping, at, bounds);
    const Vector candidate = clamp(at + step, bounds);
    const bool small_step = (candidate - at).norm() <= kStepTolerance * (1.0 + at.norm());
    const NormalEquations next = assemble(with_coefficients(model, candidate), data, loss);
    if (next.cost < normal.cost) {
      at = candidate;
      normal = next;
      damping = std::max(damping * 0.2, 1e-12);
    } else {
      damping *= 5.0;
    }
    out.converged = small_step;
  }
  std::copy(at.begin(), at.end(), out.coefficients.begin());
  out.cost = normal.cost;
  return out;
}

void keep_better(Fit& best, const Fit& candidate) {
  if (candidate.cost < best.cost) best = candidate;
}

std::vector<double> distinct_log_tensions(const Data& data) {
  std::vector<double> logs;
  logs.reserve(static_cast<std::size_t>(data.size()));
  for (Eigen::Index i = 0; i < data.size(); ++i) logs.push_back(std::log(std::max(data.tension_N[i], kTensionFloor_N)));
  std::sort(logs.begin(), logs.end());
  const auto same = [](double a, double b) { return b - a < 0.01; };
  logs.erase(std::unique(logs.begin(), logs.end(), same), logs.end());
  return logs;
}

// Where the surface term vanishes among the measured loads the cost has a kink at each of them, and minima on and
// between the kinks: look along each kink (epsilon = lambda ln T), then to both sides of it.
void search_kinks(const Model& model, const Data& data, Loss loss, const Bounds& bounds, Fit& best) {
  const std::vector<double> logs = distinct_log_tensions(data);
  const auto& found = best.coefficients;
  if (found[2] - found[3] * logs.back() > kNoKinkAbove || logs.size() > kMaxKinks) return;
  for (const double log_tension : logs) {
    const Eigen::Vector2d along = Eigen::Vector2d(log_tension, 1.0).normalized();
    Matrix basis = Matrix::Zero(4, 3);
    basis(0, 0) = basis(1, 1) = 1.0;
    basis.block<2, 1>(2, 2) = along;
    const double length = std::max(along.dot(Eigen::Vector2d(found[2], found[3])), 0.02);
    const Coefficients start = {found[0], found[1], length * along[0], length * along[1]};
    const Fit on_kink = descend(model, data, loss, bounds, start, &basis);
    keep_better(best, on_kink);
    for (const double side : {-kBesideKink, kBesideKink}) {
      Coefficients beside = on_kink.coefficients;
      beside[2] += side;
      keep_better(best, descend(model, data, loss, bounds, beside, nullptr));
    }
  }
}

}  // namespace

Fit fit_from(const Model& model, const Data& data, Loss loss, const Bounds& bounds, const Coefficients& start) {
  return descend(model, data, loss, bounds, start, nullptr);
}

Fit fit(const Model& model, const Data& data, Loss loss, const Bounds& bounds) {
  if (model.law == Law::Capstan) return fit_from(model, data, loss, bounds, capstan_start(data));
  Fit best;
  for (const double n : kLadderOfN)
    keep_better(best, fit_from(model, data, loss, bounds, linear_start(model, data, n)));
  if (model.law == Law::Matte && std::isfinite(best.cost)) search_kinks(model, data, loss, bounds, best);
  return best;
}

}  // namespace softgrip::friction
