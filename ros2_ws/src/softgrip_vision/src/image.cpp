// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/image.hpp"

#include <cstring>

namespace softgrip::vision {

namespace {

// A window's rows lie on pages of their own, where no processor looks ahead by itself.
constexpr int kRowsAhead = 8;
constexpr int kCacheLineBytes = 64;

}  // namespace

void SignalOf::operator()(const Image& image, const Window& window, float* signal) {
  const int width = window.width;
  if (width == 0) return;
  const auto [first, second] = forms_;
  pixels_.resize(width);
  std::uint32_t* pixels = pixels_.data();
  for (int row = 0; row < window.height; ++row, signal += width) {
    // Three bytes a pixel are nothing that compilers vectorise; four bytes a pixel are.
    const std::uint8_t* from = image.at(window.top + row, window.left);
    for (int i = 0; i + 1 < width; ++i) {
      std::uint32_t pixel;
      std::memcpy(&pixel, from + 3 * i, 4);
      pixels[i] = pixel;
    }
    if (row + kRowsAhead < window.height) {
      const std::uint8_t* ahead = from + kRowsAhead * image.row_bytes;
      for (int byte = 0; byte < 3 * width; byte += kCacheLineBytes) __builtin_prefetch(ahead + byte);
    }
    const std::uint8_t* last = from + 3 * (width - 1);
    const std::uint8_t padded[4] = {last[0], last[1], last[2], 0};
    std::memcpy(pixels + width - 1, padded, 4);
    for (int i = 0; i < width; ++i) {
      const auto blue = static_cast<float>(static_cast<std::int32_t>(pixels[i] & 255U));
      const auto green = static_cast<float>(static_cast<std::int32_t>((pixels[i] >> 8) & 255U));
      const auto red = static_cast<float>(static_cast<std::int32_t>((pixels[i] >> 16) & 255U));
      const float one = first[0] * blue + first[1] * green + first[2] * red;
      const float other = second[0] * blue + second[1] * green + second[2] * red;
      signal[i] = other < one ? other : one;
    }
  }
}

}  // namespace softgrip::vision
