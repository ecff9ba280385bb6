// SPDX-License-Identifier: Apache-2.0
// 8-connected components of what rises above a threshold, as runs of pixels in rows.
#pragma once

#include <cstdint>
#include <vector>

namespace softgrip::vision {

// Pixels [begin, end) of a row.
struct Run {
  int row;
  int begin;
  int end;
  int component;  // index of the component's first run, row by row
};

// Its box and its area [px^2]; right and bottom are the first column and row behind it.
struct Component {
  int first_run;
  int left;
  int top;
  int right;
  int bottom;
  int area;
};

class Components {
 public:
  // Of a (height, width) signal; what does not rise above the threshold, NaN included, belongs to none.
  void find(const float* signal, int width, int height, float threshold);

  // In the order of their first pixels, row by row.
  const std::vector<Component>& all() const { return components_; }
  // 1 where the signal rises above the threshold, (height, width).
  const std::uint8_t* mask() const { return mask_.data(); }
  // Runs of a row that reach into columns [left, right): call `use` with each.
  template <class Use>
  void for_runs(int row, int left, int right, Use use) const;

 private:
  void find_runs(int row, int width);
  void join_with_row_above(int row);
  void gather();
  int root(int run);

  std::vector<std::uint8_t> mask_;
  std::vector<Run> runs_;
  std::vector<int> row_begin_;  // index of each row's first run, and one more at the end
  std::vector<Component> components_;
  std::vector<int> number_of_;  // of each run that is a component's first: its place in components_
};

template <class Use>
void Components::for_runs(int row, int left, int right, Use use) const {
  int low = row_begin_[row];
  const int end = row_begin_[row + 1];
  // the first run that ends behind `left`; a row of specks may have hundreds
  for (int high = end; low < high;) {
    const int middle = low + (high - low) / 2;
    if (runs_[middle].end <= left) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  for (; low < end && runs_[low].begin < right; ++low) use(runs_[low]);
}

}  // namespace softgrip::vision
