// SPDX-License-Identifier: Apache-2.0
#include "path.hpp"

#include <Eigen/LU>

namespace softgrip::finger {
namespace {

constexpr int kMost = kMaxJoints + kMaxSpans + kMaxContacts;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMost, kMost>;
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMost, 1>;

// The lead when none is given, so that its tension is known even where the first bend sticks.
constexpr double kLeastLead_mm = 10.0;
// Below these the state of a bend or a contact does not change: rounding.
constexpr double kSmallestSlip_mm = 1e-12, kSmallestRatio = 1e-9, kSmallestGap = 1e-12;

// Where each unknown sits: angles, ln tensions, contact forces. Rows: moments, bends, the control, contacts.
struct Layout {
  int joints, points, spans, contacts;
  int angle(int j) const { return j; }
  int tension(int i) const { return joints + i; }
  int force(int c) const { return joints + spans + c; }
  int size() const { return joints + spans + contacts; }
};

// The residuals and their Jacobian at one iterate.
class Assembly {
 public:
  Assembly(const Finger& finger, const std::vector<Contact>& contacts, double compliance, const PathStep& before,
           PathStep& at, Control control, double target)
      : finger_(finger),
        contacts_(contacts),
        d_(finger.design),
        compliance_(compliance),
        layout_{d_.joints, 2 * d_.joints, 2 * d_.joints + 1, static_cast<int>(contacts.size())},
        at_(at) {
    jacobian.setZero(layout_.size(), layout_.size());
    residual.setZero(layout_.size());
    for (int i = 0; i < layout_.spans; ++i) tension_[i] = std::exp(at.log_tension[i]);
    for (int j = 0; j < d_.joints; ++j) groove_[j] = finger.groove(j, at.angle_rad[j]);
    add_moments();
    add_contacts();
    add_bends(before);
    add_control(control, target);
  }

  Matrix jacobian;
  Vector residual;
  std::uint8_t friction_status = 0;

  // Changes the states that the iterate contradicts, all or only the first; returns how many.
  int revise(bool all) {
    int changed = 0;
    for (int i = 0; i < layout_.points && (all || changed == 0); ++i) {
      changed += wanted_[i] != at_.slide[i] ? 1 : 0;
      at_.slide[i] = wanted_[i];
    }
    for (int c = 0; c < layout_.contacts && (all || changed == 0); ++c) {
      changed += touches_[c] != at_.touches[c] ? 1 : 0;
      at_.touches[c] = touches_[c];
    }
    return changed;
  }

  // Lets the stuck bends go whose ratio is beyond what friction holds; returns how many.
  int give_way() {
    int changed = 0;
    for (int i = 0; i < layout_.points; ++i) {
      if (at_.slide[i] != Slide::Stuck || wanted_[i] == Slide::Stuck) continue;
      at_.slide[i] = wanted_[i];
      ++changed;
    }
    return changed;
  }

 private:
  void add_moments() {
    for (int j = 0; j < d_.joints; ++j) {
      const double q = at_.angle_rad[j];
      const Moment strip = finger_.strip[j].at(q), stop = stop_moment(d_.stop, d_.opening_rad[j], q);
      const double tension = tension_[2 * j + 1];
      residual[j] = strip.value_Nmm + stop.value_Nmm - tension * groove_[j].arm_mm;
      jacobian(j, layout_.angle(j)) = strip.d_angle + stop.d_angle - tension * groove_[j].d_arm;
      jacobian(j, layout_.tension(2 * j + 1)) = -tension * groove_[j].arm_mm;
    }
  }

  // Moment balance takes up the force along the gap's slope; the row is gap = 0 or force = 0.
  void add_contacts() {
    for (int c = 0; c < layout_.contacts; ++c) {
      const Gap gap = gap_of(contacts_[c], d_, at_.angle_rad);
      const double force = at_.force_N[c];
      const int row = layout_.force(c);
      at_.gap_mm[c] = gap.value_mm;
      for (int i = 0; i < d_.joints; ++i) {
        residual[i] -= force * gap.slope[i];
        jacobian(i, row) = -gap.slope[i];
        for (int j = 0; j < d_.joints; ++j) jacobian(i, j) -= force * gap.curvature(i, j);
      }
      touches_[c] = at_.touches[c] ? force > 0.0 : gap.value_mm < -kSmallestGap;
      if (at_.touches[c]) {
        residual[row] = gap.value_mm;
        for (int j = 0; j < d_.joints; ++j) jacobian(row, j) = gap.slope[j];
      } else {
        residual[row] = force;
        jacobian(row, row) = 1.0;
      }
    }
  }

