// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/factor.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <limits>
#include <numeric>
#include <stdexcept>

#include "src/gdfe/ordering.hpp"
#include "src/gdfe/panel_solve.hpp"

namespace softgrip::gdfe {
namespace {

// position: unknown -> its place.
SparseMatrix lower_factor(const SparseMatrix& matrix, const std::vector<int>& position) {
  using Permutation = Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int>;
  const Permutation order(Eigen::Map<const Eigen::VectorXi>(position.data(), matrix.cols()));
  SparseMatrix ordered;
  ordered = matrix.twistedBy(order);
  const Eigen::SimplicialLLT<SparseMatrix, Eigen::Lower, Eigen::NaturalOrdering<int>> solver(ordered);
  if (solver.info() != Eigen::Success) {
    throw std::runtime_error("the constant matrix is not positive definite: some part of the mesh is not held");
  }
  SparseMatrix lower = solver.matrixL();
  lower.makeCompressed();
  return lower;
}

// Widest panel, and how much of it may be zeros that the sparse factor does not have.
constexpr int kMaxWidth = 48;
constexpr double kZeroShare = 0.3;
constexpr int kAlwaysMergeBelow = 8;

struct Run {
  int first, last;
};

// Neighbouring columns j, j+1 with parent(j) = j+1 join while few zeros come in.
std::vector<Run> supernodes(const SparseMatrix& lower) {
  const int n = static_cast<int>(lower.cols());
  const int* outer = lower.outerIndexPtr();
  const int* inner = lower.innerIndexPtr();
  const auto below = [&](int j) { return outer[j + 1] - outer[j] - 1; };
  std::vector<Run> runs;
  int first = 0;
  double entries = 0.0;
  for (int j = 0; j < n; ++j) {
    entries += below(j) + 1;
    const bool follows = j + 1 < n && below(j) > 0 && inner[outer[j] + 1] == j + 1;
    bool join = follows && j + 1 - first < kMaxWidth;
    if (join) {
      const int width = j + 2 - first;
      const double dense = 0.5 * width * (width + 1) + static_cast<double>(width) * below(j + 1);
      join = width <= kAlwaysMergeBelow || dense - (entries + below(j + 1) + 1) <= kZeroShare * dense;
    }
    if (!join) {
      runs.push_back({first, j});
      first = j + 1;
      entries = 0.0;
    }
  }
  return runs;
}

double own_work(const Panel& panel) { return static_cast<double>(panel.width) * (panel.padded + panel.width); }

// Subtrees, heaviest first, each to the thread that has least so far.
std::vector<int> dealt(const std::vector<int>& subtrees, const std::vector<double>& work, int threads, std::vector<double>& load) {
  load.assign(static_cast<std::size_t>(threads), 0.0);
  std::vector<int> owner;
  for (const int p : subtrees) {
    const auto least = std::min_element(load.begin(), load.end());
    owner.push_back(static_cast<int>(least - load.begin()));
    *least += work[p];
  }
  return owner;
}

// Threads numbered by where their subtrees are on average: elsewhere the first thread has the first unknowns, too.
void number_by_place(std::vector<int>& owner, const std::vector<int>& subtrees, const std::vector<double>& work, int threads) {
  std::vector<double> place(static_cast<std::size_t>(threads), 0.0), load(place);
  for (std::size_t k = 0; k < subtrees.size(); ++k) {
    place[owner[k]] += work[subtrees[k]] * subtrees[k];
    load[owner[k]] += work[subtrees[k]];
  }
  std::vector<int> order(static_cast<std::size_t>(threads)), number(order);
  std::iota(order.begin(), order.end(), 0);
  const auto mean = [&](int t) { return load[t] > 0.0 ? place[t] / load[t] : std::numeric_limits<double>::infinity(); };
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return mean(a) < mean(b); });
  for (int k = 0; k < threads; ++k) number[order[k]] = k;
  for (int& thread : owner) thread = number[thread];
}

