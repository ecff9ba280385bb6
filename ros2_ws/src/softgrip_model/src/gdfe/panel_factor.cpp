// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/panel_factor.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace softgrip::gdfe {
namespace {

// Widest panel, and how much of it may be zeros that the sparse factor does not have.
constexpr int kMaxWidth = 48;
constexpr double kZeroShare = 0.3;
constexpr int kAlwaysMergeBelow = 8;

// Neighbouring columns j, j+1 with parent(j) = j+1 join while few zeros come in.
std::vector<DensePanel> empty_panels(const Elimination& elimination) {
  const std::vector<int>& below = elimination.count;
  const int n = static_cast<int>(below.size());
  std::vector<DensePanel> panels;
  int first = 0;
  double entries = 0.0;
  for (int j = 0; j < n; ++j) {
    entries += below[j] + 1;
    bool join = elimination.parent[j] == j + 1 && j + 1 - first < kMaxWidth;
    if (join) {
      const int width = j + 2 - first;
      const double dense = 0.5 * width * (width + 1) + static_cast<double>(width) * below[j + 1];
      join = width <= kAlwaysMergeBelow || dense - (entries + below[j + 1] + 1) <= kZeroShare * dense;
    }
    if (!join) {
      const int width = j + 1 - first;
      panels.push_back({first, {}, Eigen::MatrixXd::Zero(width + below[j], width)});
      panels.back().rows.reserve(static_cast<std::size_t>(below[j]));
      first = j + 1;
      entries = 0.0;
    }
  }
  return panels;
}

// Columns begin .. end - 1 of a panel, counted from its first.
struct Part {
  int panel, begin, end;
};

struct Entry {
  int place;
  double value;
};

// The lower triangle in the order of elimination, row by row: entries up to the diagonal, ascending.
struct LowerRows {
  std::vector<int> first;
  std::vector<Entry> entries;
};

LowerRows lower_rows(const SparseMatrix& matrix, const std::vector<int>& position) {
  // by columns first: taken from them in turn, a row's entries ascend
  const auto n = static_cast<std::size_t>(matrix.cols());
  std::vector<int> first_of_column(n + 1, 0);
  LowerRows rows{std::vector<int>(n + 1, 0), {}};
  const auto each = [&](const auto& visit) {
    for (int j = 0; j < matrix.outerSize(); ++j) {
      for (SparseMatrix::InnerIterator it(matrix, j); it; ++it) {
        if (it.row() < j) continue;
        const auto [low, high] =
            std::minmax(position[static_cast<std::size_t>(it.row())], position[static_cast<std::size_t>(j)]);
        visit(low, high, it.value());
      }
    }
  };
  each([&](int column, int row, double) { ++first_of_column[column + 1], ++rows.first[row + 1]; });
  for (std::size_t k = 0; k < n; ++k) first_of_column[k + 1] += first_of_column[k], rows.first[k + 1] += rows.first[k];
  std::vector<Entry> by_column(static_cast<std::size_t>(rows.first[n]));
  std::vector<int> next(first_of_column.begin(), first_of_column.end() - 1);
  each([&](int column, int row, double value) { by_column[next[column]++] = {row, value}; });
  rows.entries.resize(by_column.size());
  next.assign(rows.first.begin(), rows.first.end() - 1);
  for (int column = 0; column < static_cast<int>(n); ++column) {
    for (int k = first_of_column[column]; k < first_of_column[column + 1]; ++k) {
      rows.entries[next[by_column[k].place]++] = {column, by_column[k].value};
    }
  }
  return rows;
}

// x[i] -= columns[i][k] * y[k] for from <= i < to, k = 0, 1, ... in turn.
template <int count>
void subtract(const double* columns, Eigen::Index tall, const double* y, int from, int to, double* x) {
  for (int i = from; i < to; ++i) {
    double value = x[i];
    for (int k = 0; k < count; ++k) value -= columns[k * tall + i] * y[k];
    x[i] = value;
  }
}

// Solves C z = x with a panel's columns begin .. end - 1, in place, and takes them off the other x up to `rows`; C's
// rows as the panel has them. Returns z^T z off `square`.
double substitute(const Eigen::MatrixXd& panel, int begin, int end, int rows, double square, double* x) {
  constexpr int kStep = 4;
  const Eigen::Index tall = panel.rows();
  for (int j = begin; j < end; j += kStep) {
    const int last = std::min(j + kStep, end);
    for (int k = j; k < last; ++k) {
      x[k] /= panel(k, k);
      square -= x[k] * x[k];
      for (int i = k + 1; i < last; ++i) x[i] -= panel(i, k) * x[k];
    }
    const double* columns = panel.data() + j * tall;
    if (last - j == kStep) {
      subtract<kStep>(columns, tall, x + j, last, rows, x);
    } else {
      for (int k = j; k < last; ++k) subtract<1>(panel.data() + k * tall, tall, x + k, last, rows, x);
    }
  }
  return square;
}

}  // namespace

