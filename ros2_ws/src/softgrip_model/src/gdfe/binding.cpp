// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.gdfe._core.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "softgrip/gdfe/element_forces.hpp"
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
      for (Eigen::Index order = 0; order < 4; ++order)
        tables.coefficients.push_back(coefficients(4 * material + order, cell));
    }
  }
  return tables;
}

softgrip::friction::Model make_friction(int law, int k_reading, const std::vector<double>& coefficients,
                                        double radius_mm) {
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

// A value with these fields, the others as they are by default.
template <class Value>
Value from_fields(const py::kwargs& fields) {
  py::object value = py::cast(Value());
  for (const auto& [name, field] : fields) py::setattr(value, name, field);
  return std::move(value.cast<Value&>());
}

template <class Enum>
void bind_enum(py::module_& module, const char* name, std::initializer_list<std::pair<const char*, Enum>> values) {
  py::enum_<Enum> bound(module, name);
  for (const auto& [key, value] : values) bound.value(key, value);
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
        Eigen::VectorXd lowest(hexes.rows());
        for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
          lowest(e) = gdfe::min_jacobian(gdfe::corners_of(rest, hexes, e));
        }
        return lowest;
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

  py::class_<gdfe::CableState>(module, "CableState")
      .def_readonly("force", &gdfe::CableState::force)
      .def_readonly("slope", &gdfe::CableState::slope)
      .def_readonly("tension", &gdfe::CableState::tension)
      .def_property_readonly("length", [](const gdfe::CableState& state) { return state.length + state.entry_length; })
      .def_readonly("sound", &gdfe::CableState::sound);
  module.def("pull_from_anchor", &gdfe::pull_from_anchor, py::arg("cable"), py::arg("points"),
             py::arg("anchor_tension"));

  py::class_<gdfe::FollowerPatch>(module, "FollowerPatch")
      .def(py::init([](std::vector<std::int32_t> nodes, std::vector<double> shares) {
             return gdfe::FollowerPatch{std::move(nodes), std::move(shares)};
           }),
           py::arg("nodes"), py::arg("shares"));
  py::class_<gdfe::Obstacle>(module, "Obstacle")
      .def(py::init([](int kind, const Eigen::Vector3d& point, const Eigen::Vector3d& axis, double radius,
                       double friction, std::vector<std::int32_t> nodes) {
             return gdfe::Obstacle{
                 static_cast<gdfe::ObstacleKind>(kind), point, axis, radius, friction, std::move(nodes)};
           }),
           py::arg("kind"), py::arg("point"), py::arg("axis"), py::arg("radius"), py::arg("friction"),
           py::arg("nodes"));
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

  bind_enum<gdfe::Law>(
      module, "Law",
      {{"calibrated", gdfe::Law::Calibrated}, {"thesis", gdfe::Law::Thesis}, {"rigorous", gdfe::Law::Rigorous}});
  bind_enum<gdfe::VolumeShape>(module, "VolumeShape",
                               {{"proj", gdfe::VolumeShape::Proj}, {"scale", gdfe::VolumeShape::Scale}});
  bind_enum<gdfe::Metric>(module, "Metric",
                          {{"laplacian", gdfe::Metric::Laplacian}, {"centring", gdfe::Metric::Centring}});
  bind_enum<gdfe::Ordering>(
      module, "Ordering",
      {{"automatic", gdfe::Ordering::Automatic}, {"amd", gdfe::Ordering::Amd}, {"metis", gdfe::Ordering::Metis}});
  bind_enum<gdfe::Method>(module, "Method",
                          {{"automatic", gdfe::Method::Automatic},
                           {"direct", gdfe::Method::Direct},
                           {"multigrid", gdfe::Method::Multigrid}});

  py::class_<gdfe::Settings>(module, "Settings")
      .def(py::init(&from_fields<gdfe::Settings>))
      .def_readwrite("law", &gdfe::Settings::law)
      .def_readwrite("shape", &gdfe::Settings::shape)
      .def_readwrite("metric", &gdfe::Settings::metric)
      .def_readwrite("single_precision_factor", &gdfe::Settings::single_precision_factor)
      .def_readwrite("ordering", &gdfe::Settings::ordering)
      .def_readwrite("method", &gdfe::Settings::method)
      .def_readwrite("window", &gdfe::Settings::window)
      .def_readwrite("threads", &gdfe::Settings::threads)
      .def_readwrite("step_limit", &gdfe::Settings::step_limit)
      .def_readwrite("sections_after", &gdfe::Settings::sections_after)
      .def_readwrite("max_tangent_unknowns", &gdfe::Settings::max_tangent_unknowns);

  py::class_<gdfe::Problem>(module, "Problem")
      .def(py::init(&from_fields<gdfe::Problem>))
      .def_readwrite("rest", &gdfe::Problem::rest)
      .def_readwrite("hexes", &gdfe::Problem::hexes)
      .def_readwrite("tables", &gdfe::Problem::tables)
      .def_readwrite("cables", &gdfe::Problem::cables)
      .def_readwrite("ogden", &gdfe::Problem::ogden)
      .def_readwrite("surroundings", &gdfe::Problem::surroundings)
      .def_property(
          "materials", nullptr,
          [](gdfe::Problem& problem, const Array<int>& materials) { problem.materials = as_vector(materials); })
      .def_property(
          "matrix_weight", nullptr,
          [](gdfe::Problem& problem, const Array<double>& weight) { problem.matrix_weight = as_vector(weight); })
      .def_property(
          "sections", nullptr,
          [](gdfe::Problem& problem, const Array<std::int32_t>& sections) { problem.sections = as_vector(sections); })
      .def_property("maps", nullptr, [](gdfe::Problem& problem, const std::array<Array<std::int32_t>, 3>& maps) {
        for (std::size_t axis = 0; axis < 3; ++axis) problem.maps[axis] = as_vector(maps[axis]);
      });

  py::class_<gdfe::CableDrive>(module, "CableDrive")
      .def(py::init(&from_fields<gdfe::CableDrive>))
      .def_readwrite("by_length", &gdfe::CableDrive::by_length)
      .def_readwrite("target", &gdfe::CableDrive::target);

  py::class_<gdfe::Task>(module, "Task")
      .def(py::init(&from_fields<gdfe::Task>))
      .def_readwrite("prescribed", &gdfe::Task::prescribed)
      .def_readwrite("load", &gdfe::Task::load)
      .def_readwrite("drives", &gdfe::Task::drives)
      .def_readwrite("pressures", &gdfe::Task::pressures)
      .def_readwrite("follower_forces", &gdfe::Task::follower_forces)
      .def_readwrite("motions", &gdfe::Task::motions)
      .def_readwrite("motions_before", &gdfe::Task::motions_before)
      .def_readwrite("before", &gdfe::Task::before)
      .def_readwrite("tolerance", &gdfe::Task::tolerance)
      .def_readwrite("force_floor", &gdfe::Task::force_floor)
      .def_readwrite("length_tolerance", &gdfe::Task::length_tolerance)
      .def_readwrite("max_iterations", &gdfe::Task::max_iterations);

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
      .def_readonly("history", &gdfe::Outcome::history)
      .def_readonly("unstable_modes", &gdfe::Outcome::unstable_modes);

  py::class_<gdfe::ElementForces>(module, "ElementForces")
      .def(py::init<const gdfe::Problem&, const gdfe::Settings&>(), py::arg("problem"), py::arg("settings"))
      .def("at", &gdfe::ElementForces::at, py::arg("displacement"));

  py::class_<gdfe::Solver>(module, "Solver")
      .def(py::init<const gdfe::Problem&, const gdfe::Settings&>(), py::arg("problem"), py::arg("settings"),
           py::call_guard<py::gil_scoped_release>())
      .def("solve", &gdfe::Solver::solve, py::arg("task"), py::arg("start"), py::arg("start_tension"),
           py::call_guard<py::gil_scoped_release>())
      .def(
          "set_friction",
          [](gdfe::Solver& solver, std::size_t cable, int law, int k_reading, const std::vector<double>& coefficients,
             double radius_mm) {
            solver.cables().set_friction(cable, make_friction(law, k_reading, coefficients, radius_mm));
          },
          py::arg("cable"), py::arg("law"), py::arg("k_reading"), py::arg("coefficients"), py::arg("radius_mm"))
      .def(
          "energy",
          [](gdfe::Solver& solver, const gdfe::Nodes& displacement) { return solver.forces().energy(displacement); },
          py::arg("displacement"))
      .def(
          "internal_force",
          [](gdfe::Solver& solver, const gdfe::Nodes& displacement) {
            return solver.forces().internal_force(displacement);
          },
          py::arg("displacement"))
      .def("strain", [](const gdfe::Solver& solver) { return as_array(solver.forces().strain()); })
      .def(
          "set_thesis_state",
          [](gdfe::Solver& solver, const Array<double>& omega, const Array<double>& last_strain) {
            solver.forces().set_thesis_state(as_vector(omega), as_vector(last_strain));
          },
          py::arg("omega"), py::arg("last_strain"))
      .def_property_readonly("unknowns",
                             [](const gdfe::Solver& solver) { return solver.preconditioner().unknowns().count; })
      .def_property_readonly("element_bytes",
                             [](const gdfe::Solver& solver) { return solver.forces().element_bytes(); })
      .def("inverse_nonzeros", [](const gdfe::Solver& solver,
                                  std::size_t axis) { return solver.preconditioner().inverse(axis).nonzeros(); })
      .def("inverse_bytes",
           [](const gdfe::Solver& solver, std::size_t axis) { return solver.preconditioner().inverse(axis).bytes(); });
}
