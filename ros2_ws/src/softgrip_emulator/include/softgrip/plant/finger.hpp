// SPDX-License-Identifier: Apache-2.0
// One mounted finger: joints, tendon, friction with memory. SI units.
//
// Motion is overdamped (a finger of soft TPU weighs ten grams), so joints follow first-order equations; they are
// stepped linearly implicit because tendon, groove stops and contacts are stiff. Friction at each routing contact
// carries a bristle state s in -1..1: T(after) = T(before) exp(-s mu phi). It turns round over a short cable travel
// (Dahl), which gives hysteresis; a coefficient that falls with speed gives stick-slip.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <cstddef>
#include <vector>

namespace softgrip::plant {

// What a finger is made of; n values per joint or 2 n per routing contact, base to tip (plant/truth.py explains them).
struct FingerMake {
  std::vector<double> link_m, opening_rad, entry_radius_m, exit_radius_m;  // n
  std::vector<double> moment_linear, moment_quadratic, moment_cubic;       // n
  std::vector<double> friction_coefficient, friction_bite;                 // 2 n
  double body_height_m, damping_s, creep_share, creep_time_s;
  double friction_tension_exponent, friction_stribeck_share, friction_stribeck_speed_m_s;
  double presliding_m, cable_stiffness_n, lead_length_m, slack_m;

  std::size_t joints() const { return link_m.size(); }
};

// Where the bank keeps what others see of a finger.
struct FingerView {
  double* q;               // (n) joint angles [rad]
  double* joint_speed;     // (n) [rad/s]
  double* span_tension_n;  // (2 n) after each routing contact, spool to tip
  double* tension_n;       // at the spool
};

// Torque on the joints from outside [N m], (n), closing positive, and its stiffness against closing [N m/rad], (n, n)
// in rows `stride` apart; null when nothing touches the finger.
struct FingerLoad {
  const double* torque_nm = nullptr;
  const double* stiffness = nullptr;
  std::size_t stride = 0;
};

class Finger {
 public:
  Finger(FingerMake make, FingerView view);

  // One step [s] with `wound_m` of cable wound on the spool since mounting, `slack_m` of it loose.
  void step(double wound_m, double slack_m, bool broken, double friction_scale, double dt_s, const FingerLoad& load);

  // Become what another copy of this finger is.
  void adopt(const Finger& before);

  // How much cable the present joint angles take in [m].
  double pulled_length_m() const;

  // Joints and tip in the finger's base frame [m], `points` (n + 1, 2), and direction angles of the links [rad],
  // `heading` (n).
  void chain(const double* q, double* points, double* heading) const;

  const FingerMake& make() const { return make_; }
  const double* q() const { return view_.q; }

 private:
  struct Pull {
    double tension_n;
    double rate_n_per_m;  // how the tension falls with cable that comes out
  };

  void shape();
  void measure_spans();
  double log_ratio(std::size_t contact, double wrap_rad) const;
  void find_ratios(double friction_scale);
  Pull pull_of(double wound_m, double slack_m, bool broken) const;
  void solve(const Pull& pull, double dt_s, const FingerLoad& load);
  void slide(double dt_s);
  void measure_beyond(std::vector<double>& beyond_m) const;

  FingerMake make_;
  FingerView view_;
  // What follows from the make.
  std::vector<double> half_, entry_along_, entry_inward_, radii_squared_, radii_product_, stop_;  // n
  std::vector<double> link_slope_;                                                                // n + 1
  std::vector<double> link_span_;  // n: cable on the link behind each joint [m]
  double straight_m_ = 0.0;        // cable in all grooves of the straight finger
  // State besides the view.
  std::vector<double> relaxed_nm_;                         // n
  std::vector<double> bristle_, slid_from_m_, speed_m_s_;  // 2 n
  std::vector<double> span_m_, arm_m_;                     // n: cable in each groove, its lever arm about the joint
  // Work space.
  std::vector<double> ratio_, beyond_m_, elastic_;
  Eigen::VectorXd torque_, change_;
  Eigen::MatrixXd matrix_;
  Eigen::PartialPivLU<Eigen::MatrixXd> factors_;
};

}  // namespace softgrip::plant
