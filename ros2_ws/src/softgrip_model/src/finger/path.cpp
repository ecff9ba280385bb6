// SPDX-License-Identifier: Apache-2.0
#include "path.hpp"

namespace softgrip::finger {
namespace {

// An object grows back to its size in so many steps.
constexpr int kGrowth = 16;

// An object whose surface stands back by so much [mm].
Contact set_back(Contact contact, double by) {
  if (contact.kind != ContactKind::JointLimit) contact.size_mm -= by;
  return contact;
}

}  // namespace

Path::Path(const Finger& finger, const std::vector<Contact>& contacts, const PathSettings& settings)
    : finger_(finger),
      contacts_(contacts),
      settings_(settings),
      layout_(finger, contacts.size()),
      compliance_(std::max(finger.design.cable.compliance_per_N, settings.min_compliance_per_N)),
      now_(slack_step()) {}

PathStep Path::slack_step() const {
  PathStep step;
  step.log_tension.fill(-HUGE_VAL);
  const PathStep before = step;
  system_at(before, step, Control::Tension, 1.0);  // works out the gaps and the tip
  step.slip_mm.fill(0.0);
  step.pulled_mm = 0.0;
  return step;
}

PathStep Path::to(Control control, double target) {
  const std::uint32_t refusal = detail::unsolvable(finger_, control, target);
  PathStep failed = now_;
  failed.status = refusal;
  if (refusal != kOk) return failed;
  if (target <= 0.0) return now_ = slack_step();
  PathStep step = now_;
  int iterations = 0;
  if ((now_.status & kSlack) != 0) {
    if (!begin(control, target, step)) return failed.status = step.status, failed;
    iterations += step.iterations;
  }
  const double largest =
      control == Control::PulledLength ? settings_.largest_pull_step_mm : settings_.largest_tension_step_N;
  const double from = control == Control::PulledLength ? step.pulled_mm : std::exp(step.log_tension[0]);
  const int pieces = std::max(1, static_cast<int>(std::ceil(std::abs(target - from) / largest)));
  double reached = 0.0, stride = 1.0 / pieces;
  std::uint32_t remark = kOk;
  while (reached < 1.0) {
    const double next = std::min(1.0, reached + stride);
    const double aim = next == 1.0 ? target : from + (target - from) * next;
    PathStep tried = step;
    if (increment(control, aim, tried)) {
      iterations += tried.iterations;
      step = tried;
      reached = next;
      continue;
    }
    stride *= 0.5;
    if (stride * pieces < 1.0 / 64) {
      if (!snap(control, aim, step)) return failed.status = tried.status, failed;
      iterations += step.iterations;
      remark = kSnapped;
      reached = next;
      stride = 1.0 / pieces;
    }
  }
  step.iterations = iterations;
  step.status |= remark;
  now_ = step;
  return step;
}

// From the slack finger to a first small pull, where every point slides.
bool Path::begin(Control control, double target, PathStep& out) {
  const double largest =
      control == Control::PulledLength ? settings_.largest_pull_step_mm : settings_.largest_tension_step_N;
  const Equilibrium first = solve(finger_, control, std::min(target, 0.5 * largest));
  out.status = first.status & kFailure;
  if (out.status != kOk) return false;
  out.angle_rad = first.state.angle_rad;
  out.shift_mm = first.state.shift_mm;
  out.log_tension = first.log_tension;
  out.slide.fill(Slide::Pulled);
  out.pulled_mm = first.pulled_mm;
  out.iterations = first.iterations;
  const PathStep before = out;
  system_at(before, out, control, target);  // works out the slips made so far
  return true;
}

// Where the path of equilibria turns back, the finger jumps: to where it would stand without the objects, and from
// there to the surfaces of those that it would stand in, which grow to their size around it.
bool Path::snap(Control control, double target, PathStep& step) {
  const std::vector<Contact> objects = contacts_;
  PathStep found = step;
  std::vector<double> back(objects.size(), 1e6);  // [mm] out of reach
  const auto stand_back = [&](double share) {
    for (std::size_t c = 0; c < objects.size(); ++c) contacts_[c] = set_back(objects[c], share * back[c]);
  };
  stand_back(1.0);
  bool is_found = relax(control, target, found);
  for (std::size_t c = 0; c < objects.size(); ++c) back[c] = std::max(0.0, back[c] - found.gap_mm[c]);
  for (int k = kGrowth - 1; k >= 0 && is_found; --k) {
    stand_back(static_cast<double>(k) / kGrowth);
    is_found = increment(control, target, found);
  }
  contacts_ = objects;
  if (is_found) step = found;
  return is_found;
}

// Lets go of all objects: from the state as it is, or else from the closing that has no past.
bool Path::relax(Control control, double target, PathStep& step) const {
  step.touches.fill(false);
  step.force_N.fill(0.0);
  PathStep near = step;
  if (increment(control, target, near)) return step = near, true;
  const Equilibrium closing = solve(finger_, control, target);
  if ((closing.status & kFailure) != 0) return false;
  step.angle_rad = closing.state.angle_rad;
  step.shift_mm = closing.state.shift_mm;
  step.log_tension = closing.log_tension;
  step.slide.fill(Slide::Pulled);
  return increment(control, target, step);
}

// Newton for the states assumed; once it stands, the states that it contradicts are changed and it is solved again.
// Late rounds change one state at a time (the one nearest the actuator), which cannot go round in circles as easily.
bool Path::increment(Control control, double target, PathStep& step) const {
  constexpr int kMaxRounds = 60, kRoundsAllAtOnce = 12;
  const PathStep before = step;
  int iterations = 0;
  for (int round = 0; round < kMaxRounds; ++round) {
    if (!settle(control, target, before, step)) return false;
    iterations += step.iterations;
    const PathSystem at = system_at(before, step, control, target);
    if (at.revise(step, layout_, round < kRoundsAllAtOnce) == 0) {
      step.iterations = iterations;
      step.status = flags(step);
      return true;
    }
  }
  step.status = kNotConverged;
  return false;
}

std::uint32_t Path::flags(const PathStep& step) const {
  const Design& d = finger_.design;
  std::uint32_t found = finger_.remarks;
  for (int j = 0; j < d.joints; ++j) {
    if (d.stop.moment_Nmm > 0.0 && step.angle_rad[j] > d.opening_rad[j] - d.stop.margin_rad) found |= kStopEngaged;
    if (finger_.strip[j].surface_strain(step.strip_bend_rad[j]) > d.material.max_strain) found |= kStrainOutside;
    for (int i : {2 * j, 2 * j + 1}) {
      found |= range_flags(finger_, step.phi_rad[i], std::min(step.log_tension[i], step.log_tension[i + 1]));
    }
  }
  return found;
}

PathSystem Path::system_at(const PathStep& before, PathStep& step, Control control, double target) const {
  return path_system(finger_, contacts_, compliance_, before, step, control, target);
}

// Newton with every bend's and contact's state given.
bool Path::settle(Control control, double target, const PathStep& before, PathStep& step) const {
  constexpr int kMaxIterations = 40;
  constexpr double kLargestAngleStep = 0.1, kLargestLogStep = 0.7, kSmallest = 1e-9;
  const Design& d = finger_.design;
  step.status = kNotConverged;
  for (step.iterations = 1; step.iterations <= kMaxIterations; ++step.iterations) {
    const PathSystem at = system_at(before, step, control, target);
    if ((at.friction_status & friction::kBlowUp) != 0) return step.status = kFrictionBlowUp, false;
    const PathSystem::Vector move = at.jacobian.partialPivLu().solve(-at.residual);
    if (!move.allFinite()) return false;
    double largest = 0.0, scale = 1.0;
    for (int j = 0; j < d.joints; ++j) {
      const double room = 0.8 * (d.opening_rad[j] - step.angle_rad[j]);
      const double turn = move[layout_.joint(j)];
      largest = std::max(largest, std::abs(turn));
      scale = std::min(scale, kLargestAngleStep / std::max(std::abs(turn), kLargestAngleStep));
      if (turn > room) scale = std::min(scale, room / turn);
      for (int i = 1; i < layout_.per_joint; ++i) {
        largest = std::max(largest, std::abs(move[layout_.joint(j) + i]) / d.length_mm[j]);
      }
    }
    for (int i = 0; i < layout_.spans(); ++i) {
      const double change = std::abs(move[layout_.tension(i)]);
      largest = std::max(largest, change);
      scale = std::min(scale, kLargestLogStep / std::max(change, kLargestLogStep));
    }
    for (int j = 0; j < d.joints; ++j) {
      step.angle_rad[j] += scale * move[layout_.joint(j)];
      for (int i = 1; i < layout_.per_joint; ++i) step.shift_mm[j][i - 1] += scale * move[layout_.joint(j) + i];
    }
    for (int i = 0; i < layout_.spans(); ++i) step.log_tension[i] += scale * move[layout_.tension(i)];
    for (int c = 0; c < layout_.contacts; ++c) step.force_N[c] += scale * move[layout_.force(c)];
    if (largest < kSmallest) return true;
    // far outside Coulomb's cone a stuck bend has no state to settle in: it gives way at once
    if (scale < 1.0 && system_at(before, step, control, target).give_way(step, layout_) > 0) continue;
  }
  return false;
}

}  // namespace softgrip::finger
