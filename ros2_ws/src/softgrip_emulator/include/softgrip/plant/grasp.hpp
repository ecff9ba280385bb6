// SPDX-License-Identifier: Apache-2.0
// Fingers against a product in the grasp plane: contact, friction, lifting, slipping, crushing. SI units.
//
// World coordinates are (along the palm, out of the palm). Pads are rows of points that press on the product's outline
// (a rounded rectangle) with a stiffness in series of pad and product; tangentially they stick until Coulomb's limit.
// The product moves in the plane, overdamped; it does not turn. While it stands on the table it moves along only. When
// the arm lifts (told to, or by itself when the grip has settled) its weight pulls; fingers that draw it in press it
// against the palm, which is what carries a power grasp.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "softgrip/plant/bank.hpp"
#include "softgrip/plant/outline.hpp"
#include "softgrip/plant/pads.hpp"

namespace softgrip::plant {

class Grasp {
 public:
  Grasp(std::vector<SlotPlace> places, double finger_width_m, double palm_m);
  Grasp(const Grasp&) = delete;
  Grasp& operator=(const Grasp&) = delete;

  // Present a product with its centre at (along, out) [m] to the open fingers, or take it away.
  void place(const Product& product, double along_m, double out_m);
  void take_away();

  // Raise the arm: from here on whatever does not hold the product leaves it behind.
  void lift();

  // Move the product by one step [s] and give what it does to the joints; null when nothing touches. `wound_m`: cable
  // on all spools together.
  const JointLoad* load(const FingerBank& bank, double wound_m, double dt_s);

  bool present() const { return product_.has_value(); }
  bool held() const;
  bool slipped() const { return slipped_; }
  bool crushed() const { return crushed_; }
  const Eigen::Vector2d& centre_m() const { return centre_m_; }
  double palm_push_n() const { return palm_push_n_; }

  std::vector<double> on_fingers_n;  // (F, 2) force of the product on each finger, in the world
  std::vector<double> forces_n;      // (F) its size
  // Whoever has no arm to command has the product lifted as soon as the grip has settled.
  bool lifts_itself = true;

 private:
  struct Contact {
    std::size_t slot, pad;
    Eigen::Vector2d normal, tangent;
    double push_n, drag_n;
    bool sticks;
    Eigen::Vector2d on_finger_n() const { return push_n * normal + drag_n * tangent; }
  };

  // Where a pad was, and how far it has been dragged along the outline.
  struct Trace {
    Eigen::Vector2d at_m;
    double stick_m;
  };

  void clear();
  void press_nothing();
  double stiffness_n_per_m() const;
  double find_contacts(const FingerBank& bank, double stiffness);
  void loosen(double nearest_m, double dt_s);
  void drag(double stiffness, double dt_s);
  void press(const FingerBank& bank, double stiffness);
  void watch(double wound_m, double dt_s);
  void lean_on_palm(double stiffness, double dt_s);
  void move_product(double stiffness, double dt_s);
  void notice_loss();

  std::vector<SlotPlace> places_;
  double finger_width_m_, palm_m_;
  std::vector<Pads> pads_;         // one for each slot
  std::vector<Outline> outlines_;  // one for each slot
  std::optional<Product> product_;
  Eigen::Vector2d centre_m_{0.0, 0.0}, velocity_m_s_{0.0, 0.0};
  double start_out_m_ = 0.0;
  std::vector<Contact> contacts_;
  std::vector<std::vector<Trace>> traces_, traces_before_;  // (F, P) of this step and the one before; empty: no touch
  double palm_push_n_ = 0.0, palm_stick_m_ = 0.0;           // force of the palm out of it; drag of the product along it
  JointLoad load_;
  bool lifted_ = false, slipped_ = false, crushed_ = false;
  double settled_s_ = 0.0, push_before_n_ = 0.0, max_wound_m_ = 0.0;
  int sleep_steps_ = 0;
};

}  // namespace softgrip::plant
