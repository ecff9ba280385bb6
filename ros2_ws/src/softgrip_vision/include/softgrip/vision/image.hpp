// SPDX-License-Identifier: Apache-2.0
// An 8-bit BGR image and the colour signal of its pixels (softgrip_vision.colour).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace softgrip::vision {

// A view; pixels of a row lie side by side, rows `row_bytes` apart.
struct Image {
  const std::uint8_t* bgr;
  int width;
  int height;
  std::ptrdiff_t row_bytes;

  const std::uint8_t* at(int row, int column) const { return bgr + row * row_bytes + 3 * std::ptrdiff_t{column}; }
};

// A part of an image [px].
struct Window {
  int left;
  int top;
  int width;
  int height;

  bool within(const Image& image) const {
    return left >= 0 && top >= 0 && width >= 0 && height >= 0 && width <= image.width - left &&
           height <= image.height - top;
  }
};

// Two linear forms of (B, G, R); the smaller of the two is the signal (see ColourModel).
using ColourForms = std::array<std::array<float, 3>, 2>;

// Row by row the signal [grey levels] of a window that lies within the image; `signal` takes width x height values.
class SignalOf {
 public:
  explicit SignalOf(const ColourForms& forms) : forms_(forms) {}
  void operator()(const Image& image, const Window& window, float* signal);

 private:
  ColourForms forms_;
  std::vector<std::uint32_t> pixels_;
};

}  // namespace softgrip::vision
