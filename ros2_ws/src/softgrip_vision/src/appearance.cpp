// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/appearance.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::vision {

namespace {

// Radius of the ring around a marker that shows the finger, in marker radii, and its samples.
constexpr double kRingRadius = 1.4;
constexpr int kRingSamples = 16;
// As many of them at least show the finger's body.
constexpr int kBodySamples = 3;

// 0 .. count - 1; NaN counts as below.
int clamped(double place, int count) {
  if (!(place > 0.0)) return 0;
  return place >= count ? count - 1 : static_cast<int>(place);
}

const std::uint8_t* pixel_at(const Image& image, double column, double row) {
  return image.at(clamped(row, image.height), clamped(column, image.width));
}

}  // namespace

std::array<double, 3> colour_at(const Image& image, double u, double v) {
  std::array<int, 3> sum{};
  for (int row = -1; row <= 1; ++row) {
    for (int column = -1; column <= 1; ++column) {
      const std::uint8_t* pixel = pixel_at(image, std::rint(u) + column, std::rint(v) + row);
      for (int channel = 0; channel < 3; ++channel) sum[channel] += pixel[channel];
    }
  }
  return {sum[0] / 9.0, sum[1] / 9.0, sum[2] / 9.0};
}

double surround_of(const Image& image, double u, double v, double radius_px, bool body_is_brighter) {
  std::array<int, kRingSamples> ring;
  for (int i = 0; i < kRingSamples; ++i) {
    const double turn = 2.0 * M_PI * i / kRingSamples, reach = kRingRadius * radius_px;
    const std::uint8_t* pixel =
        pixel_at(image, std::floor(u + 0.5 + reach * std::cos(turn)), std::floor(v + 0.5 + reach * std::sin(turn)));
    ring[i] = pixel[0] + pixel[1] + pixel[2];
  }
  std::sort(ring.begin(), ring.end());
  const int body = body_is_brighter ? ring[kRingSamples - kBodySamples] : ring[kBodySamples - 1];
  const auto [blue, green, red] = colour_at(image, u, v);
  return (body + 1.0) / (blue + green + red + 1.0);
}

}  // namespace softgrip::vision
