// SPDX-License-Identifier: Apache-2.0
// What the pixels in and around a marker look like (softgrip_vision.marker_appearance).
#pragma once

#include <array>

#include "softgrip/vision/image.hpp"

namespace softgrip::vision {

// Mean (B, G, R) of the 3x3 pixels at a place [px]; outside of the image its border counts.
std::array<double, 3> colour_at(const Image& image, double u, double v);

// Brightness of a finger's body, the brighter or the darker part of the ring around a marker, over the marker's own.
double surround_of(const Image& image, double u, double v, double radius_px, bool body_is_brighter);

}  // namespace softgrip::vision