  // Cable past point i: what the free spans beyond it gave up, and their stretch. From the tip inwards, so that each
  // point's row adds one span to the row before it.
  void add_bends(const PathStep& before) {
    Vector slip_slope = Vector::Zero(layout_.size());
    double slip = 0.0;
    for (int i = layout_.points - 1; i >= 0; --i) {
      add_span(i + 1, slip, slip_slope);
      at_.slip_mm[i] = slip;
      add_bend(i, slip - before.slip_mm[i], slip_slope);
    }
    add_span(0, slip, slip_slope);
    pulled_ = slip;
    pulled_slope_ = slip_slope;
    at_.pulled_mm = slip;
  }

  void add_span(int i, double& slip, Vector& slope) const {
    const bool free_span = i % 2 == 1;
    const int j = i / 2;
    const double length = free_span ? groove_[j].span_mm
                          : i == 0  ? std::max(finger_.link_span_mm[0], kLeastLead_mm)
                                    : finger_.link_span_mm[j];
    const double stretch = compliance_ * tension_[i];
    slip += stretch * length;
    slope[layout_.tension(i)] += stretch * length;
    if (free_span) {
      slip += finger_.straight_span_mm[j] - groove_[j].span_mm;
      slope[layout_.angle(j)] += (1.0 - stretch) * groove_[j].arm_mm;
    }
  }

  void add_bend(int i, double slipped, const Vector& slip_slope) {
    const int j = i / 2, row = d_.joints + i;
    const bool entry = i % 2 == 0;
    const double phi = finger_.bend_rad(i, groove_[j], at_.angle_rad[j]);
    const double phi_slope = entry ? -groove_[j].d_direction : groove_[j].d_direction + 1.0;
    const double log_ratio = at_.log_tension[i] - at_.log_tension[i + 1];
    const PointFriction<friction::Slopes::State> pulled(finger_, phi, {finger_.friction, at_.log_tension[i + 1]});
    const PointFriction<friction::Slopes::State> back(finger_, phi, {finger_.friction, at_.log_tension[i]});
    friction_status |= pulled.law.status | back.law.status;
    wanted_[i] = next_slide(at_.slide[i], slipped, log_ratio, pulled.law.log_ratio, back.law.log_ratio);
    jacobian(row, layout_.tension(i)) = 1.0;
    jacobian(row, layout_.tension(i + 1)) = -1.0;
    if (at_.slide[i] == Slide::Pulled) {
      residual[row] = log_ratio - pulled.law.log_ratio;
      jacobian(row, layout_.tension(i + 1)) -= pulled.law.d_log_tension;
      jacobian(row, layout_.angle(j)) -= pulled.d_phi * phi_slope;
    } else if (at_.slide[i] == Slide::Back) {
      residual[row] = log_ratio + back.law.log_ratio;
      jacobian(row, layout_.tension(i)) += back.law.d_log_tension;
      jacobian(row, layout_.angle(j)) += back.d_phi * phi_slope;
    } else {
      residual[row] = slipped;
      jacobian.row(row) = slip_slope.transpose();
    }
  }

  // A bend that slides the wrong way sticks first; a stuck one slides where its ratio leaves Coulomb's cone.
  static Slide next_slide(Slide now, double slipped, double log_ratio, double most, double most_back) {
    if (now == Slide::Pulled) return slipped < -kSmallestSlip_mm ? Slide::Stuck : now;
    if (now == Slide::Back) return slipped > kSmallestSlip_mm ? Slide::Stuck : now;
    if (log_ratio > most + kSmallestRatio) return Slide::Pulled;
    return log_ratio < -most_back - kSmallestRatio ? Slide::Back : now;
  }

  void add_control(Control control, double target) {
    const int row = d_.joints + layout_.points;
    if (control == Control::PulledLength) {
      residual[row] = pulled_ - target;
      jacobian.row(row) = pulled_slope_.transpose();
    } else {
      residual[row] = at_.log_tension[0] - std::log(target);
      jacobian(row, layout_.tension(0)) = 1.0;
    }
  }

  const Finger& finger_;
  const std::vector<Contact>& contacts_;
  const Design& d_;
  double compliance_;
  Layout layout_;
  PathStep& at_;
  PerSpan<double> tension_{};
  PerJoint<Groove> groove_ = none(std::make_index_sequence<kMaxJoints>{});
  PerPoint<Slide> wanted_{};
  std::array<bool, kMaxContacts> touches_{};
  double pulled_ = 0.0;
  Vector pulled_slope_;

