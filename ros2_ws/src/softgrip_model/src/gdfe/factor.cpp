// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/factor.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <stdexcept>

#ifdef SOFTGRIP_HAVE_METIS
#include <iostream>  // Eigen 3.4's MetisSupport uses it without including it

#include <Eigen/MetisSupport>
#endif

#include "src/gdfe/panel_solve.hpp"

namespace softgrip::gdfe {
namespace {

template <class Solver>
SparseMatrix lower_factor(const SparseMatrix& matrix, std::vector<int>& position) {
  Solver solver(matrix);
  if (solver.info() != Eigen::Success) {
    throw std::runtime_error("the constant matrix is not positive definite: some part of the mesh is not held");
  }
  const auto& indices = solver.permutationP().indices();
  position.assign(indices.data(), indices.data() + indices.size());
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
  double total = 0.0;
  for (int p = 0; p < count; ++p) work[p] = static_cast<double>(store.panels[p].width) * (store.panels[p].padded + store.panels[p].width);
  for (int p = 0; p < count; ++p) {
    total += static_cast<double>(store.panels[p].width) * (store.panels[p].padded + store.panels[p].width);
    if (store.panels[p].below == 0) {
      candidates.push_back(p);
      continue;
    }
    parent[p] = panel_of[store.rows[store.panels[p].rows]];
    children[parent[p]].push_back(p);
    work[parent[p]] += work[p];  // ascending, so a subtree's work is complete when it is passed on
  }
  // take roots off until no subtree is more than a fair share
  const auto heavier = [&](int a, int b) { return work[a] != work[b] ? work[a] < work[b] : a < b; };
  std::vector<char> is_top(count, 0);
  while (!candidates.empty()) {
    const auto largest = std::max_element(candidates.begin(), candidates.end(), heavier);
    if (work[*largest] <= total / (1.3 * threads) || children[*largest].empty()) break;
    const int p = *largest;
    candidates.erase(largest);
    is_top[p] = 1;
    candidates.insert(candidates.end(), children[p].begin(), children[p].end());
  }
  std::sort(candidates.begin(), candidates.end(), [&](int a, int b) { return heavier(b, a); });
  std::vector<double> load(threads, 0.0);
  std::vector<int> owner(count, -1);
  for (const int p : candidates) {
    const auto least = std::min_element(load.begin(), load.end());
    owner[p] = static_cast<int>(least - load.begin());
    *least += work[p];
  }
  Schedule schedule;
  schedule.panels.resize(threads);
  schedule.columns.resize(threads);
  for (int p = count - 1; p >= 0; --p) {
    if (owner[p] < 0 && !is_top[p]) owner[p] = owner[parent[p]];
  }
  for (int p = 0; p < count; ++p) {
    auto& panels = is_top[p] ? schedule.top_panels : schedule.panels[owner[p]];
    auto& columns = is_top[p] ? schedule.top_columns : schedule.columns[owner[p]];
    panels.push_back(p);
    for (int j = 0; j < store.panels[p].width; ++j) columns.push_back(store.panels[p].first + j);
  }
  return schedule;
}

// Of a triangle what is above the diagonal is passed over, in steps of kPad rows.
template <class T>
std::size_t entries_read(const PanelStore<T>& store) {
  std::size_t entries = store.values.size() + store.inverse.size();
  for (const Panel& panel : store.panels) {
    for (int j = kPad; j < panel.width; ++j) entries -= static_cast<std::size_t>(j / kPad * kPad);
  }
  return entries;
}

}  // namespace

Factor::Factor(const SparseMatrix& matrix, bool single_precision, Ordering ordering, int threads)
    : size_(static_cast<int>(matrix.rows())), threads_(threads), single_(single_precision) {
  if (size_ == 0) return;
  const bool metis = ordering == Ordering::Metis || (ordering == Ordering::Automatic && size_ > kMetisAbove);
  SparseMatrix lower;
#ifdef SOFTGRIP_HAVE_METIS
  if (metis) {
    lower = lower_factor<Eigen::SimplicialLLT<SparseMatrix, Eigen::Lower, Eigen::MetisOrdering<int>>>(matrix, position_);
    uses_metis_ = true;
  }
#else
  if (ordering == Ordering::Metis) throw std::runtime_error("this build has no METIS; choose the ordering 'amd'");
#endif
  if (!metis || !uses_metis_) {
    lower = lower_factor<Eigen::SimplicialLLT<SparseMatrix, Eigen::Lower, Eigen::AMDOrdering<int>>>(matrix, position_);
  }
  nonzeros_ = static_cast<std::size_t>(lower.nonZeros());
  if (single_) {
    pack(lower, float_);
    float_.schedule = make_schedule(float_, size_, threads_);
  } else {
    pack(lower, double_);
    double_.schedule = make_schedule(double_, size_, threads_);
  }
}

template <class T>
void Factor::pack(const SparseMatrix& lower, PanelStore<T>& store) {
  const int* outer = lower.outerIndexPtr();
  const int* inner = lower.innerIndexPtr();
  const double* value = lower.valuePtr();
  std::vector<int> place(static_cast<std::size_t>(size_), -1);
  for (const Run& run : supernodes(lower)) {
    Panel panel{};
    panel.first = run.first;
    panel.width = run.last - run.first + 1;
    panel.below = outer[run.last + 1] - outer[run.last] - 1;
    panel.padded = (panel.below + kPad - 1) / kPad * kPad;
    panel.rows = store.rows.size();
    for (int k = outer[run.last] + 1; k < outer[run.last + 1]; ++k) {
      place[inner[k]] = static_cast<int>(store.rows.size() - panel.rows);
      store.rows.push_back(inner[k]);
    }
    Eigen::MatrixXd triangle = Eigen::MatrixXd::Zero(panel.width, panel.width);
    panel.values = store.values.size();
    store.values.resize(panel.values + static_cast<std::size_t>(panel.padded) * panel.width, T(0));
    for (int j = run.first; j <= run.last; ++j) {
      T* column = &store.values[panel.values] + static_cast<std::size_t>(panel.padded) * (j - run.first);
      for (int k = outer[j]; k < outer[j + 1]; ++k) {
        if (inner[k] <= run.last) {
          triangle(inner[k] - run.first, j - run.first) = value[k];
        } else {
          column[place[inner[k]]] = static_cast<T>(value[k]);
        }
      }
    }
    const Eigen::MatrixXd inverse =
        triangle.triangularView<Eigen::Lower>().solve(Eigen::MatrixXd::Identity(panel.width, panel.width));
    panel.inverse = store.inverse.size();
    const int tall = (panel.width + kPad - 1) / kPad * kPad;
    store.inverse.resize(panel.inverse + static_cast<std::size_t>(tall) * panel.width, T(0));
    for (int j = 0; j < panel.width; ++j) {
      for (int i = j; i < panel.width; ++i) {
        store.inverse[panel.inverse + static_cast<std::size_t>(tall) * j + i] = static_cast<T>(inverse(i, j));
      }
    }
    store.panels.push_back(panel);
    max_below_ = std::max({max_below_, panel.padded, tall});
  }
}

std::size_t Factor::bytes() const {
  // forward and backward
  return 2 * (sizeof(float) * entries_read(float_) + sizeof(double) * entries_read(double_));
}

void Factor::solve(double* const* columns, int count, std::vector<double>& scratch) const {
  if (size_ == 0) return;
  const std::size_t needed = static_cast<std::size_t>(threads_) * panel_work_size(size_, max_below_);
  if (scratch.size() < needed) scratch.resize(needed);
  if (single_) {
    panel_solve_float(float_, columns, count, static_cast<std::size_t>(size_), static_cast<std::size_t>(max_below_),
                      reinterpret_cast<float*>(scratch.data()));
  } else {
    panel_solve_double(double_, columns, count, static_cast<std::size_t>(size_), static_cast<std::size_t>(max_below_),
                       scratch.data());
  }
}

}  // namespace softgrip::gdfe
