// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.gdfe._core.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "softgrip/gdfe/simd.hpp"
#include "softgrip/gdfe/solver.hpp"
#include "softgrip/gdfe/stream.hpp"

namespace py = pybind11;
namespace gdfe = softgrip::gdfe;

namespace {

gdfe::SecantTables make_tables(const Eigen::Ref<const Eigen::MatrixXd>& coefficients, int cells, double end,
                               const std::vector<double>& lame_per_mu) {
  gdfe::SecantTables tables;
  tables.cells = cells;
  tables.end = end;
  tables.lame_per_mu = lame_per_mu;
  for (Eigen::Index material = 0; 4 * material < coefficients.rows(); ++material) {  // [material * 4 + order][cell]
    for (Eigen::Index cell = 0; cell < coefficients.cols(); ++cell) {
      for (Eigen::Index order = 0; order < 4; ++order) tables.coefficients.push_back(coefficients(4 * material + order, cell));
    }
  }
  return tables;
}

softgrip::friction::Model make_friction(int law, int k_reading, const std::vector<double>& coefficients, double radius_mm) {
  softgrip::friction::Model friction;
  friction.law = static_cast<softgrip::friction::Law>(law);
  friction.k_reading = static_cast<softgrip::friction::KReading>(k_reading);
  std::copy(coefficients.begin(), coefficients.end(), friction.coefficients.begin());
  friction.radius_mm = radius_mm;
  return friction;
}

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

template <class T>
std::vector<T> as_vector(const Array<T>& array) {
  return {array.data(), array.data() + array.size()};
}

Array<double> as_array(const std::vector<double>& values) {
  return Array<double>(static_cast<py::ssize_t>(values.size()), values.data());
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_model.gdfe.";
  module.def("simd_target", &gdfe::simd_target);
  module.def("simd_targets", &gdfe::simd_targets);
  module.def("use_simd_target", &gdfe::use_simd_target, py::arg("name"));
  module.def("read_bandwidth", &gdfe::read_bandwidth, py::arg("working_set"), py::arg("threads"), py::arg("repeats"));

  py::class_<gdfe::Element>(module, "Element")
      .def_readonly("volume", &gdfe::Element::volume)
      .def_readonly("gradient", &gdfe::Element::gradient)
      .def_readonly("laplacian", &gdfe::Element::laplacian);
  module.def("make_element", [](const gdfe::Corners& rest) { return gdfe::make_element(rest); }, py::arg("rest"));
  module.def(
      "min_jacobians",
      [](const gdfe::Nodes& rest, const gdfe::Hexes& hexes) {
        Eigen::VectorXd least(hexes.rows());
        for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
          least(e) = gdfe::min_jacobian(gdfe::corners_of(rest, hexes, e));
        }
        return least;
      },
      py::arg("rest"), py::arg("hexes"));

  py::class_<gdfe::SecantTables>(module, "SecantTables")
      .def(py::init(&make_tables), py::arg("coefficients"), py::arg("cells"), py::arg("end"), py::arg("lame_per_mu"));

  py::class_<gdfe::OgdenMaterial>(module, "OgdenMaterial")
      .def(py::init([](std::vector<double> moduli, std::vector<double> exponents, double bulk) {
             return gdfe::OgdenMaterial{std::move(moduli), std::move(exponents), bulk};
           }),
           py::arg("moduli"), py::arg("exponents"), py::arg("bulk"));

  py::class_<gdfe::CablePoint>(module, "CablePoint")
      .def(py::init([](std::vector<std::int32_t> nodes, std::vector<double> weights, const Eigen::Vector3d& fixed) {
             return gdfe::CablePoint{std::move(nodes), std::move(weights), fixed};
           }),
           py::arg("nodes"), py::arg("weights"), py::arg("fixed"));
  py::class_<gdfe::Cable>(module, "Cable")
      .def(py::init([](std::vector<gdfe::CablePoint> points, const Eigen::Vector3d& entry, int law, int k_reading,
                       const std::vector<double>& coefficients, double radius_mm) {
             gdfe::Cable cable;
             cable.points = std::move(points);
             cable.entry = entry;
             cable.friction = make_friction(law, k_reading, coefficients, radius_mm);
             return cable;
           }),
           py::arg("points"), py::arg("entry"), py::arg("law"), py::arg("k_reading"), py::arg("coefficients"),
           py::arg("radius_mm"));

