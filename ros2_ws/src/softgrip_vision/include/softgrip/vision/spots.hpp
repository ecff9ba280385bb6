// SPDX-License-Identifier: Apache-2.0
// Round spots of a marker's colour, measured to a fraction of a pixel (softgrip_vision.spots).
#pragma once

#include <optional>
#include <vector>

#include "softgrip/vision/components.hpp"
#include "softgrip/vision/image.hpp"
#include "softgrip/vision/quantile.hpp"

namespace softgrip::vision {

// See softgrip_vision.spots.Spot.
struct Spot {
  double u;
  double v;
  double stddev_px;
  double area_px;
  double roundness;
  double solidity;
  double height;
  double surroundings;
  double noise;
};

struct AreaRange {
  double smallest_px;
  double largest_px;
};

class SpotFinder {
 public:
  // The whole spots in a window that lies within the image; what a window needs of memory is kept for the next one.
  std::vector<Spot> find(const Image& image, const Window& window, const ColourForms& forms, float threshold,
                         const AreaRange& area);

 private:
  // Level and standard deviation [grey levels] of what lies around the spots.
  struct Background {
    double level;
    double noise;
  };
  // What a component weighs in its box with a margin; places from the box's corner [px].
  struct Weighed;

  Background background();
  double plateau(const Component& component);
  std::optional<Spot> measure(const Component& component, const Background& background);
  Weighed weigh(const Window& box, const Component& component, float foot, float slope);
  void mark_around_foreign(const Window& box, const Component& component);

  int width_ = 0;
  int height_ = 0;
  std::vector<float> signal_;  // (height, width) [grey levels]
  Components components_;
  std::vector<float> values_;  // of which a quantile is asked for
  Quantile quantile_;
  std::vector<std::uint8_t> foreign_;  // 1 in or beside another component, (height, width) of a box
};

}  // namespace softgrip::vision
