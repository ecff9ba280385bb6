// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.finger._core; the typed face is softgrip_model.finger.kernel.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <stdexcept>

#include "batch.hpp"
#include "path.hpp"
#include "softgrip/finger_replication.hpp"
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

sf::Design make_design(double base, const Numbers& width, const Numbers& link, const Numbers& thickness,
                       const Numbers& length, const Numbers& opening, const Numbers& routing,
                       const std::array<double, 3>& modulus, int moment_law, double max_strain, double stop_margin,
                       double stop_moment, double compliance, double lead, double smoothing, int joint_model,
                       double body, double poisson, const std::array<double, 10>& study) {
  sf::Design d;
  const std::size_t n = thickness.size();
  if (n < 1 || n > sf::kMaxJoints) throw std::invalid_argument("expected 1 to 6 joints");
  d.joints = static_cast<int>(n);
  d.base_mm = base;
  fill(d.width_mm, width, n, "width_mm");
  fill(d.link_mm, link, n, "link_mm");
  fill(d.thickness_mm, thickness, n, "thickness_mm");
  fill(d.length_mm, length, n, "length_mm");
  fill(d.opening_rad, opening, n, "opening_rad");
  fill(d.routing_mm, routing, 2 * n, "routing_mm");
  d.material = {modulus[0], modulus[1], modulus[2], static_cast<sf::MomentLaw>(moment_law), max_strain};
  d.stop = {stop_margin, stop_moment};
  d.cable = {compliance, lead};
  d.angle_smoothing_rad = smoothing;
  d.joint_model = static_cast<sf::JointModel>(joint_model);
  d.body_mm = body;
  d.poisson = poisson;
  d.study = {study[0], study[1], study[2], study[3], study[4], study[5], study[6], study[7], study[8], study[9]};
  return d;
}