  template <std::size_t... j>
  static PerJoint<Groove> none(std::index_sequence<j...>) {
    return {((void)j, Groove(1.0, 0.0, 1.0, 1.0))...};
  }
};

}  // namespace

Path::Path(const Finger& finger, const std::vector<Contact>& contacts, const PathSettings& settings)
    : finger_(finger),
      contacts_(contacts),
      settings_(settings),
      compliance_(std::max(finger.design.cable.compliance_per_N, settings.least_compliance_per_N)),
      now_(slack_step()) {}

PathStep Path::slack_step() const {
  PathStep step;
  for (std::size_t c = 0; c < contacts_.size(); ++c) {
    step.gap_mm[c] = gap_of(contacts_[c], finger_.design, step.angle_rad).value_mm;
  }
  step.log_tension.fill(-HUGE_VAL);
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
  while (reached < 1.0) {
    const double next = std::min(1.0, reached + stride);
    const double aim = next == 1.0 ? target : from + (target - from) * next;
    PathStep tried = step;
    if (increment(control, aim, tried)) {
      iterations += tried.iterations;
      step = tried;
      reached = next;
    } else if ((stride *= 0.5) * pieces < 1.0 / 64) {
      return failed.status = tried.status, failed;
    }
  }
  step.iterations = iterations;
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
  out.log_tension = first.log_tension;
  out.slide.fill(Slide::Pulled);
  out.pulled_mm = first.pulled_mm;
  out.iterations = first.iterations;
  const PathStep before = out;
  Assembly(finger_, contacts_, compliance_, before, out, control, target);  // works out the slips made so far
  return true;
}

// Newton for the states assumed; once it stands, the states that it contradicts are changed and it is solved again.
// Late rounds change one state at a time (the one nearest the actuator), which cannot go round in circles as easily.
bool Path::increment(Control control, double target, PathStep& step) const {
  constexpr int kMostRounds = 60, kRoundsAllAtOnce = 12;
  const PathStep before = step;
  int iterations = 0;
  for (int round = 0; round < kMostRounds; ++round) {
    if (!settle(control, target, before, step)) return false;
    iterations += step.iterations;
    Assembly at(finger_, contacts_, compliance_, before, step, control, target);
    if (at.revise(round < kRoundsAllAtOnce) == 0) {
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
  std::uint32_t found = kOk;
  for (int j = 0; j < d.joints; ++j) {
    const double q = step.angle_rad[j];
    if (d.stop.moment_Nmm > 0.0 && q > d.opening_rad[j] - d.stop.margin_rad) found |= kStopEngaged;
    if (finger_.strip[j].surface_strain(q) > d.material.max_strain) found |= kStrainOutside;
    const Groove groove = finger_.groove(j, q);
    for (int i : {2 * j, 2 * j + 1}) {
      const double low = std::min(step.log_tension[i], step.log_tension[i + 1]);
      found |= range_flags(finger_, finger_.bend_rad(i, groove, q), low);
    }
  }
  return found;
}

// Newton with every bend's and contact's state given.
bool Path::settle(Control control, double target, const PathStep& before, PathStep& step) const {
  constexpr int kMostIterations = 40;
  constexpr double kLargestAngleStep = 0.1, kLargestLogStep = 0.7, kSmallest = 1e-9;
  const Design& d = finger_.design;
  const Layout layout{d.joints, 2 * d.joints, 2 * d.joints + 1, static_cast<int>(contacts_.size())};
  step.status = kNotConverged;
  for (step.iterations = 1; step.iterations <= kMostIterations; ++step.iterations) {
    const Assembly at(finger_, contacts_, compliance_, before, step, control, target);
    if ((at.friction_status & friction::kBlowUp) != 0) return step.status = kFrictionBlowUp, false;
    const Vector move = at.jacobian.partialPivLu().solve(-at.residual);
    if (!move.allFinite()) return false;
    double largest = 0.0, scale = 1.0;
    for (int j = 0; j < d.joints; ++j) {
      const double room = 0.8 * (d.opening_rad[j] - step.angle_rad[j]);
      const double turn = move[layout.angle(j)];
      largest = std::max(largest, std::abs(turn));
      scale = std::min(scale, kLargestAngleStep / std::max(std::abs(turn), kLargestAngleStep));
      if (turn > room) scale = std::min(scale, room / turn);
    }
    for (int i = 0; i < layout.spans; ++i) {
      const double change = std::abs(move[layout.tension(i)]);
      largest = std::max(largest, change);
      scale = std::min(scale, kLargestLogStep / std::max(change, kLargestLogStep));
    }
    for (int j = 0; j < d.joints; ++j) step.angle_rad[j] += scale * move[layout.angle(j)];
    for (int i = 0; i < layout.spans; ++i) step.log_tension[i] += scale * move[layout.tension(i)];
    for (int c = 0; c < layout.contacts; ++c) step.force_N[c] += scale * move[layout.force(c)];
    if (largest < kSmallest) return true;
    // far outside Coulomb's cone a stuck bend has no state to settle in: it gives way at once
    if (scale < 1.0 && Assembly(finger_, contacts_, compliance_, before, step, control, target).give_way() > 0)
      continue;
  }
  return false;
}

}  // namespace softgrip::finger
