// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.finger._core; the typed face is softgrip_model.finger.kernel.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <stdexcept>

#include "batch.hpp"
#include "softgrip/finger_solver.hpp"

namespace py = pybind11;
namespace sf = softgrip::finger;
namespace fr = softgrip::friction;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Numbers = std::vector<double>;

namespace {

template <std::size_t N>
void fill(std::array<double, N>& to, const Numbers& from, std::size_t count, const char* name) {
  if (from.size() != count || count > N) throw std::invalid_argument(std::string(name) + ": wrong number of values");
  std::copy(from.begin(), from.end(), to.begin());
}

sf::Design make_design(double base, double width, const Numbers& link, const Numbers& thickness, const Numbers& length,
                       const Numbers& opening, const Numbers& routing, const std::array<double, 3>& modulus,
                       int moment_law, double max_strain, double stop_margin, double stop_moment, double compliance,
                       double lead, double smoothing) {
  sf::Design d;
  const std::size_t n = thickness.size();
  if (n < 1 || n > sf::kMaxJoints) throw std::invalid_argument("expected 1 to 6 joints");
  d.joints = static_cast<int>(n);
  d.base_mm = base;
  d.width_mm = width;
  fill(d.link_mm, link, n, "link_mm");
  fill(d.thickness_mm, thickness, n, "thickness_mm");
  fill(d.length_mm, length, n, "length_mm");
  fill(d.opening_rad, opening, n, "opening_rad");
  fill(d.routing_mm, routing, 2 * n, "routing_mm");
  d.material = {modulus[0], modulus[1], modulus[2], static_cast<sf::MomentLaw>(moment_law), max_strain};
  d.stop = {stop_margin, stop_moment};
  d.cable = {compliance, lead};
  d.angle_smoothing_rad = smoothing;
  return d;
}

fr::Model make_friction(int law, int k_reading, const Numbers& coefficients, double radius_mm,
                        const std::pair<double, double>& angle, const std::pair<double, double>& tension) {
  fr::Model model{static_cast<fr::Law>(law), static_cast<fr::KReading>(k_reading), {}, radius_mm,
                  {angle.first, angle.second}, {tension.first, tension.second}};
  fill(model.coefficients, coefficients, fr::coefficient_count(model.law), "coefficients");
  return model;
}

// m designs with one friction law each; solved together.
class Fingers {
 public:
  Fingers(std::vector<sf::Design> designs, std::vector<fr::Model> frictions)
      : designs_(std::move(designs)), frictions_(std::move(frictions)) {
    if (designs_.empty() || designs_.size() != frictions_.size()) {
      throw std::invalid_argument("expected one friction law per design, and at least one design");
    }
    for (const sf::Design& d : designs_) joints_ = std::max(joints_, d.joints);
  }

  // The first design with other thicknesses (m, n) and routing (m, 2n).
  Fingers varied(const Array& thickness, const Array& routing) const {
    const int n = designs_[0].joints;
    if (thickness.ndim() != 2 || routing.ndim() != 2 || thickness.shape(0) != routing.shape(0) ||
        thickness.shape(1) != n || routing.shape(1) != 2 * n) {
      throw std::invalid_argument("expected thickness (m, n) and routing (m, 2n)");
    }
    std::vector<sf::Design> designs(thickness.shape(0), designs_[0]);
    for (std::size_t i = 0; i < designs.size(); ++i) {
      std::copy_n(thickness.data(i, 0), n, designs[i].thickness_mm.begin());
      std::copy_n(routing.data(i, 0), 2 * n, designs[i].routing_mm.begin());
    }
    const std::size_t count = designs.size();
    return {std::move(designs), std::vector<fr::Model>(count, frictions_[0])};
  }

  py::dict solve(const Array& targets, int control, bool march, bool sensitivities, int threads) const {
    if (targets.ndim() != 2 || targets.shape(0) != static_cast<py::ssize_t>(designs_.size())) {
      throw std::invalid_argument("expected targets (designs, k)");
    }
    const py::ssize_t m = targets.shape(0), k = targets.shape(1), n = joints_;
    for (const fr::Model& f : frictions_) {
      if (sensitivities && f.law != frictions_[0].law) throw std::invalid_argument("sensitivities need one law");
    }
    const py::ssize_t rows = sf::sensitivity_rows(joints_);
    const py::ssize_t columns = sf::sensitivity_columns(joints_, frictions_[0].law);
    py::array_t<double> angle({m, k, n}), tension({m, k, 2 * n + 1}), phi({m, k, 2 * n}), rate({m, k, n});
    py::array_t<double> tip({m, k, py::ssize_t{2}}), pulled({m, k});
    py::array_t<double> gradient({sensitivities ? m : 0, k, rows, columns});
    py::array_t<std::uint32_t> status({m, k});
    py::array_t<int> iterations({m, k});
    sf::BatchOut out{angle.mutable_data(),  tension.mutable_data(), phi.mutable_data(),
                     rate.mutable_data(),   tip.mutable_data(),     pulled.mutable_data(),
                     sensitivities ? gradient.mutable_data() : nullptr,
                     status.mutable_data(), iterations.mutable_data(), joints_};
    {
      py::gil_scoped_release release;
      sf::solve_batch(designs_, frictions_, targets.data(), static_cast<std::size_t>(k),
                      static_cast<sf::Control>(control), march, threads, out);
    }
    py::dict result;
    result["angle_rad"] = angle;
    result["tension_n"] = tension;
    result["phi_rad"] = phi;
    result["pull_rate"] = rate;
    result["tip_mm"] = tip;
    result["pulled_mm"] = pulled;
    result["status"] = status;
    result["iterations"] = iterations;
    if (sensitivities) result["gradient"] = gradient;
    return result;
  }

  int joints() const { return joints_; }
  std::size_t count() const { return designs_.size(); }

 private:
  std::vector<sf::Design> designs_;
  std::vector<fr::Model> frictions_;
  int joints_ = 0;
};

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_model.finger.";
  module.attr("MAX_JOINTS") = sf::kMaxJoints;
  py::class_<sf::Design>(module, "Design")
      .def(py::init(&make_design), py::kw_only(), py::arg("base_mm"), py::arg("width_mm"), py::arg("link_mm"),
           py::arg("thickness_mm"), py::arg("length_mm"), py::arg("opening_rad"), py::arg("routing_mm"),
           py::arg("modulus_mpa"), py::arg("moment_law"), py::arg("max_strain"), py::arg("stop_margin_rad"),
           py::arg("stop_moment_nmm"), py::arg("compliance_per_n"), py::arg("lead_mm"), py::arg("smoothing_rad"));
  py::class_<fr::Model>(module, "Friction")
      .def(py::init(&make_friction), py::arg("law"), py::arg("k_reading"), py::arg("coefficients"),
           py::arg("radius_mm"), py::arg("angle_range"), py::arg("tension_range"));
  py::class_<Fingers>(module, "Fingers")
      .def(py::init<std::vector<sf::Design>, std::vector<fr::Model>>())
      .def("varied", &Fingers::varied)
      .def("solve", &Fingers::solve, py::arg("targets"), py::arg("control"), py::arg("march"),
           py::arg("sensitivities"), py::arg("threads"))
      .def_property_readonly("joints", &Fingers::joints)
      .def("__len__", &Fingers::count);
}