// Panels of the elimination tree -> independent subtrees for each thread, and what is left above them.
template <class T>
Schedule make_schedule(const PanelStore<T>& store, int size, int threads) {
  const int count = static_cast<int>(store.panels.size());
  std::vector<int> panel_of(static_cast<std::size_t>(size));
  for (int p = 0; p < count; ++p) {
    for (int j = 0; j < store.panels[p].width; ++j) panel_of[store.panels[p].first + j] = p;
  }
  std::vector<int> parent(count, -1);
  std::vector<double> work(count);
  std::vector<std::vector<int>> children(count);
  std::vector<int> candidates;
  for (int p = 0; p < count; ++p) work[p] = own_work(store.panels[p]);
  for (int p = 0; p < count; ++p) {
    if (store.panels[p].below == 0) {
      candidates.push_back(p);
      continue;
    }
    parent[p] = panel_of[store.rows[store.panels[p].rows]];
    children[parent[p]].push_back(p);
    work[parent[p]] += work[p];  // ascending, so a subtree's work is complete when it is passed on
  }
  // take roots off as long as the longest share and what is above them get less
  const auto heavier = [&](int a, int b) { return work[a] != work[b] ? work[a] < work[b] : a < b; };
  std::vector<int> best;
  std::vector<double> load;
  double above = 0.0, least = std::numeric_limits<double>::infinity();
  while (above < least) {
    std::sort(candidates.begin(), candidates.end(), [&](int a, int b) { return heavier(b, a); });
    dealt(candidates, work, threads, load);
    const double longest = above + *std::max_element(load.begin(), load.end());
    if (longest < least) least = longest, best = candidates;
    const auto parent_at = std::find_if(candidates.begin(), candidates.end(), [&](int p) { return !children[p].empty(); });
    if (threads == 1 || parent_at == candidates.end()) break;
    const int p = *parent_at;
    candidates.erase(parent_at);
    above += own_work(store.panels[p]);
    candidates.insert(candidates.end(), children[p].begin(), children[p].end());
  }
  std::vector<int> dealt_to = dealt(best, work, threads, load);
  number_by_place(dealt_to, best, work, threads);
  std::vector<int> owner(count, -1);
  for (std::size_t k = 0; k < best.size(); ++k) owner[best[k]] = dealt_to[k];
  Schedule schedule;
  schedule.panels.resize(threads);
  schedule.columns.resize(threads);
  for (int p = count - 1; p >= 0; --p) {
    if (owner[p] < 0 && parent[p] >= 0) owner[p] = owner[parent[p]];  // above the shared subtrees nobody owns any
  }
  for (int p = 0; p < count; ++p) {
    auto& panels = owner[p] < 0 ? schedule.top_panels : schedule.panels[owner[p]];
    auto& columns = owner[p] < 0 ? schedule.top_columns : schedule.columns[owner[p]];
    panels.push_back(p);
    const std::int32_t first = store.panels[p].first, last = first + store.panels[p].width;
    if (columns.empty() || columns.back().last != first) columns.push_back({first, first});
    columns.back().last = last;
  }
  return schedule;
}

template <class T>
std::size_t line_begin(Lines<T>& values) {
  constexpr std::size_t step = kLine / sizeof(T);
  values.resize((values.size() + step - 1) / step * step, T(0));
  return values.size();
}

// What the backward pass reads, in its order: memory is read ahead that way.
template <class T>
void pack_down(const std::vector<Eigen::MatrixXd>& own, PanelStore<T>& store) {
  for (std::size_t p = store.panels.size(); p-- > 0;) {
    Panel& panel = store.panels[p];
    const auto tall = static_cast<std::size_t>(padded(panel.width)), width = static_cast<std::size_t>(panel.width);
    const auto below = static_cast<std::size_t>(panel.below);
    panel.down = line_begin(store.down);
    store.down.resize(panel.down + tall * (width + below), T(0));
    T* column = &store.down[panel.down];
    for (std::size_t j = 0; j < width; ++j, column += tall) {
      for (std::size_t i = 0; i < width; ++i) column[i] = static_cast<T>(own[p](static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)));
    }
    for (std::size_t j = 0; j < below; ++j, column += tall) {
      for (std::size_t i = 0; i < width; ++i) column[i] = store.up[panel.up + static_cast<std::size_t>(panel.padded) * i + j];
    }
  }
}

}  // namespace

