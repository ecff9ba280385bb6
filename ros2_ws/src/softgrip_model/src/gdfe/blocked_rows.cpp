// SPDX-License-Identifier: Apache-2.0
#include "softgrip/gdfe/blocked_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_map>

namespace softgrip::gdfe {
namespace {

template <class T>
struct Block {
  std::vector<std::int32_t> place;  // of each entry, ascending: distance or column
  std::vector<T> value;             // [entry][kRowsAbreast]

  std::string key() const {
    std::string key(reinterpret_cast<const char*>(place.data()), place.size() * sizeof(std::int32_t));
    return key.append(reinterpret_cast<const char*>(value.data()), value.size() * sizeof(T));
  }
};

// each(act) calls act(row within the block, place, value) for every value, twice.
template <class T, class Each>
void collect(const Each& each, Block<T>& block) {
  std::vector<std::int32_t>& place = block.place;
  place.clear();
  each([&](int, int at, double) { place.push_back(at); });
  std::sort(place.begin(), place.end());
  place.erase(std::unique(place.begin(), place.end()), place.end());
  block.value.assign(place.size() * kRowsAbreast, T(0));
  each([&](int row, int at, double value) {
    const auto entry = static_cast<std::size_t>(std::lower_bound(place.begin(), place.end(), at) - place.begin());
    block.value[entry * kRowsAbreast + static_cast<std::size_t>(row)] = static_cast<T>(value);
  });
}

template <class T>
void append(std::vector<T>& all, const std::vector<T>& more) {
  all.insert(all.end(), more.begin(), more.end());
}

}  // namespace

template <class T>
BlockedRows<T> blocked_rows(const SparseMatrix& matrix) {
  BlockedRows<T> blocked;
  blocked.start.push_back(0);
  const int rows = static_cast<int>(matrix.rows());
  const Eigen::VectorXd diagonal = matrix.diagonal();
  std::unordered_map<std::string, std::int32_t> known;
  Block<T> block;
  std::size_t worked = 0;  // entries of all blocks
  for (int first = 0; first < rows; first += kRowsAbreast) {
    const auto each = [&](const auto& act) {
      for (int i = first; i < std::min(first + kRowsAbreast, rows); ++i) {
        for (SparseMatrix::InnerIterator it(matrix, i); it; ++it) {  // column i is row i
          const double beside = std::sqrt(diagonal(i) * diagonal(it.row()));
          if (std::abs(it.value()) > std::numeric_limits<T>::epsilon() * beside)
            act(i - first, static_cast<int>(it.row()) - i, it.value());
        }
      }
    };
    collect(each, block);
    worked += block.place.size();
    const auto [at, is_new] = known.try_emplace(block.key(), static_cast<std::int32_t>(known.size()));
    blocked.distinct.push_back(at->second);
    if (!is_new) continue;
    append(blocked.distance, block.place);
    append(blocked.value, block.value);
    blocked.start.push_back(static_cast<std::int32_t>(blocked.distance.size()));
  }
  const std::size_t by_themselves = static_cast<std::size_t>(matrix.nonZeros()) * (sizeof(T) + sizeof(std::int32_t));
  const std::size_t together = worked * (kRowsAbreast * sizeof(T) + sizeof(std::int32_t));
  return together <= by_themselves ? blocked : BlockedRows<T>();
}

template <class T>
SharedColumns<T> shared_columns(const Eigen::SparseMatrix<double, Eigen::RowMajor, int>& matrix) {
  SharedColumns<T> shared;
  shared.start.push_back(0);
  const int rows = static_cast<int>(matrix.rows());
  Block<T> block;
  for (int first = 0; first < rows; first += kRowsAbreast) {
    const auto each = [&](const auto& act) {
      for (int i = first; i < std::min(first + kRowsAbreast, rows); ++i) {
        for (Eigen::SparseMatrix<double, Eigen::RowMajor, int>::InnerIterator it(matrix, i); it; ++it) {
          act(i - first, static_cast<int>(it.col()), it.value());
        }
      }
    };
    collect(each, block);
    append(shared.column, block.place);
    append(shared.value, block.value);
    shared.start.push_back(static_cast<std::int32_t>(shared.column.size()));
  }
  return shared;
}

template BlockedRows<float> blocked_rows(const SparseMatrix& matrix);
template BlockedRows<double> blocked_rows(const SparseMatrix& matrix);
template SharedColumns<float> shared_columns(const Eigen::SparseMatrix<double, Eigen::RowMajor, int>& matrix);
template SharedColumns<double> shared_columns(const Eigen::SparseMatrix<double, Eigen::RowMajor, int>& matrix);

}  // namespace softgrip::gdfe
