// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_emulator.plant._core; the typed faces are plant/fingers.py, plant/grasp.py and
// plant/motor.py. A step takes microseconds: the interpreter lock is kept.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <memory>
#include <optional>
#include <stdexcept>
#include <vector>

#include "softgrip/plant/bank.hpp"
#include "softgrip/plant/grasp.hpp"
#include "softgrip/plant/motor.hpp"

namespace py = pybind11;
using namespace softgrip::plant;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Shape = std::vector<py::ssize_t>;

namespace {

// A NumPy view onto what `owner` holds; it keeps the owner alive.
template <class T>
py::array view(std::vector<T>& values, const Shape& shape, const py::object& owner) {
  return py::array_t<T>(shape, values.data(), owner);
}

// How to view an array of the bank: (F) for `per_joint` 0, else (F, per_joint J).
template <class T>
auto view_of(std::vector<T> FingerBank::* values, std::size_t per_joint) {
  return [values, per_joint](const py::object& self) {
    auto& bank = self.cast<FingerBank&>();
    Shape shape{static_cast<py::ssize_t>(bank.slots())};
    if (per_joint > 0) shape.push_back(static_cast<py::ssize_t>(per_joint * bank.joints()));
    return view(bank.*values, shape, self);
  };
}

StressLaw law_of(const py::object& truth, double stiffness) {
  StressLaw law;
  law.tension = truth.attr("stress_tension_pa").cast<std::array<double, 3>>();
  law.compression = truth.attr("stress_compression_pa").cast<std::array<double, 3>>();
  for (auto* row : {&law.tension, &law.compression}) {
    for (double& coefficient : *row) coefficient *= stiffness;
  }
  return law;
}

TendonMake tendon_of(const py::object& truth) {
  const auto values = [&](const char* name) { return truth.attr(name).cast<std::vector<double>>(); };
  const auto value = [&](const char* name) { return truth.attr(name).cast<double>(); };
  TendonMake make;
  make.link_m = values("link_lengths_m");
  make.opening_rad = values("opening_rad");
  make.entry_radius_m = values("entry_radius_m");
  make.exit_radius_m = values("exit_radius_m");
  make.clearance_m = values("clearance_m");
  make.friction_pressure = values("friction_pressure");
  make.friction_adhesion = values("friction_adhesion");
  make.bending_n = value("bending_n");
  make.bending_share = value("bending_share");
  make.friction_stribeck_share = value("friction_stribeck_share");
  make.friction_stribeck_speed_m_s = value("friction_stribeck_speed_m_s");
  make.presliding_m = value("presliding_m");
  make.cable_stiffness_n = value("cable_stiffness_n");
  make.lead_length_m = value("lead_length_m");
  make.bedding_strain = value("bedding_strain");
  make.bedding_n = value("bedding_n");
  make.creep_share = value("cable_creep_share");
  make.creep_time_s = value("cable_creep_time_s");
  make.knot_slip_m = value("knot_slip_m");
  make.wear_per_j = values("wear_per_j");
  return make;
}

FingerMake make_of(const py::object& truth) {
  const auto values = [&](const char* name) { return truth.attr(name).cast<std::vector<double>>(); };
  const auto value = [&](const char* name) { return truth.attr(name).cast<double>(); };
  FingerMake make;
  make.tendon = tendon_of(truth);
  make.body_height_m = value("body_height_m");
  make.slack_m = value("slack_m");
  const TendonMake& tendon = make.tendon;
  const std::size_t joints = tendon.joints();
  if (joints == 0 || joints > kMaxJoints) throw std::invalid_argument("finger: expected 1 to 6 links");
  const auto length_m = values("strip_lengths_m"), thickness_m = values("thickness_m"), stiffness = values("stiffness");
  for (const auto* row :
       {&tendon.opening_rad, &tendon.entry_radius_m, &tendon.exit_radius_m, &length_m, &thickness_m, &stiffness}) {
    if (row->size() != joints) throw std::invalid_argument("finger: expected one value for each link");
  }
  for (const auto* row :
       {&tendon.clearance_m, &tendon.friction_pressure, &tendon.friction_adhesion, &tendon.wear_per_j}) {
    if (row->size() != 2 * joints) throw std::invalid_argument("finger: expected two contacts for each link");
  }
  const auto relaxing_share = truth.attr("relaxing_share").cast<std::array<double, kRelaxations>>();
  const auto relaxing_time_s = truth.attr("relaxing_time_s").cast<std::array<double, kRelaxations>>();
  for (std::size_t j = 0; j < joints; ++j) {
    make.strips.push_back({length_m[j], thickness_m[j], value("width_m"), law_of(truth, stiffness[j]), value("poisson"),
                           j == 0 ? 0.0 : 1.0, 1.0, value("damping_s"), relaxing_share, relaxing_time_s,
                           value("softening")});
  }
  return make;
}

std::unique_ptr<FingerBank> make_bank(const std::vector<std::optional<py::object>>& fingers) {
  std::vector<std::optional<FingerMake>> makes;
  for (const auto& finger : fingers) makes.push_back(finger ? std::optional(make_of(*finger)) : std::nullopt);
  return std::make_unique<FingerBank>(makes);
}

std::unique_ptr<JointLoad> make_load(const Array& force, const Array& stiffness) {
  if (force.ndim() != 2 || stiffness.size() != force.size() * force.shape(1)) {
    throw std::invalid_argument("load: expected forces (F, 3 J) and their stiffness (F, 3 J, 3 J)");
  }
  return std::make_unique<JointLoad>(
      JointLoad{{force.data(), force.data() + force.size()}, {stiffness.data(), stiffness.data() + stiffness.size()}});
}

void step_bank(FingerBank& bank, const Array& wound_m, double dt_s, const JointLoad* load) {
  if (wound_m.size() != static_cast<py::ssize_t>(bank.slots())) {
    throw std::invalid_argument("wound_m: expected one value for each slot");
  }
  if (load != nullptr && load->force.size() != kFreedoms * bank.q.size()) {
    throw std::invalid_argument("load: expected forces (F, 3 J) as the bank has slots and joints");
  }
  bank.step(wound_m.data(), dt_s, load);
}

void adopt(FingerBank& bank, const FingerBank& before, const std::vector<std::size_t>& keep) {
  for (const std::size_t slot : keep) {
    if (slot >= bank.slots() || slot >= before.slots()) throw std::out_of_range("keep: no such slot");
    bank.adopt(before, slot);
  }
}

py::array_t<double> pulled_length(const FingerBank& bank) {
  py::array_t<double> pulled(static_cast<py::ssize_t>(bank.slots()));
  for (std::size_t i = 0; i < bank.slots(); ++i) {
    pulled.mutable_at(i) = bank.finger(i) == nullptr ? 0.0 : bank.finger(i)->pulled_length_m();
  }
  return pulled;
}

// Middles of the strips and tip, (F, J + 1, 2), and headings, (F, J), some time ago; rows of shorter fingers repeat the
// tip and the last heading.
py::tuple chain(const FingerBank& bank, double ago_s) {
  const std::size_t slots = bank.slots(), joints = bank.joints();
  py::array_t<double> points(Shape{py::ssize_t(slots), py::ssize_t(joints + 1), 2});
  py::array_t<double> headings(Shape{py::ssize_t(slots), py::ssize_t(joints)});
  FingerShape shape;
  for (std::size_t i = 0; i < slots; ++i) {
    double* point = points.mutable_data() + i * 2 * (joints + 1);
    double* heading = headings.mutable_data() + i * joints;
    shape.joints.assign(1, Eigen::Vector2d::Zero());
    shape.heading_rad.clear();
    if (bank.finger(i) != nullptr) bank.finger(i)->shape(shape, ago_s);
    for (std::size_t j = 0; j <= joints; ++j) {
      Eigen::Map<Eigen::Vector2d>(point + 2 * j) = shape.joints[std::min(j, shape.joints.size() - 1)];
    }
    const std::size_t real = shape.heading_rad.size();
    for (std::size_t j = 0; j < joints; ++j) heading[j] = real == 0 ? 0.0 : shape.heading_rad[std::min(j, real - 1)];
  }
  return py::make_tuple(points, headings);
}

Ratings ratings_of(const py::object& ratings) {
  const auto value = [&](const char* name) { return ratings.attr(name).cast<double>(); };
  return {value("resistance_ohm"),
          value("back_emf_vs_per_rad"),
          value("torque_constant_nm_per_a"),
          value("inertia_kgm2"),
          value("gear_viscous_nms"),
          value("gear_friction_nm"),
          value("thermal_resistance_k_per_w"),
          value("heat_capacity_j_per_k"),
          value("winding_to_case_k_per_w"),
          value("winding_capacity_j_per_k")};
}

std::unique_ptr<Grasp> make_grasp(const std::vector<std::vector<double>>& places, double finger_width_m,
                                  double palm_m) {
  std::vector<SlotPlace> slots;
  for (const auto& place : places) {
    if (place.size() != 5) throw std::invalid_argument("place: expected along, out, side, rest angle, across");
    slots.push_back({place[0], place[1], place[2], place[3], place[4]});
  }
  return std::make_unique<Grasp>(slots, finger_width_m, palm_m);
}

void place_product(Grasp& grasp, const py::object& item, double along_m, double out_m) {
  const auto value = [&](const char* name) { return item.attr(name).cast<double>(); };
  const Product product{value("width_m"),
                        value("height_m"),
                        value("length_m"),
                        value("corner_m"),
                        item.attr("round_in_length").cast<bool>(),
                        value("mass_kg"),
                        value("friction"),
                        value("stiffness_n_per_m"),
                        value("crush_n")};
  grasp.place(product, along_m, out_m);
}

const JointLoad* load_of(Grasp& grasp, const FingerBank& bank, const Array& wound_m, double dt_s) {
  if (bank.slots() != grasp.forces_n.size()) {
    throw std::invalid_argument("bank: expected as many slots as the grasp has");
  }
  double all_wound_m = 0.0;
  for (py::ssize_t i = 0; i < wound_m.size(); ++i) all_wound_m += wound_m.data()[i];
  return grasp.load(bank, all_wound_m, dt_s);
}

void bind_fingers(py::module_& module) {
  py::class_<JointLoad>(module, "JointLoad")
      .def(py::init(&make_load), py::arg("force"), py::arg("stiffness"))
      .def_property_readonly("force", [](const JointLoad& load) { return load.force; })
      .def_property_readonly("stiffness", [](const JointLoad& load) { return load.stiffness; });
  py::class_<FingerBank>(module, "FingerBank")
      .def(py::init(&make_bank), py::arg("fingers"))
      .def_property_readonly("joints", &FingerBank::joints)
      .def_property(
          "friction_scale", [](const FingerBank& bank) { return bank.conditions.friction_scale; },
          [](FingerBank& bank, double scale) { bank.conditions.friction_scale = scale; })
      .def(
          "set_room", [](FingerBank& bank, double stiffness, double pace) { bank.conditions.room = {stiffness, pace}; },
          py::arg("stiffness"), py::arg("pace"))
      .def("recall",
           [](const FingerBank& bank, std::size_t slot) {
             const Finger* finger = bank.finger(slot);
             return finger == nullptr ? std::vector<double>() : finger->recall();
           })
      .def("restore",
           [](FingerBank& bank, std::size_t slot, const std::vector<double>& memory) {
             if (Finger* finger = bank.finger(slot)) finger->restore(memory);
           })
      .def("step", &step_bank, py::arg("wound_m"), py::arg("dt_s"), py::arg("load").none(true) = py::none())
      .def("adopt", &adopt, py::arg("before"), py::arg("keep"))
      .def("pulled_length_m", &pulled_length)
      .def("chain", &chain, py::arg("ago_s") = 0.0)
      .def("q", view_of(&FingerBank::q, 1))
      .def("joint_speed", view_of(&FingerBank::joint_speed, 1))
      .def("span_tension_n", view_of(&FingerBank::span_tension_n, 2))
      .def("tension_n", view_of(&FingerBank::tension_n, 0))
      .def("slack_m", view_of(&FingerBank::slack_m, 0))
      .def("broken", [](const py::object& self) {
        return view_of(&FingerBank::broken, 0)(self).attr("view")(py::dtype::of<bool>());
      });
}

void bind_motor(py::module_& module) {
  module.attr("AMBIENT_C") = kAmbient_C;
  py::class_<Motor>(module, "Motor")
      .def(py::init([](const py::object& ratings, double spool_radius_m, double friction_factor) {
             return Motor{ratings_of(ratings), spool_radius_m, friction_factor};
           }),
           py::arg("ratings"), py::arg("spool_radius_m"), py::arg("friction_factor"))
      .def_readonly("spool_radius_m", &Motor::spool_radius_m)
      .def_readonly("friction_factor", &Motor::friction_factor)
      .def_readwrite("extra_heat_w", &Motor::extra_heat_w)
      .def_readwrite("jammed", &Motor::jammed)
      .def("resistance_ohm", &Motor::resistance_ohm, py::arg("winding_c"))
      // Values in, values out: the shaft's attributes are read more often than it turns.
      .def("turned",
           [](const Motor& motor, double angle_rad, double velocity_rad_s, double temperature_c, double winding_c,
              double duty, double current_limit_a, bool limits_supply, double tension_n, double supply_v, double dt_s) {
             const Shaft before{angle_rad, velocity_rad_s, temperature_c, winding_c};
             const Drive drive{duty, current_limit_a, limits_supply};
             const Shaft shaft = motor.turned(before, drive, tension_n, supply_v, dt_s);
             return py::make_tuple(shaft.angle_rad, shaft.velocity_rad_s, shaft.temperature_c, shaft.winding_c,
                                   shaft.current_a, shaft.duty);
           });
}

void bind_grasp(py::module_& module) {
  py::class_<Grasp>(module, "Grasp")
      .def(py::init(&make_grasp), py::arg("places"), py::arg("finger_width_m"), py::arg("palm_m"))
      .def("place", &place_product, py::arg("product"), py::arg("along_m"), py::arg("out_m"))
      .def("take_away", &Grasp::take_away)
      .def("lift", &Grasp::lift)
      .def("load", &load_of, py::arg("bank"), py::arg("wound_m"), py::arg("dt_s"),
           py::return_value_policy::reference_internal)
      .def_property_readonly("present", &Grasp::present)
      .def_property_readonly("held", &Grasp::held)
      .def_property_readonly("slipped", &Grasp::slipped)
      .def_property_readonly("crushed", &Grasp::crushed)
      .def_property_readonly("palm_push_n", &Grasp::palm_push_n)
      .def_property_readonly(
          "centre_m", [](const Grasp& grasp) { return py::make_tuple(grasp.centre_m().x(), grasp.centre_m().y()); })
      .def_readwrite("lifts_itself", &Grasp::lifts_itself)
      .def("on_fingers_n",
           [](const py::object& self) {
             auto& grasp = self.cast<Grasp&>();
             return view(grasp.on_fingers_n, {py::ssize_t(grasp.forces_n.size()), 2}, self);
           })
      .def("forces_n", [](const py::object& self) {
        auto& forces_n = self.cast<Grasp&>().forces_n;
        return view(forces_n, {py::ssize_t(forces_n.size())}, self);
      });
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_emulator.plant.";
  bind_fingers(module);
  bind_motor(module);
  bind_grasp(module);
}
