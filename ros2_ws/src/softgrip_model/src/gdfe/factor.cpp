// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/factor.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "softgrip/gdfe/ordering.hpp"
#include "softgrip/gdfe/panel_factor.hpp"
#include "softgrip/gdfe/panel_solve.hpp"

namespace softgrip::gdfe {
namespace {

double own_work(const Panel& panel) {
  return static_cast<double>(panel.width) * (panel.padded + panel.width);
}

// Subtrees, heaviest first, each to the thread that has least so far.
std::vector<int> dealt(const std::vector<int>& subtrees, const std::vector<double>& work, int threads,
                       std::vector<double>& load) {
  load.assign(static_cast<std::size_t>(threads), 0.0);
  std::vector<int> owner;
  for (const int p : subtrees) {
    const auto lightest = std::min_element(load.begin(), load.end());
    owner.push_back(static_cast<int>(lightest - load.begin()));
    *lightest += work[p];
  }
  return owner;
}

// Threads numbered by where their subtrees are on average: elsewhere the first thread has the first unknowns, too.
void number_by_place(std::vector<int>& owner, const std::vector<int>& subtrees, const std::vector<double>& work,
                     int threads) {
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
  double above = 0.0, shortest = std::numeric_limits<double>::infinity();
  while (above < shortest) {
    std::sort(candidates.begin(), candidates.end(), [&](int a, int b) { return heavier(b, a); });
    dealt(candidates, work, threads, load);
    const double longest = above + *std::max_element(load.begin(), load.end());
    if (longest < shortest) shortest = longest, best = candidates;
    const auto parent_at =
        std::find_if(candidates.begin(), candidates.end(), [&](int p) { return !children[p].empty(); });
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
std::size_t line_begin(std::size_t at) {
  constexpr std::size_t step = kLine / sizeof(T);
  return (at + step - 1) / step * step;
}

// Where the passes find the panels' values: memory is read ahead where they follow one another in the order of the
// pass.
template <class T>
void initialise_offsets(PanelStore<T>& store) {
  std::size_t up = 0, down = 0;
  for (Panel& panel : store.panels) {
    panel.up = line_begin<T>(up);
    up = panel.up + static_cast<std::size_t>(panel.padded) * static_cast<std::size_t>(panel.width);
  }
  for (std::size_t p = store.panels.size(); p-- > 0;) {
    Panel& panel = store.panels[p];
    panel.down = line_begin<T>(down);
    down = panel.down +
           static_cast<std::size_t>(padded(panel.width)) * static_cast<std::size_t>(panel.width + panel.below);
  }
  store.up.resize(up, T(0));
  store.down.resize(down, T(0));
}

// Both blocks of a panel's values.
template <class T>
void fill(const DensePanel& from, const Panel& panel, PanelStore<T>& store) {
  const auto triangle = from.values.topRows(panel.width).template triangularView<Eigen::Lower>();
  const Eigen::MatrixXd inverse = triangle.solve(Eigen::MatrixXd::Identity(panel.width, panel.width));
  const Eigen::MatrixXd own = inverse.transpose() * inverse;  // S^-1
  const Eigen::MatrixXd up = -(from.values.bottomRows(panel.below) * inverse);
  T* column = store.up.data() + panel.up;
  for (Eigen::Index j = 0; j < panel.width; ++j, column += panel.padded) {
    for (Eigen::Index i = 0; i < panel.below; ++i) column[i] = static_cast<T>(up(i, j));
  }
  column = store.down.data() + panel.down;
  const int tall = padded(panel.width);
  for (Eigen::Index j = 0; j < panel.width; ++j, column += tall) {
    for (Eigen::Index i = 0; i < panel.width; ++i) column[i] = static_cast<T>(own(i, j));
  }
  for (Eigen::Index j = 0; j < panel.below; ++j, column += tall) {
    for (Eigen::Index i = 0; i < panel.width; ++i) column[i] = static_cast<T>(up(j, i));
  }
}

}  // namespace

Factor::Factor(const SparseMatrix& matrix, bool single_precision, Ordering ordering, int threads)
    : size_(static_cast<int>(matrix.rows())), threads_(threads), single_(single_precision) {
  if (size_ == 0) return;
  // AMD leaves a long trunk of the elimination tree to one thread
  bool metis =
      ordering == Ordering::Metis || (ordering == Ordering::Automatic && (size_ > kMetisAbove || threads_ > 1));
#ifndef SOFTGRIP_HAVE_METIS
  if (ordering == Ordering::Metis) throw std::runtime_error("this build has no METIS; choose the ordering 'amd'");
  metis = false;
#endif
  uses_metis_ = metis;
  const double scale = 1.0 / magnitude_of(matrix);
  Elimination elimination = eliminate(matrix, metis);
  nonzeros_ = std::accumulate(elimination.count.begin(), elimination.count.end(), static_cast<std::size_t>(size_));
  const std::vector<DensePanel> panels = factor_panels(matrix, scale, elimination);
  position_ = std::move(elimination.position);
  if (single_) {
    pack(panels, float_);
    float_.scale = scale;
  } else {
    pack(panels, double_);
    double_.scale = scale;
  }
}

template <class T>
void Factor::pack(const std::vector<DensePanel>& panels, PanelStore<T>& store) {
  for (const DensePanel& from : panels) {
    const int width = static_cast<int>(from.values.cols()), below = static_cast<int>(from.rows.size());
    store.panels.push_back({from.first, width, below, padded(below), 0, 0, store.rows.size()});
    store.rows.insert(store.rows.end(), from.rows.begin(), from.rows.end());
    max_rows_ = std::max(max_rows_, padded(width) + padded(below));
  }
  initialise_offsets(store);
#pragma omp parallel for schedule(dynamic) num_threads(threads_) if (threads_ > 1)
  for (std::size_t p = 0; p < panels.size(); ++p) fill(panels[p], store.panels[p], store);
  store.schedule = make_schedule(store, size_, threads_);
}

std::size_t Factor::bytes() const {
  return sizeof(float) * (float_.up.size() + float_.down.size()) +
         sizeof(double) * (double_.up.size() + double_.down.size());
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