// Row by row: with C the rows so far and a the matrix' next row, that of the factor solves C z = a, and its diagonal
// entry is sqrt(a_kk - z^T z) (up-looking: Davis 2006, section 4.7). Columns that follow one another in a panel are
// taken at once.
std::vector<DensePanel> factor_panels(const SparseMatrix& matrix, double scale, const Elimination& elimination) {
  std::vector<DensePanel> panels = empty_panels(elimination);
  const int n = static_cast<int>(elimination.count.size());
  std::vector<int> panel_of(static_cast<std::size_t>(n)), met(panels.size(), -1), met_from(panels.size());
  int max_rows = 0;
  for (std::size_t p = 0; p < panels.size(); ++p) {
    std::fill_n(panel_of.begin() + panels[p].first, panels[p].values.cols(), static_cast<int>(p));
    max_rows = std::max(max_rows, static_cast<int>(panels[p].values.rows()));
  }
  const LowerRows lower = lower_rows(matrix, elimination.position);
  std::vector<double> row(static_cast<std::size_t>(n), 0.0), x(static_cast<std::size_t>(max_rows));
  std::vector<Part> parts;
  for (int k = 0; k < n; ++k) {
    // columns with an entry in this row: up the tree from those of the matrix, the last path first, each backwards
    parts.clear();
    double diagonal = 0.0;
    for (int e = lower.first[k]; e < lower.first[k + 1]; ++e) {
      const auto [place, value] = lower.entries[e];
      (place == k ? diagonal : row[place]) = scale * value;
      const auto path = static_cast<std::ptrdiff_t>(parts.size());
      for (int column = place; column < k;) {
        const int p = panel_of[column], begin = column - panels[p].first;
        const bool before = std::exchange(met[p], k) == k;
        const int end = before ? met_from[p] : std::min(static_cast<int>(panels[p].values.cols()), k - panels[p].first);
        if (begin >= end) break;
        met_from[p] = begin;
        parts.push_back({p, begin, end});
        if (before) break;
        column = elimination.parent[panels[p].first + end - 1];
      }
      std::reverse(parts.begin() + path, parts.end());
    }
    for (auto part = parts.rbegin(); part != parts.rend(); ++part) {
      const auto [p, begin, end] = *part;
      DensePanel& panel = panels[p];
      const int first = panel.first, width = static_cast<int>(panel.values.cols());
      const bool own = k < first + width;
      const int mine = own ? k - first : width, below = static_cast<int>(panel.rows.size()),
                rows = mine + (own ? 0 : below);
      std::copy(row.begin() + first + begin, row.begin() + first + mine, x.begin() + begin);
      for (int i = mine; i < rows; ++i) x[i] = row[panel.rows[i - mine]];
      diagonal = substitute(panel.values, begin, end, rows, diagonal, x.data());
      for (int j = begin; j < end; ++j) panel.values(own ? mine : width + below, j) = x[j];
      std::fill(row.begin() + first + begin, row.begin() + first + end, 0.0);
      std::copy(x.begin() + end, x.begin() + mine, row.begin() + first + end);
      for (int i = mine; i < rows; ++i) row[panel.rows[i - mine]] = x[i];
      if (!own && end == width) panel.rows.push_back(k);
    }
    if (diagonal <= 0.0) {
      throw std::runtime_error("the constant matrix is not positive definite: some part of the mesh is not held");
    }
    DensePanel& panel = panels[panel_of[k]];
    panel.values(k - panel.first, k - panel.first) = std::sqrt(diagonal);
  }
  return panels;
}

}  // namespace softgrip::gdfe