  py::class_<gdfe::FollowerPatch>(module, "FollowerPatch")
      .def(py::init([](std::vector<std::int32_t> nodes, std::vector<double> shares) {
             return gdfe::FollowerPatch{std::move(nodes), std::move(shares)};
           }),
           py::arg("nodes"), py::arg("shares"));
  py::class_<gdfe::Obstacle>(module, "Obstacle")
      .def(py::init([](int kind, const Eigen::Vector3d& point, const Eigen::Vector3d& axis, double radius, double friction,
                       std::vector<std::int32_t> nodes) {
             return gdfe::Obstacle{static_cast<gdfe::ObstacleKind>(kind), point, axis, radius, friction, std::move(nodes)};
           }),
           py::arg("kind"), py::arg("point"), py::arg("axis"), py::arg("radius"), py::arg("friction"), py::arg("nodes"));
  py::class_<gdfe::Surroundings>(module, "Surroundings")
      .def(py::init([](std::vector<gdfe::PressedSurface> pressed, std::vector<gdfe::FollowerPatch> followers,
                       std::vector<gdfe::Obstacle> obstacles) {
             return gdfe::Surroundings{std::move(pressed), std::move(followers), std::move(obstacles)};
           }),
           py::arg("pressed"), py::arg("followers"), py::arg("obstacles"));
  py::class_<gdfe::Touch>(module, "Touch")
      .def_readonly("obstacle", &gdfe::Touch::obstacle)
      .def_readonly("node", &gdfe::Touch::node)
      .def_readonly("gap", &gdfe::Touch::gap)
      .def_readonly("force", &gdfe::Touch::force)
      .def_readonly("sliding", &gdfe::Touch::sliding);

  py::class_<gdfe::Settings>(module, "Settings")
      .def(py::init([](int law, int shape, int metric, bool single_precision_factor, int ordering, int method, int window,
                       int threads, double step_limit, int sections_after) {
             return gdfe::Settings{static_cast<gdfe::Law>(law), static_cast<gdfe::VolumeShape>(shape),
                                   static_cast<gdfe::Metric>(metric), single_precision_factor,
                                   static_cast<gdfe::Ordering>(ordering), static_cast<gdfe::Method>(method), window, threads,
                                   step_limit, sections_after};
           }),
           py::arg("law"), py::arg("shape"), py::arg("metric"), py::arg("single_precision_factor"), py::arg("ordering"),
           py::arg("method"), py::arg("window"), py::arg("threads"), py::arg("step_limit"), py::arg("sections_after"));

  py::class_<gdfe::Outcome>(module, "Outcome")
      .def_readonly("converged", &gdfe::Outcome::converged)
      .def_readonly("iterations", &gdfe::Outcome::iterations)
      .def_readonly("residual", &gdfe::Outcome::residual)
      .def_readonly("length_error", &gdfe::Outcome::length_error)
      .def_readonly("displacement", &gdfe::Outcome::displacement)
      .def_readonly("reaction", &gdfe::Outcome::reaction)
      .def_property_readonly("strain", [](const gdfe::Outcome& outcome) { return as_array(outcome.strain); })
      .def_readonly("anchor_tension", &gdfe::Outcome::anchor_tension)
      .def_readonly("tension", &gdfe::Outcome::tension)
      .def_readonly("shortening", &gdfe::Outcome::shortening)
      .def_readonly("touches", &gdfe::Outcome::touches)
      .def_readonly("history", &gdfe::Outcome::history);

