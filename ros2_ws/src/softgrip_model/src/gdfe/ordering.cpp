// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/ordering.hpp"

#include <Eigen/OrderingMethods>
#include <algorithm>
#include <numeric>
#include <utility>

#ifdef SOFTGRIP_HAVE_METIS
#include <iostream>  // Eigen 3.4's MetisSupport uses it without including it

#include <Eigen/MetisSupport>
#endif

namespace softgrip::gdfe {
namespace {

using Indices = std::vector<int>;  // unknowns, in the order of elimination where they have one
using Entry = SparseMatrix::InnerIterator;

// Levels, counted as if full, may have this many times the entries of another order: their panels are wide, and two
// threads share them evenly.
constexpr double kLevelsWorth = 1.3;

template <class Ordering>
Indices order_by(const SparseMatrix& matrix) {
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Ordering()(matrix, permutation);
  return {permutation.indices().data(), permutation.indices().data() + permutation.indices().size()};
}

// Unknowns by their distance in the graph from one of them; what is not connected comes last.
std::vector<Indices> levels_from(const SparseMatrix& matrix, int start) {
  std::vector<char> met(static_cast<std::size_t>(matrix.cols()), 0);
  std::vector<Indices> levels{{start}};
  met[static_cast<std::size_t>(start)] = 1;
  while (true) {
    Indices next;
    for (const int j : levels.back()) {
      for (Entry it(matrix, j); it; ++it) {
        char& seen = met[static_cast<std::size_t>(it.row())];
        if (!seen) next.push_back(static_cast<int>(it.row()));
        seen = 1;
      }
    }
    if (next.empty()) break;
    levels.push_back(std::move(next));
  }
  Indices apart;
  for (int j = 0; j < matrix.cols(); ++j) {
    if (!met[static_cast<std::size_t>(j)]) apart.push_back(j);
  }
  if (!apart.empty()) levels.push_back(std::move(apart));
  return levels;
}

// Levels from both ends of the mesh to its middle: least fill where it is slender.
Indices towards_middle(const std::vector<Indices>& levels, std::size_t size) {
  Indices order;
  std::size_t middle = 0;
  for (; middle < levels.size() && 2 * (order.size() + levels[middle].size()) <= size; ++middle) {
    order.insert(order.end(), levels[middle].begin(), levels[middle].end());
  }
  for (std::size_t k = levels.size(); k-- > middle;) order.insert(order.end(), levels[k].begin(), levels[k].end());
  return order;
}

// Entries of the factor by levels, each of them full.
double entries_by_levels(const std::vector<Indices>& levels) {
  double entries = 0.0;
  for (std::size_t k = 0; k < levels.size(); ++k) {
    const auto own = static_cast<double>(levels[k].size()),
               next = k + 1 < levels.size() ? static_cast<double>(levels[k + 1].size()) : 0.0;
    entries += own * (0.5 * own + next);
  }
  return entries;
}

Indices places_of(const Indices& order) {
  Indices place(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) place[static_cast<std::size_t>(order[k])] = static_cast<int>(k);
  return place;
}

// Elimination tree of a matrix in an order (Liu 1986) and the entries below the diagonal of every column of its factor.
struct Tree {
  Indices parent, count;
};

Tree elimination_tree(const SparseMatrix& matrix, const Indices& order) {
  const std::size_t n = order.size();
  const Indices place = places_of(order);
  Indices root(n, -1), met(n, -1);
  Tree tree{Indices(n, -1), Indices(n, 0)};
  for (int k = 0; k < static_cast<int>(n); ++k) {
    for (Entry it(matrix, order[static_cast<std::size_t>(k)]); it; ++it) {
      for (int i = place[static_cast<std::size_t>(it.row())]; i < k && i >= 0;) {
        const int above = std::exchange(root[static_cast<std::size_t>(i)], k);
        if (above < 0) tree.parent[static_cast<std::size_t>(i)] = k;
        i = above;
      }
    }
  }
  for (int k = 0; k < static_cast<int>(n); ++k) {
    met[static_cast<std::size_t>(k)] = k;
    for (Entry it(matrix, order[static_cast<std::size_t>(k)]); it; ++it) {
      for (int i = place[static_cast<std::size_t>(it.row())]; i < k && met[static_cast<std::size_t>(i)] != k;
           i = tree.parent[static_cast<std::size_t>(i)]) {
        met[static_cast<std::size_t>(i)] = k;
        ++tree.count[static_cast<std::size_t>(i)];
      }
    }
  }
  return tree;
}

// Places in a tree, in another order of the same fill: each subtree in one piece, and before every column the child
// that has most rows in common with it.
Indices postorder(const Tree& tree) {
  const std::size_t n = tree.parent.size();
  std::vector<Indices> children(n + 1);
  for (std::size_t k = 0; k < n; ++k)
    children[tree.parent[k] < 0 ? n : static_cast<std::size_t>(tree.parent[k])].push_back(static_cast<int>(k));
  for (Indices& all : children) {
    std::stable_sort(all.begin(), all.end(), [&](int a, int b) {
      return tree.count[static_cast<std::size_t>(a)] > tree.count[static_cast<std::size_t>(b)];
    });
  }
  Indices reversed, waiting(children[n].rbegin(), children[n].rend());
  while (!waiting.empty()) {  // a parent, its last child, that one's children, ...: backwards
    const int k = waiting.back();
    waiting.pop_back();
    reversed.push_back(k);
    const Indices& own = children[static_cast<std::size_t>(k)];
    waiting.insert(waiting.end(), own.rbegin(), own.rend());
  }
  std::reverse(reversed.begin(), reversed.end());
  return reversed;
}

Indices min_fill_ordering(const SparseMatrix& matrix, bool metis) {
#ifdef SOFTGRIP_HAVE_METIS
  if (metis) {
    Indices order;
#pragma omp critical(metis)  // its random numbers are those of the process: two at a time would disturb each other
    order = order_by<Eigen::MetisOrdering<int>>(matrix);
    return order;
  }
#else
  (void)metis;
#endif
  return order_by<Eigen::AMDOrdering<int>>(matrix);
}

}  // namespace

Elimination eliminate(const SparseMatrix& matrix, bool metis) {
  const int one_end = levels_from(matrix, 0).back().front();
  // from the opposite end: unknowns keep their direction, and threads the half of the mesh that is theirs elsewhere
  const std::vector<Indices> levels = levels_from(matrix, levels_from(matrix, one_end).back().front());
  const auto size = static_cast<std::size_t>(matrix.cols());
  Indices order;
  Tree tree;
  // with more levels than a level has unknowns no order fills in much less, and to ask for one takes longer than to
  // factor
  bool slender = levels.size() * levels.size() >= size;
  if (!slender) {
    order = min_fill_ordering(matrix, metis);
    tree = elimination_tree(matrix, order);
    const double entries = std::accumulate(tree.count.begin(), tree.count.end(), static_cast<double>(size));
    slender = entries_by_levels(levels) <= kLevelsWorth * entries;
  }
  if (slender) {
    order = towards_middle(levels, size);
    tree = elimination_tree(matrix, order);
  }
  const Indices sequence = postorder(tree), moved = places_of(sequence);
  Elimination found{Indices(size), Indices(size), Indices(size)};
  for (std::size_t k = 0; k < size; ++k) {
    const auto before = static_cast<std::size_t>(sequence[k]);
    found.position[static_cast<std::size_t>(order[before])] = static_cast<int>(k);
    found.parent[k] = tree.parent[before] < 0 ? -1 : moved[static_cast<std::size_t>(tree.parent[before])];
    found.count[k] = tree.count[before];
  }
  return found;
}

}  // namespace softgrip::gdfe
