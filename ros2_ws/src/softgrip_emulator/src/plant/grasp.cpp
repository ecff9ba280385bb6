// SPDX-License-Identifier: Apache-2.0
#include "softgrip/plant/grasp.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

namespace softgrip::plant {

namespace {

constexpr double kGravity_m_s2 = 9.81;
// The arm accelerates: the product weighs this much more than at rest.
constexpr double kDynamicLoadFactor = 1.15;
constexpr double kPadStiffness_n_per_m = 6000.0;
constexpr double kCrushedSoftness = 0.15;
constexpr double kDamping_ns_per_m = 1.5;
// Share of the implicit step taken: the pads of the other side, not yet touched, are not in its stiffness.
constexpr double kRelaxation = 0.4;
constexpr double kLargestMove_m = 1e-3;
constexpr double kSettled_s = 0.35;
constexpr double kSettledForce_n = 0.25;
constexpr double kSettledRate_n_per_s = 1.5;
constexpr double kLeftBehind_m_s = 0.3;
constexpr double kLostWay_m = 0.030;
constexpr double kHeldSpeed_m_s = 0.002;
constexpr double kSetDownPayout_m = 0.002;
constexpr double kFar_m = 0.006;
constexpr int kSleepSteps = 4;

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

}  // namespace

Grasp::Grasp(std::vector<SlotPlace> places, double finger_width_m, double palm_m)
    : on_fingers_n(2 * places.size(), 0.0),
      forces_n(places.size(), 0.0),
      places_(std::move(places)),
      finger_width_m_(finger_width_m),
      palm_m_(palm_m) {
  for (const SlotPlace& place : places_) pads_.emplace_back(place);
  traces_.resize(places_.size());
  traces_before_.resize(places_.size());
}

// -- what a person or the arm does ----------------------------------------------------------------------------------

void Grasp::clear() {
  product_.reset();
  velocity_m_s_.setZero();
  for (auto& row : traces_) row.clear();
  press_nothing();
  lifted_ = slipped_ = crushed_ = false;
  settled_s_ = push_before_n_ = max_wound_m_ = 0.0;
  sleep_steps_ = 0;
}

void Grasp::press_nothing() {
  std::fill(on_fingers_n.begin(), on_fingers_n.end(), 0.0);
  std::fill(forces_n.begin(), forces_n.end(), 0.0);
  palm_push_n_ = palm_stick_m_ = 0.0;
}

void Grasp::place(const Product& product, double along_m, double out_m) {
  clear();
  product_ = product;
  outlines_.clear();
  for (const SlotPlace& place : places_) outlines_.emplace_back(product, place.across_m, finger_width_m_);
  centre_m_ = {along_m, out_m};
  start_out_m_ = out_m;
}

void Grasp::take_away() {
  clear();
}

void Grasp::lift() {
  lifted_ = present();
}

bool Grasp::held() const {
  return lifted_ && sum(forces_n) > kSettledForce_n && velocity_m_s_.cwiseAbs().maxCoeff() < kHeldSpeed_m_s;
}

// -- mechanics ------------------------------------------------------------------------------------------------------

const JointLoad* Grasp::load(const FingerBank& bank, double wound_m, double dt_s) {
  if (!product_) return nullptr;
  if (sleep_steps_ > 0) {
    --sleep_steps_;
    return nullptr;
  }
  const double stiffness = stiffness_n_per_m();
  const double nearest_m = find_contacts(bank, stiffness);
  if (nearest_m > 0.0) {
    loosen(nearest_m, dt_s);
    return nullptr;
  }
  drag(stiffness, dt_s);
  press(bank, stiffness);
  lean_on_palm(stiffness, dt_s);
  watch(wound_m, dt_s);
  move_product(stiffness, dt_s);
  return &load_;
}

double Grasp::stiffness_n_per_m() const {
  const double of_product = product_->stiffness_n_per_m * (crushed_ ? kCrushedSoftness : 1.0);
  return kPadStiffness_n_per_m * of_product / (kPadStiffness_n_per_m + of_product);
}

// Contacts of all pads that are on or in the outline; returns the distance of the nearest pad [m].
double Grasp::find_contacts(const FingerBank& bank, double stiffness) {
  contacts_.clear();
  double nearest_m = std::numeric_limits<double>::infinity();
  for (std::size_t slot = 0; slot < pads_.size(); ++slot) {
    pads_[slot].follow(bank.finger(slot));
    if (!outlines_[slot].met()) continue;
    for (std::size_t pad = 0; pad < pads_[slot].count(); ++pad) {
      const Nearest nearest = outlines_[slot].nearest(pads_[slot].point(pad) - centre_m_);
      nearest_m = std::min(nearest_m, nearest.distance_m);
      if (nearest.distance_m > 0.0) continue;
      const Eigen::Vector2d tangent(-nearest.normal.y(), nearest.normal.x());
      contacts_.push_back({slot, pad, nearest.normal, tangent, -stiffness * nearest.distance_m, 0.0, false});
    }
  }
  return nearest_m;
}

// Nothing touches; what hung in the fingers stays behind when the arm rises.
void Grasp::loosen(double nearest_m, double dt_s) {
  press_nothing();
  for (auto& row : traces_) row.clear();
  if (nearest_m > kFar_m && !lifted_) sleep_steps_ = kSleepSteps;
  if (!lifted_) return;
  velocity_m_s_ = {0.0, kLeftBehind_m_s};
  centre_m_ += velocity_m_s_ * dt_s;
  notice_loss();
}

// Tangential force on each contact, and whether it sticks: a spring along the outline, drawn by what the pad moves
// against the product, up to Coulomb's limit. A pad that does not press forgets its spring.
void Grasp::drag(double stiffness, double dt_s) {
  traces_.swap(traces_before_);
  for (std::size_t slot = 0; slot < pads_.size(); ++slot) {
    traces_[slot].clear();
    for (std::size_t pad = 0; pad < pads_[slot].count(); ++pad) traces_[slot].push_back({pads_[slot].point(pad), 0.0});
  }
  for (Contact& contact : contacts_) {
    Trace& now = traces_[contact.slot][contact.pad];
    double stick_m = 0.0;
    if (contact.pad < traces_before_[contact.slot].size()) {
      const Trace& before = traces_before_[contact.slot][contact.pad];
      stick_m = before.stick_m + (now.at_m - before.at_m - velocity_m_s_ * dt_s).dot(contact.tangent);
    }
    const double limit_m = product_->friction * contact.push_n / stiffness;
    contact.sticks = std::abs(stick_m) <= limit_m && contact.push_n > 0.0;
    now.stick_m = std::clamp(stick_m, -limit_m, limit_m);
    contact.drag_n = -stiffness * now.stick_m;
  }
}

// What the contacts do to the fingers and the poses of their links.
void Grasp::press(const FingerBank& bank, double stiffness) {
  const std::size_t row = kFreedoms * bank.joints();
  load_.force.assign(places_.size() * row, 0.0);
  load_.stiffness.assign(places_.size() * row * row, 0.0);
  std::fill(on_fingers_n.begin(), on_fingers_n.end(), 0.0);
  for (const Contact& contact : contacts_) {
    const Pads& pads = pads_[contact.slot];
    const Eigen::Vector2d force_n = contact.on_finger_n();
    on_fingers_n[2 * contact.slot] += force_n.x();
    on_fingers_n[2 * contact.slot + 1] += force_n.y();
    double* force = &load_.force[contact.slot * row];
    double* rows = &load_.stiffness[contact.slot * row * row];
    const std::size_t moving = Pads::freedoms_of(contact.pad);
    std::array<Eigen::Vector2d, kFreedoms * kMaxJoints> levers;
    for (std::size_t j = 0; j < moving; ++j) levers[j] = pads.lever(contact.pad, j);
    for (std::size_t j = 0; j < moving; ++j) {
      const Eigen::Vector2d& lever = levers[j];
      force[j] += lever.dot(force_n);
      const double by_normal = contact.push_n > 0.0 ? lever.dot(contact.normal) : 0.0;
      const double by_tangent = contact.sticks ? lever.dot(contact.tangent) : 0.0;
      for (std::size_t k = 0; k < moving; ++k) {
        const Eigen::Vector2d& other = levers[k];
        const double both = by_normal * other.dot(contact.normal) + by_tangent * other.dot(contact.tangent);
        rows[j * row + k] += stiffness * both;
      }
    }
  }
  for (std::size_t slot = 0; slot < forces_n.size(); ++slot) {
    forces_n[slot] = Eigen::Vector2d(on_fingers_n[2 * slot], on_fingers_n[2 * slot + 1]).norm();
  }
}

// Whether it is crushed, set down again, or settled and therefore lifted.
void Grasp::watch(double wound_m, double dt_s) {
  std::vector<double> push_n(places_.size(), 0.0);
  for (const Contact& contact : contacts_) push_n[contact.slot] += contact.push_n;
  const double total_n = sum(push_n);
  const double hardest_n = std::max(palm_push_n_, *std::max_element(push_n.begin(), push_n.end()));
  if (hardest_n > product_->crush_n) crushed_ = true;
  max_wound_m_ = std::max(max_wound_m_, wound_m);
  if (max_wound_m_ - wound_m > kSetDownPayout_m) {
    // The fingers open: the arm has set the product down before.
    lifted_ = false;
    return;
  }
  const bool quiet = std::abs(total_n - push_before_n_) < kSettledRate_n_per_s * dt_s;
  push_before_n_ = total_n;
  settled_s_ = quiet && total_n > kSettledForce_n ? settled_s_ + dt_s : 0.0;
  if (lifts_itself && settled_s_ > kSettled_s) lifted_ = true;
}

// The palm is a plane with the pads' stiffness; along it the product sticks until Coulomb's limit.
void Grasp::lean_on_palm(double stiffness, double dt_s) {
  const double depth_m = palm_m_ + 0.5 * product_->height_m - centre_m_.y();
  palm_push_n_ = stiffness * std::max(0.0, depth_m);
  const double limit_m = product_->friction * palm_push_n_ / stiffness;
  palm_stick_m_ = std::clamp(palm_stick_m_ + velocity_m_s_.x() * dt_s, -limit_m, limit_m);
}

void Grasp::move_product(double stiffness, double dt_s) {
  Eigen::Vector2d force_n = Eigen::Vector2d::Zero();
  Eigen::Matrix2d matrix = Eigen::Matrix2d::Identity() * (kDamping_ns_per_m / dt_s);
  for (const Contact& contact : contacts_) {
    force_n -= contact.on_finger_n();
    if (contact.push_n > 0.0) matrix += stiffness * contact.normal * contact.normal.transpose();
    if (contact.sticks) matrix += stiffness * contact.tangent * contact.tangent.transpose();
  }
  if (palm_push_n_ > 0.0) {
    force_n += Eigen::Vector2d(-stiffness * palm_stick_m_, palm_push_n_);
    matrix += stiffness * Eigen::Matrix2d::Identity();
  }
  Eigen::Vector2d change_m(force_n.x() / matrix(0, 0), 0.0);  // the table carries it; it slides along
  if (lifted_) {
    force_n.y() += product_->mass_kg * kGravity_m_s2 * kDynamicLoadFactor;
    change_m = matrix.partialPivLu().solve(force_n);
  }
  change_m = (kRelaxation * change_m).cwiseMax(-kLargestMove_m).cwiseMin(kLargestMove_m);
  centre_m_ += change_m;
  velocity_m_s_ = change_m / dt_s;
  if (lifted_) notice_loss();
}

void Grasp::notice_loss() {
  if (centre_m_.y() - start_out_m_ <= kLostWay_m) return;
  slipped_ = true;
  lifted_ = false;
  product_.reset();
  press_nothing();
  velocity_m_s_.setZero();
}

}  // namespace softgrip::plant