  py::class_<gdfe::Solver>(module, "Solver")
      .def(py::init([](const gdfe::Nodes& rest, const gdfe::Hexes& hexes, const Array<int>& materials,
                       const gdfe::SecantTables& tables, const Array<double>& matrix_weight,
                       const std::array<Array<std::int32_t>, 3>& maps, const std::vector<gdfe::Cable>& cables,
                       const std::vector<gdfe::OgdenMaterial>& ogden, const gdfe::Surroundings& surroundings,
                       const gdfe::Settings& settings) {
             const std::vector<int> material = as_vector(materials);
             const std::vector<double> weight = as_vector(matrix_weight);
             const std::array dofs{as_vector(maps[0]), as_vector(maps[1]), as_vector(maps[2])};
             const py::gil_scoped_release release;
             return std::make_unique<gdfe::Solver>(rest, hexes, material, tables, weight, dofs, cables, ogden, surroundings, settings);
           }),
           py::arg("rest"), py::arg("hexes"), py::arg("materials"), py::arg("tables"), py::arg("matrix_weight"),
           py::arg("maps"), py::arg("cables"), py::arg("ogden"), py::arg("surroundings"), py::arg("settings"))
      .def(
          "solve",
          [](gdfe::Solver& solver, const gdfe::Nodes& prescribed, const gdfe::Nodes& load,
             const std::vector<std::pair<bool, double>>& drives, double tolerance, double force_floor,
             double length_tolerance, int max_iterations, const gdfe::Nodes& start, const std::vector<double>& start_tension,
             const std::vector<double>& pressures, const std::vector<Eigen::Vector3d>& follower_forces,
             const std::vector<Eigen::Vector3d>& motions, const std::vector<Eigen::Vector3d>& motions_before,
             const gdfe::Nodes& before) {
            gdfe::Task task;
            task.pressures = pressures;
            task.follower_forces = follower_forces;
            task.motions = motions;
            task.motions_before = motions_before;
            task.before = before;
            task.prescribed = prescribed;
            task.load = load;
            for (const auto& [by_length, target] : drives) task.drives.push_back({by_length, target});
            task.tolerance = tolerance;
            task.force_floor = force_floor;
            task.length_tolerance = length_tolerance;
            task.max_iterations = max_iterations;
            const py::gil_scoped_release release;
            return solver.solve(task, start, start_tension);
          },
          py::arg("prescribed"), py::arg("load"), py::arg("drives"), py::arg("tolerance"), py::arg("force_floor"),
          py::arg("length_tolerance"), py::arg("max_iterations"), py::arg("start"), py::arg("start_tension"),
          py::arg("pressures"), py::arg("follower_forces"), py::arg("motions"), py::arg("motions_before"), py::arg("before"))
      .def(
          "set_friction",
          [](gdfe::Solver& solver, std::size_t cable, int law, int k_reading, const std::vector<double>& coefficients,
             double radius_mm) { solver.set_friction(cable, make_friction(law, k_reading, coefficients, radius_mm)); },
          py::arg("cable"), py::arg("law"), py::arg("k_reading"), py::arg("coefficients"), py::arg("radius_mm"))
      .def("energy", &gdfe::Solver::energy, py::arg("displacement"))
      .def("internal_force", &gdfe::Solver::internal_force, py::arg("displacement"))
      .def("strain", [](const gdfe::Solver& solver) { return as_array(solver.strain()); })
      .def(
          "set_thesis_state",
          [](gdfe::Solver& solver, const Array<double>& omega, const Array<double>& last_strain) {
            solver.set_thesis_state(as_vector(omega), as_vector(last_strain));
          },
          py::arg("omega"), py::arg("last_strain"))
      .def_property_readonly("unknowns", &gdfe::Solver::unknowns)
      .def_property_readonly("element_bytes", &gdfe::Solver::element_bytes)
      .def("inverse_nonzeros", [](const gdfe::Solver& solver, int axis) { return solver.inverse(axis).nonzeros(); })
      .def("inverse_bytes", [](const gdfe::Solver& solver, int axis) { return solver.inverse(axis).bytes(); });
}
