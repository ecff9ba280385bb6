// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/aggregation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace softgrip::gdfe {
namespace {

// Neighbours within this many times the squared distance of the nearest one are near: all 26 of a brick whose edges
// differ by up to 1.5, the nearest layers only of flatter ones.
constexpr double kNear = 6.0;

// A row with this many times the average entries is one of tied nodes: an aggregate of its own.
constexpr double kTied = 4.0;

constexpr int kPowerSteps = 15;

using Entry = SparseMatrix::InnerIterator;

// The pattern of near neighbours, without the diagonal, in compressed rows.
struct Graph {
  std::vector<int> start, neighbour;
};

Graph near_neighbours(const SparseMatrix& matrix, const Eigen::MatrixX3d& places) {
  const int n = static_cast<int>(matrix.cols());
  const auto square = [&](int i, int j) { return (places.row(i) - places.row(j)).squaredNorm(); };
  const double tied = kTied * static_cast<double>(matrix.nonZeros()) / n;
  const auto is_tied = [&](int i) { return matrix.outerIndexPtr()[i + 1] - matrix.outerIndexPtr()[i] > tied; };
  std::vector<double> nearest(static_cast<std::size_t>(n), std::numeric_limits<double>::infinity());
  for (int i = 0; i < n; ++i) {
    for (Entry it(matrix, i); it; ++it) {
      if (it.row() != i && !is_tied(static_cast<int>(it.row())))
        nearest[i] = std::min(nearest[i], square(i, static_cast<int>(it.row())));
    }
  }
  Graph graph;
  graph.start.push_back(0);
  for (int i = 0; i < n; ++i) {
    for (Entry it(matrix, i); it && !is_tied(i); ++it) {
      const int j = static_cast<int>(it.row());
      if (j != i && !is_tied(j) && square(i, j) <= kNear * std::max(nearest[i], nearest[j]))
        graph.neighbour.push_back(j);
    }
    graph.start.push_back(static_cast<int>(graph.neighbour.size()));
  }
  return graph;
}

// Node -> aggregate, numbered from 0: a root and all its near neighbours, then what is left joins the nearest
// aggregate.
std::vector<int> aggregates(const Graph& graph, const Eigen::MatrixX3d& places, int& count) {
  const int n = static_cast<int>(graph.start.size()) - 1;
  std::vector<int> of(static_cast<std::size_t>(n), -1);
  const auto each = [&](int i, auto&& act) {
    for (int k = graph.start[i]; k < graph.start[i + 1]; ++k) act(graph.neighbour[k]);
  };
  count = 0;
  for (int i = 0; i < n; ++i) {
    bool free = of[i] < 0;
    each(i, [&](int j) { free = free && of[j] < 0; });
    if (!free) continue;
    of[i] = count;
    each(i, [&](int j) { of[j] = count; });
    ++count;
  }
  const std::vector<int> roots = of;
  for (int i = 0; i < n; ++i) {
    if (roots[i] >= 0) continue;
    double nearest = std::numeric_limits<double>::infinity();
    each(i, [&](int j) {
      const double distance = (places.row(i) - places.row(j)).squaredNorm();
      if (roots[j] >= 0 && distance < nearest) nearest = distance, of[i] = roots[j];
    });
  }
  for (int i = 0; i < n; ++i) {
    if (of[i] >= 0) continue;
    of[i] = count;
    each(i, [&](int j) {
      if (of[j] < 0) of[j] = count;
    });
    ++count;
  }
  return of;
}

}  // namespace

double largest_eigenvalue(const SparseMatrix& matrix) {
  const Eigen::Index n = matrix.rows();
  const Eigen::VectorXd inverse = matrix.diagonal().cwiseInverse();
  Eigen::VectorXd x(n);
  std::uint32_t state = 1;  // a fixed sequence that favours no frequency
  for (Eigen::Index i = 0; i < n; ++i) {
    state = state * 1664525u + 1013904223u;
    x(i) = static_cast<double>(state >> 8) / (1 << 24) - 0.5;
  }
  double eigenvalue = 0.0;
  for (int step = 0; step < kPowerSteps; ++step) {
    const Eigen::VectorXd y = inverse.cwiseProduct(matrix * x);
    eigenvalue = y.norm() / x.norm();
    x = y / y.norm();
  }
  return eigenvalue;
}

Coarsening coarsen(const SparseMatrix& matrix, const Eigen::MatrixX3d& places, double eigenvalue) {
  const int n = static_cast<int>(matrix.cols());
  const Graph graph = near_neighbours(matrix, places);
  int count = 0;
  const std::vector<int> of = aggregates(graph, places, count);

  Coarsening coarse;
  coarse.places = Eigen::MatrixX3d::Zero(count, 3);
  std::vector<double> members(static_cast<std::size_t>(count), 0.0);
  for (int i = 0; i < n; ++i) coarse.places.row(of[i]) += places.row(i), members[of[i]] += 1.0;
  for (int a = 0; a < count; ++a) coarse.places.row(a) /= members[a];

  // P = (I - w D_F^-1 A_F) T: entries that are not near count towards the diagonal of A_F; column i of A is its row i
  const double damping = 4.0 / (3.0 * eigenvalue);
  std::vector<Eigen::Triplet<double>> entries;
  std::vector<double> weight(static_cast<std::size_t>(count), 0.0);
  std::vector<int> met;
  std::vector<char> near(static_cast<std::size_t>(n), 0);
  for (int i = 0; i < n; ++i) {
    for (int k = graph.start[i]; k < graph.start[i + 1]; ++k) near[graph.neighbour[k]] = 1;
    double diagonal = 0.0;
    for (Entry it(matrix, i); it; ++it) {
      const int j = static_cast<int>(it.row());
      if (!near[j]) diagonal += it.value();
    }
    if (diagonal <= 0.0) diagonal = matrix.coeff(i, i);
    const auto add = [&](int aggregate, double value) {
      if (weight[aggregate] == 0.0) met.push_back(aggregate);
      weight[aggregate] += value;
    };
    add(of[i], 1.0 - damping);
    for (Entry it(matrix, i); it; ++it) {
      const int j = static_cast<int>(it.row());
      if (near[j]) add(of[j], -damping * it.value() / diagonal);
    }
    for (const int a : met) {
      if (weight[a] != 0.0) entries.emplace_back(i, a, weight[a]);
      weight[a] = 0.0;
    }
    met.clear();
    for (int k = graph.start[i]; k < graph.start[i + 1]; ++k) near[graph.neighbour[k]] = 0;
  }
  coarse.prolongation.resize(n, count);
  coarse.prolongation.setFromTriplets(entries.begin(), entries.end());
  return coarse;
}

}  // namespace softgrip::gdfe
