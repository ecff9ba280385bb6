// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_vision._core; the typed faces are colour.py, spots.py, appearance.py,
// calibration.py and chain.py. A call takes microseconds: the interpreter lock is kept.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "softgrip/vision/appearance.hpp"
#include "softgrip/vision/chain.hpp"
#include "softgrip/vision/image.hpp"
#include "softgrip/vision/plane.hpp"
#include "softgrip/vision/spots.hpp"

namespace py = pybind11;
using namespace softgrip::vision;

namespace pybind11::detail {

// To Python as a tuple of numbers, in the order of softgrip_vision.spots.Spot.
template <>
struct type_caster<softgrip::vision::Spot> {
  PYBIND11_TYPE_CASTER(softgrip::vision::Spot, const_name("tuple[float, ...]"));
  static handle cast(const softgrip::vision::Spot& spot, return_value_policy, handle) {
    return make_tuple(spot.u, spot.v, spot.stddev_px, spot.area_px, spot.roundness, spot.solidity, spot.height,
                      spot.surroundings, spot.noise)
        .release();
  }
};

}  // namespace pybind11::detail

namespace {

using Index = Eigen::Index;

// A view of (h, w, 3) BGR; `pixels` is replaced by a copy when the bytes of a pixel, or the pixels of a row, do not
// lie side by side.
Image image_of(py::array& pixels) {
  if (!py::isinstance<py::array_t<std::uint8_t>>(pixels) || pixels.ndim() != 3 || pixels.shape(2) != 3) {
    throw std::invalid_argument("image: expected 8-bit BGR (h, w, 3), found " +
                                py::str(pixels.dtype()).cast<std::string>() + " of " +
                                py::str(pixels.attr("shape")).cast<std::string>());
  }
  if (pixels.size() > std::numeric_limits<int>::max()) throw std::invalid_argument("image: expected below 2^31 bytes");
  if (pixels.size() > 0 && (pixels.strides(2) != 1 || pixels.strides(1) != 3)) {
    pixels = py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>(pixels);
  }
  return {static_cast<const std::uint8_t*>(pixels.data()), static_cast<int>(pixels.shape(1)),
          static_cast<int>(pixels.shape(0)), pixels.strides(0)};
}

void require_finite(const ColourForms& forms) {
  for (const auto& form : forms) {
    for (const float share : form) {
      if (!std::isfinite(share)) throw std::invalid_argument("forms: expected finite numbers");
    }
  }
}

py::array_t<float> signal(py::array pixels, const ColourForms& forms) {
  const Image image = image_of(pixels);
  py::array_t<float> out({image.height, image.width});
  SignalOf{forms}(image, {0, 0, image.width, image.height}, out.mutable_data());
  return out;
}

// (n, 5): left, top, width, height and area of each.
py::array_t<int> components(const py::array_t<float, py::array::c_style>& signal, double threshold) {
  static thread_local Components found;
  if (signal.ndim() != 2 || signal.size() > std::numeric_limits<int>::max()) {
    throw std::invalid_argument("signal: expected (h, w) of fewer than 2^31 pixels");
  }
  found.find(signal.data(), static_cast<int>(signal.shape(1)), static_cast<int>(signal.shape(0)),
             static_cast<float>(threshold));
  py::array_t<int> boxes({static_cast<py::ssize_t>(found.all().size()), py::ssize_t{5}});
  int* box = boxes.mutable_data();
  for (const Component& one : found.all()) {
    for (const int value : {one.left, one.top, one.right - one.left, one.bottom - one.top, one.area}) *box++ = value;
  }
  return boxes;
}

std::vector<std::vector<Spot>> find_spots(py::array pixels, const std::vector<std::array<int, 4>>& windows,
                                          const ColourForms& forms, const std::vector<double>& thresholds,
                                          const std::array<double, 2>& area_px) {
  // What a window took of memory serves the next one, of the next frame as well.
  static thread_local SpotFinder finder;
  const Image image = image_of(pixels);
  require_finite(forms);
  if (thresholds.size() != windows.size()) {
    throw std::invalid_argument("thresholds: expected one for each of " + std::to_string(windows.size()) +
                                " windows, found " + std::to_string(thresholds.size()));
  }
  if (!(area_px[0] >= 0.0 && area_px[0] <= area_px[1])) {
    throw std::invalid_argument("area_range_px: expected 0 <= smallest <= largest");
  }
  std::vector<std::vector<Spot>> found;
  found.reserve(windows.size());
  for (std::size_t i = 0; i < windows.size(); ++i) {
    const auto [left, top, width, height] = windows[i];
    const Window window{left, top, width, height};
    if (!window.within(image)) {
      throw std::invalid_argument("windows: expected left, top, width, height inside the image, found (" +
                                  std::to_string(left) + ", " + std::to_string(top) + ", " + std::to_string(width) +
                                  ", " + std::to_string(height) + ")");
    }
    if (!std::isfinite(thresholds[i])) throw std::invalid_argument("thresholds: expected finite grey levels");
    found.push_back(finder.find(image, window, forms, static_cast<float>(thresholds[i]), {area_px[0], area_px[1]}));
  }
  return found;
}

Image filled(py::array& pixels) {
  const Image image = image_of(pixels);
  if (image.width == 0 || image.height == 0) throw std::invalid_argument("image: expected pixels, found none");
  return image;
}

py::array_t<double> colours_at(py::array pixels, const Points& centres_px) {
  const Image image = filled(pixels);
  py::array_t<double> colours({centres_px.rows(), Index{3}});
  for (Index i = 0; i < centres_px.rows(); ++i) {
    const std::array<double, 3> colour = colour_at(image, centres_px(i, 0), centres_px(i, 1));
    std::copy(colour.begin(), colour.end(), colours.mutable_data(i));
  }
  return colours;
}

std::vector<double> surrounds(py::array pixels, const Points& centres_px, const std::vector<double>& radii_px,
                              bool body_is_brighter) {
  const Image image = filled(pixels);
  if (static_cast<Index>(radii_px.size()) != centres_px.rows()) {
    throw std::invalid_argument("radii_px: expected one for each centre");
  }
  std::vector<double> found;
  for (Index i = 0; i < centres_px.rows(); ++i) {
    found.push_back(surround_of(image, centres_px(i, 0), centres_px(i, 1), radii_px[i], body_is_brighter));
  }
  return found;
}

Lens make_lens(const Eigen::Matrix3d& matrix, const std::vector<double>& distortion) {
  std::array<double, 8> padded{};
  if (distortion.size() > padded.size()) throw std::invalid_argument("distortion: expected 8 coefficients at most");
  std::copy(distortion.begin(), distortion.end(), padded.begin());
  return {matrix, padded};
}

// Every row of (n, 2) through a function.
template <class Function>
Points for_each(const Points& points, Function function) {
  Points out(points.rows(), 2);
  for (Index i = 0; i < points.rows(); ++i) out.row(i) = function(points.row(i).transpose());
  return out;
}

py::tuple to_plane_with_jacobian(const PlaneMap& map, const Points& pixels) {
  Points points(pixels.rows(), 2);
  py::array_t<double> jacobians({pixels.rows(), Index{2}, Index{2}});
  for (Index i = 0; i < pixels.rows(); ++i) {
    const PlanePoint found = map.to_plane(pixels.row(i).transpose());
    points.row(i) = found.point_m;
    Eigen::Map<Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(jacobians.mutable_data(i)) = found.by_pixel;
  }
  return py::make_tuple(std::move(points), std::move(jacobians));
}

void require_marker(const Chain& chain, Index marker) {
  if (marker < 0 || marker >= chain.joints() + 2) {
    throw std::invalid_argument("marker: expected 0 .. " + std::to_string(chain.joints() + 1) + ", found " +
                                std::to_string(marker));
  }
}

void require_points(const Chain& chain, const Points& points) {
  if (points.rows() != chain.joints() + 2) {
    throw std::invalid_argument("points: expected (" + std::to_string(chain.joints() + 2) + ", 2), found " +
                                std::to_string(points.rows()) + " rows");
  }
}

std::pair<double, double> pair_of(const Vector2& place) {
  return {place.x(), place.y()};
}

void bind_spots(py::module_& module) {
  module.def("signal", &signal, py::arg("image"), py::arg("forms"));
  module.def("components", &components, py::arg("signal").noconvert(), py::arg("threshold"));
  module.def("find_spots", &find_spots, py::arg("image"), py::arg("windows"), py::arg("forms"), py::arg("thresholds"),
             py::arg("area_range_px"));
}

void bind_appearance(py::module_& module) {
  module.def("colours_at", &colours_at, py::arg("image"), py::arg("centres_px"));
  module.def("surrounds", &surrounds, py::arg("image"), py::arg("centres_px"), py::arg("radii_px"),
             py::arg("body_is_brighter"));
}

void bind_plane(py::module_& module) {
  py::class_<Lens>(module, "Lens")
      .def(py::init(&make_lens), py::arg("matrix"), py::arg("distortion"))
      .def("distort",
           [](const Lens& lens, const Points& undistorted_px) {
             return for_each(undistorted_px, [&](const Vector2& pixel) { return lens.distort(pixel); });
           })
      .def("undistort", [](const Lens& lens, const Points& pixels) {
        return for_each(pixels, [&](const Vector2& pixel) { return lens.undistort(pixel); });
      });
  py::class_<PlaneMap>(module, "PlaneMap")
      .def(py::init<const Lens&, const Eigen::Matrix3d&>(), py::arg("lens"), py::arg("homography"))
      .def("to_pixels",
           [](const PlaneMap& map, const Points& points_m) {
             return for_each(points_m, [&](const Vector2& point) { return map.to_pixel(point); });
           })
      .def("to_pixel",
           [](const PlaneMap& map, const std::pair<double, double>& point_m) {
             return pair_of(map.to_pixel({point_m.first, point_m.second}));
           })
      .def("to_plane",
           [](const PlaneMap& map, const Points& pixels) {
             return for_each(pixels, [&](const Vector2& pixel) { return map.to_plane(pixel).point_m; });
           })
      .def("to_plane_with_jacobian", &to_plane_with_jacobian);
}

void bind_chain(py::module_& module) {
  module.attr("MOUNT_DRIFT") = py::make_tuple(kMountDrift[0], kMountDrift[1], kMountDrift[2]);
  module.attr("SPEED_STDDEV") = kSpeedStddev;
  module.attr("SPEED_TIME") = kSpeedTime_s;
  py::class_<Chain>(module, "Chain")
      .def(py::init<std::vector<double>, double>(), py::arg("link_lengths_m"), py::arg("base_marker_m"))
      .def("markers",
           [](const Chain& chain, const Vector& state) {
             if (state.size() < 3 + chain.joints()) throw std::invalid_argument("state: expected (3 + 2 n,)");
             return chain.markers(state);
           })
      .def("jacobian",
           [](const Chain& chain, const Points& points, Index marker) {
             require_points(chain, points);
             require_marker(chain, marker);
             return chain.jacobian(points, marker);
           })
      .def("angles", [](const Chain& chain, const Points& points) {
        require_points(chain, points);
        return chain.angles(points);
      });
  py::class_<ChainFilter>(module, "ChainFilter")
      .def(py::init<Chain>(), py::arg("chain"))
      .def_property(
          "state", [](const ChainFilter& filter) { return filter.state; },
          [](ChainFilter& filter, const Vector& state) {
            if (state.size() != filter.state.size()) throw std::invalid_argument("state: expected (3 + 2 n,)");
            filter.state = state;
          })
      .def_property(
          "covariance", [](const ChainFilter& filter) { return filter.covariance; },
          [](ChainFilter& filter, const Matrix& covariance) {
            if (covariance.rows() != filter.state.size() || covariance.cols() != filter.state.size()) {
              throw std::invalid_argument("covariance: expected (3 + 2 n, 3 + 2 n)");
            }
            filter.covariance = covariance;
          })
      .def("place",
           [](ChainFilter& filter, const Points& points) {
             require_points(filter.chain(), points);
             filter.place(points);
           })
      .def("predict",
           [](ChainFilter& filter, double seconds) {
             if (!(seconds > 0.0)) throw std::invalid_argument("seconds: expected > 0");
             filter.predict(seconds);
           })
      .def("expect",
           [](const ChainFilter& filter, Index marker) {
             require_marker(filter.chain(), marker);
             const auto [place, spread] = filter.expect(marker);
             return std::make_pair(pair_of(place), std::make_tuple(spread(0, 0), spread(0, 1), spread(1, 1)));
           })
      .def("update",
           [](ChainFilter& filter, Index marker, const std::pair<double, double>& position,
              const std::tuple<double, double, double>& spread) {
             require_marker(filter.chain(), marker);
             const auto [xx, xy, yy] = spread;
             filter.update(marker, {position.first, position.second}, (Matrix2() << xx, xy, xy, yy).finished());
           })
      .def("settle_hidden",
           [](ChainFilter& filter, const std::vector<bool>& hidden) {
             if (static_cast<Index>(hidden.size()) != filter.chain().joints() + 2) {
               throw std::invalid_argument("hidden: expected one for each marker");
             }
             return filter.settle_hidden(hidden);
           })
      .def("heading",
           [](const ChainFilter& filter, Index link) {
             if (link < 0 || link > filter.chain().joints()) throw std::invalid_argument("link: expected 0 .. n");
             return filter.heading(link);
           })
      .def("angles_stddev", &ChainFilter::angles_stddev)
      .def("tip", &ChainFilter::tip);
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_vision.";
  bind_spots(module);
  bind_appearance(module);
  bind_plane(module);
  bind_chain(module);
}
