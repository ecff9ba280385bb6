// SPDX-License-Identifier: Apache-2.0
#include "softgrip/vision/spots.hpp"

#include <algorithm>
#include <cmath>

namespace softgrip::vision {

namespace {

// A spot's edge ramp: weight 0 below the first share of its height, 1 above the second. The plateau then counts as
// flat, so that shading across a marker does not pull the centre.
constexpr double kRampLow = 0.25, kRampHigh = 0.65;
// [grey levels] A signal's noise is at least the rounding of three 8-bit channels.
constexpr double kRoundingNoise = 0.5;
// Neighbouring pixels share noise (demosaicing, JPEG blocks): as many act as one independent sample.
constexpr double kCorrelatedPixels = 4.0;
// The plateau's signal is this quantile of a spot's pixels (the edge makes up the lower part).
constexpr double kPlateauQuantile = 0.75;
// Every so many background rows and columns tell level and noise well enough; so few samples tell nothing.
constexpr int kBackgroundStride = 2;
constexpr std::size_t kMinSamples = 8;
// A component of fewer pixels is a speck.
constexpr double kMinPixels = 4.0;
// [px] Margin around a component's box that its edge ramp reaches into.
constexpr int kMargin = 2;
// A spot rises so many deviations of the noise above its surroundings at least.
constexpr double kMinHeight = 3.0;
// [px] The centre is never better known than this (pixel response, chroma subsampling).
constexpr double kCentreFloor_px = 0.03;
// A normal distribution's standard deviation over its median absolute deviation.
constexpr double kDeviationOfMedian = 1.4826;

// A component with a margin, clipped to the (height, width) that it lies in.
Window box_of(const Component& component, int width, int height) {
  const int left = std::max(0, component.left - kMargin), top = std::max(0, component.top - kMargin);
  const int right = std::min(width, component.right + kMargin), bottom = std::min(height, component.bottom + kMargin);
  return {left, top, right - left, bottom - top};
}

}  // namespace

struct SpotFinder::Weighed {
  // sums of w, w x, w y, w x^2, w y^2, w x y over all pixels
  double w = 0.0, x = 0.0, y = 0.0, xx = 0.0, yy = 0.0, xy = 0.0;
  // sums of 1, x, y, x^2 + y^2 over the pixels of the ramp, where noise moves the weight
  double ramp = 0.0, ramp_x = 0.0, ramp_y = 0.0, ramp_rr = 0.0;
};

std::vector<Spot> SpotFinder::find(const Image& image, const Window& window, const ColourForms& forms, float threshold,
                                   const AreaRange& area) {
  width_ = window.width;
  height_ = window.height;
  signal_.resize(static_cast<std::size_t>(width_) * height_);
  SignalOf{forms}(image, window, signal_.data());
  components_.find(signal_.data(), width_, height_, threshold);

  std::vector<Spot> spots;
  std::optional<Background> around;
  for (const Component& component : components_.all()) {
    const bool whole =
        component.left > 0 && component.top > 0 && component.right < width_ && component.bottom < height_;
    const bool fits =
        std::max(kMinPixels, 0.5 * area.smallest_px) <= component.area && component.area <= 2.0 * area.largest_px;
    if (!whole || !fits) continue;
    if (!around) around = background();
    std::optional<Spot> spot = measure(component, *around);
    if (!spot || spot->area_px < area.smallest_px || spot->area_px > area.largest_px) continue;
    spot->u += window.left;
    spot->v += window.top;
    spots.push_back(*spot);
  }
  return spots;
}

// Median and robust standard deviation.
SpotFinder::Background SpotFinder::background() {
  values_.clear();
  for (int row = 0; row < height_; row += kBackgroundStride) {
    const std::size_t begin = static_cast<std::size_t>(row) * width_;
    for (int column = 0; column < width_; column += kBackgroundStride) {
      if (components_.mask()[begin + column] == 0) values_.push_back(signal_[begin + column]);
    }
  }
  if (values_.size() < kMinSamples) return {0.0, kRoundingNoise};
  const float level = quantile_(values_, 0.5);
  for (float& value : values_) value = std::abs(value - level);
  return {level, std::max(kRoundingNoise, kDeviationOfMedian * quantile_(values_, 0.5))};
}

// The signal [grey levels] of a component's plateau.
double SpotFinder::plateau(const Component& component) {
  values_.clear();
  for (int row = component.top; row < component.bottom; ++row) {
    const float* signal = signal_.data() + static_cast<std::size_t>(row) * width_;
    components_.for_runs(row, component.left, component.right, [&](const Run& run) {
      if (run.component == component.first_run) values_.insert(values_.end(), signal + run.begin, signal + run.end);
    });
  }
  return quantile_(values_, kPlateauQuantile);
}

// A component as a spot, its place from the window's corner; none when it does not rise above the noise.
std::optional<Spot> SpotFinder::measure(const Component& component, const Background& background) {
  const double height = plateau(component) - background.level;
  if (height <= kMinHeight * background.noise) return std::nullopt;
  const Window box = box_of(component, width_, height_);
  const double slope = 1.0 / ((kRampHigh - kRampLow) * height);
  const double foot = background.level + kRampLow * height;
  const Weighed sum = weigh(box, component, static_cast<float>(foot), static_cast<float>(slope));
  const double area = sum.w;
  if (area < 1.0) return std::nullopt;
  const double u = sum.x / area, v = sum.y / area;
  const double spread_u = sum.xx / area - u * u, spread_v = sum.yy / area - v * v, tilt = sum.xy / area - u * v;
  const double mean = (spread_u + spread_v) / 2, half = std::hypot((spread_u - spread_v) / 2, tilt);
  const double minor = std::max(mean - half, 1e-6), major = std::max(mean + half, minor);
  // A pixel of the ramp moves the centre in proportion to its distance from it.
  const double ramp_moment =
      std::max(0.0, sum.ramp_rr - 2.0 * (u * sum.ramp_x + v * sum.ramp_y) + (u * u + v * v) * sum.ramp);
  const double lever = ramp_moment / 2 / (area * area);
  Spot spot{};
  spot.u = box.left + u;
  spot.v = box.top + v;
  spot.stddev_px = std::hypot(kCentreFloor_px, background.noise * slope * std::sqrt(kCorrelatedPixels * lever));
  spot.area_px = area;
  spot.roundness = std::sqrt(minor / major);
  spot.solidity = std::min(1.0, area / (4.0 * M_PI * std::sqrt(major * minor)));
  spot.height = height;
  spot.surroundings = background.level;
  spot.noise = background.noise;
  return spot;
}

SpotFinder::Weighed SpotFinder::weigh(const Window& box, const Component& component, float foot, float slope) {
  mark_around_foreign(box, component);
  Weighed sum;
  for (int y = 0; y < box.height; ++y) {
    const float* signal = signal_.data() + static_cast<std::size_t>(box.top + y) * width_ + box.left;
    const std::uint8_t* foreign = foreign_.data() + static_cast<std::size_t>(y) * box.width;
    double w = 0.0, wx = 0.0, wxx = 0.0, ramp = 0.0, ramp_x = 0.0, ramp_xx = 0.0;
    for (int x = 0; x < box.width; ++x) {
      const float rise = (signal[x] - foot) * slope;
      if (!(rise > 0.0F)) continue;
      if (rise < 1.0F) {
        ramp += 1.0;
        ramp_x += x;
        ramp_xx += static_cast<double>(x) * x;
      }
      if (foreign[x] != 0) continue;
      const double weight = std::min(rise, 1.0F);
      w += weight;
      wx += weight * x;
      wxx += weight * x * x;
    }
    sum.w += w;
    sum.x += wx;
    sum.xx += wxx;
    sum.y += w * y;
    sum.yy += w * y * y;
    sum.xy += wx * y;
    sum.ramp += ramp;
    sum.ramp_x += ramp_x;
    sum.ramp_y += ramp * y;
    sum.ramp_rr += ramp_xx + ramp * y * y;
  }
  return sum;
}

// Where another component's pixels, and those beside them, lie in a component's box: they weigh nothing.
void SpotFinder::mark_around_foreign(const Window& box, const Component& component) {
  foreign_.assign(static_cast<std::size_t>(box.width) * box.height, 0);
  for (int y = 0; y < box.height; ++y) {
    components_.for_runs(box.top + y, box.left, box.left + box.width, [&](const Run& run) {
      if (run.component == component.first_run) return;
      const int begin = std::max(0, run.begin - 1 - box.left), end = std::min(box.width, run.end + 1 - box.left);
      for (int near = std::max(0, y - 1); near < std::min(box.height, y + 2); ++near) {
        std::fill_n(foreign_.begin() + static_cast<std::ptrdiff_t>(near) * box.width + begin, end - begin, 1);
      }
    });
  }
}

}  // namespace softgrip::vision
