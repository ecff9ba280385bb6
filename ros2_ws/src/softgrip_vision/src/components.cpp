// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/components.hpp"

#include <algorithm>
#include <cstddef>
#include <cstring>

namespace softgrip::vision {

void Components::find(const float* signal, int width, int height, float threshold) {
  const std::size_t pixels = static_cast<std::size_t>(width) * height;
  mask_.resize(pixels);
  std::uint8_t* mask = mask_.data();
  for (std::size_t i = 0; i < pixels; ++i) mask[i] = signal[i] > threshold;
  runs_.clear();
  row_begin_.assign(1, 0);
  for (int row = 0; row < height; ++row) {
    find_runs(row, width);
    row_begin_.push_back(static_cast<int>(runs_.size()));
    if (row > 0) join_with_row_above(row);
  }
  gather();
}

void Components::find_runs(int row, int width) {
  const std::uint8_t* mask = mask_.data() + static_cast<std::size_t>(row) * width;
  for (int column = 0; column < width;) {
    const void* first = std::memchr(mask + column, 1, width - column);
    if (first == nullptr) return;
    const int begin = static_cast<int>(static_cast<const std::uint8_t*>(first) - mask);
    const void* behind = std::memchr(mask + begin, 0, width - begin);
    column = behind == nullptr ? width : static_cast<int>(static_cast<const std::uint8_t*>(behind) - mask);
    runs_.push_back({row, begin, column, static_cast<int>(runs_.size())});
  }
}

void Components::join_with_row_above(int row) {
  int above = row_begin_[row - 1], here = row_begin_[row];
  const int above_end = here, here_end = row_begin_[row + 1];
  while (above < above_end && here < here_end) {
    // Corners that meet connect: `end` is one behind the last pixel.
    if (runs_[above].begin <= runs_[here].end && runs_[here].begin <= runs_[above].end) {
      const int one = root(above), other = root(here);
      runs_[std::max(one, other)].component = std::min(one, other);
    }
    (runs_[above].end < runs_[here].end ? above : here) += 1;
  }
}

// The first run of a run's component as far as it is known; what was passed is shortened.
int Components::root(int run) {
  while (runs_[run].component != run) {
    runs_[run].component = runs_[runs_[run].component].component;
    run = runs_[run].component;
  }
  return run;
}

void Components::gather() {
  components_.clear();
  number_of_.resize(runs_.size());
  for (int index = 0; index < static_cast<int>(runs_.size()); ++index) {
    Run& run = runs_[index];
    const int length = run.end - run.begin;
    if (run.component == index) {
      number_of_[index] = static_cast<int>(components_.size());
      components_.push_back({index, run.begin, run.row, run.end, run.row + 1, length});
      continue;
    }
    // A component's first run is its earliest: the one it points to already points to that.
    run.component = runs_[run.component].component;
    Component& component = components_[number_of_[run.component]];
    component.left = std::min(component.left, run.begin);
    component.right = std::max(component.right, run.end);
    component.bottom = run.row + 1;
    component.area += length;
  }
}

}  // namespace softgrip::vision