fr::Model make_friction(int law, int k_reading, const Numbers& coefficients, double radius_mm,
                        const std::pair<double, double>& angle, const std::pair<double, double>& tension) {
  fr::Model model{static_cast<fr::Law>(law),   static_cast<fr::KReading>(k_reading), {}, radius_mm,
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
    sf::BatchOut out{angle.mutable_data(),
                     tension.mutable_data(),
                     phi.mutable_data(),
                     rate.mutable_data(),
                     tip.mutable_data(),
                     pulled.mutable_data(),
                     sensitivities ? gradient.mutable_data() : nullptr,
                     status.mutable_data(),
                     iterations.mutable_data(),
                     joints_};
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

// Mode R: (k, n) angles, (k, 2n+1) tensions, (k,) status after each step; NaN from where it broke off.
py::tuple replicate(const sf::Design& design, const fr::Model& friction, int steps, double pull_mm,
                    const sf::Replication& recipe) {
  const int n = design.joints;
  py::array_t<double> angle({steps, n}), tension({steps, 2 * n + 1});
  py::array_t<std::uint32_t> status(steps);
  std::vector<sf::ReplicationStep> taken(steps);
  {
    py::gil_scoped_release release;
    const sf::Finger finger(design, friction);
    sf::ReplicationRun run(finger, recipe);
    std::uint32_t broken = sf::sound(design) ? sf::kOk : sf::kBadDesign;
    for (sf::ReplicationStep& step : taken) {
      if (broken == sf::kOk) broken = (step = run.advance(pull_mm)).status;
      step.status = broken;
    }
  }
  const double missing = std::numeric_limits<double>::quiet_NaN();
  for (int k = 0; k < steps; ++k) {
    const sf::ReplicationStep& step = taken[k];
    const bool broken = step.status != sf::kOk;
    for (int j = 0; j < n; ++j) angle.mutable_at(k, j) = broken ? missing : step.angle_rad[j];
    for (int i = 0; i <= 2 * n; ++i) tension.mutable_at(k, i) = broken ? missing : step.tension_N[i];
    status.mutable_at(k) = step.status;
  }
  return py::make_tuple(angle, tension, status);
}

// One finger along targets; NaN where a step failed.
py::dict follow(const sf::Design& design, const fr::Model& friction, const Numbers& targets, int control,
                const std::vector<sf::Contact>& contacts, const sf::PathSettings& settings) {
  if (contacts.size() > sf::kMaxContacts) throw std::invalid_argument("expected at most 8 contacts");
  if (!sf::sound(design)) throw std::invalid_argument("impossible design");
  const py::ssize_t k = static_cast<py::ssize_t>(targets.size()), n = design.joints;
  const py::ssize_t touching = static_cast<py::ssize_t>(contacts.size());
  py::array_t<double> angle({k, n}), tension({k, 2 * n + 1}), slip({k, 2 * n}), tip({k, py::ssize_t{2}}), pulled(k);
  py::array_t<double> force({k, touching}), gap({k, touching});
  py::array_t<std::int8_t> slide({k, 2 * n});
  py::array_t<std::uint32_t> status(k);
  py::array_t<int> iterations(k);
  const sf::Finger finger(design, friction);
  sf::Path path(finger, contacts, settings);
  std::vector<sf::PathStep> steps(targets.size());
  {
    py::gil_scoped_release release;
    for (std::size_t i = 0; i < targets.size(); ++i) steps[i] = path.to(static_cast<sf::Control>(control), targets[i]);
  }
  for (py::ssize_t i = 0; i < k; ++i) {
    const sf::PathStep& step = steps[i];
    const bool failed = (step.status & sf::kFailure) != sf::kOk;
    auto known = [failed](double value) { return failed ? std::numeric_limits<double>::quiet_NaN() : value; };
    for (py::ssize_t j = 0; j < n; ++j) angle.mutable_at(i, j) = known(step.seen_rad[j]);
    for (py::ssize_t j = 0; j <= 2 * n; ++j) tension.mutable_at(i, j) = known(std::exp(step.log_tension[j]));
    for (py::ssize_t j = 0; j < 2 * n; ++j) {
      slip.mutable_at(i, j) = known(step.slip_mm[j]);
      slide.mutable_at(i, j) = failed ? 0 : static_cast<std::int8_t>(step.slide[j]);
    }
    for (py::ssize_t c = 0; c < touching; ++c) {
      force.mutable_at(i, c) = known(step.force_N[c]);
      gap.mutable_at(i, c) = known(step.gap_mm[c]);
    }
    for (py::ssize_t k : {0, 1}) tip.mutable_at(i, k) = known(step.tip_mm[k]);
    pulled.mutable_at(i) = known(step.pulled_mm);
    status.mutable_at(i) = step.status;
    iterations.mutable_at(i) = step.iterations;
  }
  py::dict result;
  result["angle_rad"] = angle;
  result["tension_n"] = tension;
  result["tip_mm"] = tip;
  result["pulled_mm"] = pulled;
  result["slip_mm"] = slip;
  result["slide"] = slide;
  result["contact_force"] = force;
  result["gap"] = gap;
  result["status"] = status;
  result["iterations"] = iterations;
  return result;
}

sf::Contact make_contact(int kind, int index, double along, double limit, double x, double y, double size) {
  return {static_cast<sf::ContactKind>(kind), index, along, limit, x, y, size};
}

// Span, arm, and the slopes of arm and direction of one groove.
py::tuple groove(double opening, double q, double ra, double rb) {
  const sf::Groove g(opening, q, ra, rb);
  return py::make_tuple(g.span_mm, g.arm_mm, g.d_arm, g.direction_rad, g.d_direction);
}

// Signed bends of the cable at the routing points, (2n,).
Numbers bends(const sf::Design& d, const Numbers& angle) {
  if (angle.size() != static_cast<std::size_t>(d.joints)) throw std::invalid_argument("expected one angle per joint");
  const sf::Finger finger(d, {});
  Numbers phi(2 * d.joints);
  for (int j = 0; j < d.joints; ++j) {
    const sf::Groove groove = finger.groove(j, angle[j]);
    for (int i : {2 * j, 2 * j + 1}) phi[i] = finger.bend_rad(i, groove, angle[j]);
  }
  return phi;
}

// Moment of one strip with its slopes to angle and thickness.
py::tuple strip_moment(const sf::Design& d, int joint, double q) {
  if (joint < 0 || joint >= d.joints) throw std::invalid_argument("no such joint");
  const sf::Strip strip(d.material, d.width_mm[joint], d.thickness_mm[joint], d.length_mm[joint]);
  const sf::Moment moment = strip.at(q);
  return py::make_tuple(moment.value_Nmm, moment.d_angle, strip.d_thickness(q));
}

// What gives in a finger of mode F when nothing is loaded. Compliances as (mm, mn, mv, nn, nv, vv); for each joint
// those of the root before it, of the link before that, of the root beyond, of the link beyond; then strips and tip.
py::tuple flexures(const sf::Design& d) {
  if (!sf::sound(d)) throw std::invalid_argument("impossible design");
  const sf::FlexureSides sides(d);
  auto values = [](const sf::ComplianceOf<sf::ShapeJet>& c) {
    return Numbers{c.mm.value, c.mn.value, c.mv.value, c.nn.value, c.nv.value, c.vv.value};
  };
  std::vector<std::vector<Numbers>> joints;
  std::vector<Numbers> strips;
  for (int j = 0; j < d.joints; ++j) {
    const sf::JointSide &entry = sides.entry[j], &exit = sides.exit[j];
    joints.push_back({values(entry.root), values(entry.link), values(exit.root), values(exit.link)});
    const double h = d.thickness_mm[j], area = h * d.width_mm[j], modulus = sf::flexure_modulus_MPa(d, j);
    strips.push_back({d.study.strip * modulus * area * h * h / 12.0, modulus * area, sf::shear_modulus_MPa(d) * area});
  }
  return py::make_tuple(joints, strips, values(sides.tip));
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_model.finger.";
  module.attr("MAX_JOINTS") = sf::kMaxJoints;
  py::class_<sf::Design>(module, "Design")
      .def(py::init(&make_design), py::kw_only(), py::arg("base_mm"), py::arg("width_mm"), py::arg("link_mm"),
           py::arg("thickness_mm"), py::arg("length_mm"), py::arg("opening_rad"), py::arg("routing_mm"),
           py::arg("modulus_mpa"), py::arg("moment_law"), py::arg("max_strain"), py::arg("stop_margin_rad"),
           py::arg("stop_moment_nmm"), py::arg("compliance_per_n"), py::arg("lead_mm"), py::arg("smoothing_rad"),
           py::arg("joint_model"), py::arg("body_mm"), py::arg("poisson"), py::arg("study"));
  py::class_<fr::Model>(module, "Friction")
      .def(py::init(&make_friction), py::arg("law"), py::arg("k_reading"), py::arg("coefficients"),
           py::arg("radius_mm"), py::arg("angle_range"), py::arg("tension_range"));
  py::class_<sf::Replication>(module, "Replication")
      .def(py::init([](double passage, double cable, double neighbour, double tension, int force) {
             return sf::Replication{passage, cable, neighbour, tension, static_cast<sf::BendingForce>(force)};
           }),
           py::arg("passage_radius_mm"), py::arg("cable_radius_mm"), py::arg("neighbour_mm"),
           py::arg("initial_tension_n"), py::arg("force"));
  py::class_<sf::Contact>(module, "Contact")
      .def(py::init(&make_contact), py::kw_only(), py::arg("kind"), py::arg("index"), py::arg("along_mm"),
           py::arg("limit_rad"), py::arg("x_mm"), py::arg("y_mm"), py::arg("size_mm"));
  py::class_<sf::PathSettings>(module, "PathSettings")
      .def(py::init<double, double, double>(), py::arg("largest_pull_step_mm"), py::arg("largest_tension_step_n"),
           py::arg("min_compliance_per_n"));
  module.def("follow", &follow);
  module.def("replicate", &replicate);
  module.def("groove", &groove);
  module.def("bends", &bends);
  module.def("strip_moment", &strip_moment);
  module.def("flexures", &flexures);
  py::class_<Fingers>(module, "Fingers")
      .def(py::init<std::vector<sf::Design>, std::vector<fr::Model>>())
      .def("varied", &Fingers::varied)
      .def("solve", &Fingers::solve, py::arg("targets"), py::arg("control"), py::arg("march"), py::arg("sensitivities"),
           py::arg("threads"))
      .def_property_readonly("joints", &Fingers::joints)
      .def("__len__", &Fingers::count);
}