Factor::Factor(const SparseMatrix& matrix, bool single_precision, Ordering ordering, int threads)
    : size_(static_cast<int>(matrix.rows())), threads_(threads), single_(single_precision) {
  if (size_ == 0) return;
  // AMD leaves a long trunk of the elimination tree to one thread
  bool metis = ordering == Ordering::Metis || (ordering == Ordering::Automatic && (size_ > kMetisAbove || threads_ > 1));
#ifndef SOFTGRIP_HAVE_METIS
  if (ordering == Ordering::Metis) throw std::runtime_error("this build has no METIS; choose the ordering 'amd'");
  metis = false;
#endif
  uses_metis_ = metis;
  SparseMatrix full;
  full = matrix.selfadjointView<Eigen::Lower>();
  const double scale = 1.0 / magnitude_of(full);
  full *= scale;
  position_ = elimination_order(full, metis);
  const SparseMatrix lower = lower_factor(full, position_);
  nonzeros_ = static_cast<std::size_t>(lower.nonZeros());
  if (single_) {
    pack(lower, float_);
    float_.scale = scale;
    float_.schedule = make_schedule(float_, size_, threads_);
  } else {
    pack(lower, double_);
    double_.scale = scale;
    double_.schedule = make_schedule(double_, size_, threads_);
  }
}

template <class T>
void Factor::pack(const SparseMatrix& lower, PanelStore<T>& store) {
  const int* outer = lower.outerIndexPtr();
  const int* inner = lower.innerIndexPtr();
  const double* value = lower.valuePtr();
  std::vector<int> place(static_cast<std::size_t>(size_), -1);
  std::vector<Eigen::MatrixXd> own;  // S^-1 of every panel
  for (const Run& run : supernodes(lower)) {
    Panel panel{};
    panel.first = run.first;
    panel.width = run.last - run.first + 1;
    panel.below = outer[run.last + 1] - outer[run.last] - 1;
    panel.padded = padded(panel.below);
    panel.rows = store.rows.size();
    for (int k = outer[run.last] + 1; k < outer[run.last + 1]; ++k) {
      place[inner[k]] = static_cast<int>(store.rows.size() - panel.rows);
      store.rows.push_back(inner[k]);
    }
    Eigen::MatrixXd triangle = Eigen::MatrixXd::Zero(panel.width, panel.width);
    Eigen::MatrixXd below = Eigen::MatrixXd::Zero(panel.below, panel.width);
    for (int j = run.first; j <= run.last; ++j) {
      for (int k = outer[j]; k < outer[j + 1]; ++k) {
        const bool own_row = inner[k] <= run.last;
        (own_row ? triangle(inner[k] - run.first, j - run.first) : below(place[inner[k]], j - run.first)) = value[k];
      }
    }
    const Eigen::MatrixXd inverse =
        triangle.triangularView<Eigen::Lower>().solve(Eigen::MatrixXd::Identity(panel.width, panel.width));
    own.emplace_back(inverse.transpose() * inverse);
    const Eigen::MatrixXd up = -(below * inverse);
    panel.up = line_begin(store.up);
    store.up.resize(panel.up + static_cast<std::size_t>(panel.padded) * panel.width, T(0));
    for (int j = 0; j < panel.width; ++j) {
      T* column = &store.up[panel.up] + static_cast<std::size_t>(panel.padded) * j;
      for (int i = 0; i < panel.below; ++i) column[i] = static_cast<T>(up(i, j));
    }
    store.panels.push_back(panel);
    max_rows_ = std::max(max_rows_, padded(panel.width) + panel.padded);
  }
  pack_down(own, store);
}

std::size_t Factor::bytes() const {
  return sizeof(float) * (float_.up.size() + float_.down.size()) + sizeof(double) * (double_.up.size() + double_.down.size());
}

void Factor::solve(double* const* columns, int count, std::vector<double>& scratch) const {
  if (size_ == 0) return;
  const std::size_t needed = static_cast<std::size_t>(threads_) * panel_work_size(size_, max_rows_);
  if (scratch.size() < needed) scratch.resize(needed);
  if (single_) {
    panel_solve_float(float_, columns, count, static_cast<std::size_t>(size_), static_cast<std::size_t>(max_rows_),
                      reinterpret_cast<float*>(scratch.data()));
  } else {
    panel_solve_double(double_, columns, count, static_cast<std::size_t>(size_), static_cast<std::size_t>(max_rows_),
                       scratch.data());
  }
}

}  // namespace softgrip::gdfe
