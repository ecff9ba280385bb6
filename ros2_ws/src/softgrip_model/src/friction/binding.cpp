// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.friction._core; the typed face is softgrip_model.friction.laws and .fit.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <stdexcept>

#include "fit.hpp"
#include "softgrip/friction.hpp"

namespace py = pybind11;
using namespace softgrip::friction;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

namespace {

Model make_model(int law, int k_reading, const std::vector<double>& coefficients, double radius_mm, Range angle_rad,
                 Range tension_N) {
  Model model{static_cast<Law>(law), static_cast<KReading>(k_reading), {}, radius_mm, angle_rad, tension_N};
  if (coefficients.size() > model.coefficients.size()) throw std::invalid_argument("at most 4 coefficients");
  std::copy(coefficients.begin(), coefficients.end(), model.coefficients.begin());
  return model;
}

Range make_range(const std::pair<double, double>& ends) {
  return {ends.first, ends.second};
}

Eigen::Map<const Eigen::VectorXd> vector_of(const Array& array) {
  return {array.data(), array.size()};
}

py::tuple evaluate_many(int law, int k_reading, const std::vector<double>& coefficients, double radius_mm,
                        const std::pair<double, double>& angle_range, const std::pair<double, double>& tension_range,
                        const Array& angle, const Array& tension) {
  const Model model =
      make_model(law, k_reading, coefficients, radius_mm, make_range(angle_range), make_range(tension_range));
  const py::ssize_t count = angle.size();
  if (tension.size() != count) throw std::invalid_argument("angle and tension differ in length");
  py::array_t<double> log_ratio(count), d_angle(count), d_log_tension(count);
  py::array_t<double> d_coefficients({count, static_cast<py::ssize_t>(coefficient_count(model.law))});
  py::array_t<std::uint8_t> status(count);
  auto slopes = d_coefficients.mutable_unchecked<2>();
  for (py::ssize_t i = 0; i < count; ++i) {
    const Evaluation value = evaluate(model, angle.data()[i], tension.data()[i]);
    log_ratio.mutable_data()[i] = value.log_ratio;
    d_angle.mutable_data()[i] = value.d_angle;
    d_log_tension.mutable_data()[i] = value.d_log_tension;
    status.mutable_data()[i] = value.status;
    for (py::ssize_t j = 0; j < slopes.shape(1); ++j) slopes(i, j) = value.d_coefficients[j];
  }
  return py::make_tuple(log_ratio, d_angle, d_log_tension, d_coefficients, status);
}

double blow_up(int law, int k_reading, const std::vector<double>& coefficients, double radius_mm, double tension_N) {
  return blow_up_angle(make_model(law, k_reading, coefficients, radius_mm, {}, {}), tension_N);
}

py::tuple fit_law(int law, int k_reading, double radius_mm, const Array& angle, const Array& tension,
                  const Array& ratio, const Array& weight, int loss, const Coefficients& lower,
                  const Coefficients& upper, const std::optional<Coefficients>& start) {
  if (tension.size() != angle.size() || ratio.size() != angle.size() || weight.size() != angle.size()) {
    throw std::invalid_argument("angle, tension, ratio and weight differ in length");
  }
  const Model model = make_model(law, k_reading, {}, radius_mm, {}, {});
  const Data data{vector_of(angle), vector_of(tension), vector_of(ratio), vector_of(weight)};
  const Bounds bounds{lower, upper};
  const Fit best = start ? fit_from(model, data, static_cast<Loss>(loss), bounds, *start)
                         : fit(model, data, static_cast<Loss>(loss), bounds);
  const std::vector<double> coefficients(best.coefficients.begin(),
                                         best.coefficients.begin() + coefficient_count(model.law));
  return py::make_tuple(coefficients, best.cost, best.iterations, best.converged);
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_model.friction.";
  module.attr("TENSION_FLOOR_N") = kTensionFloor_N;
  module.def("evaluate", &evaluate_many);
  module.def("blow_up_angle", &blow_up);
  module.def("fit", &fit_law);
}
