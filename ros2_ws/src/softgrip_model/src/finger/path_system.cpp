// SPDX-License-Identifier: Apache-2.0
#include "path_system.hpp"

namespace softgrip::finger {
namespace {

// The lead when none is given, so that its tension is known even where the first bend sticks.
constexpr double kMinLead_mm = 10.0;
// Below these the state of a bend or a contact does not change: rounding.
constexpr double kSmallestSlip_mm = 1e-12, kSmallestRatio = 1e-9, kSmallestGap = 1e-12;

// A bend that slides the wrong way sticks first; a stuck one slides where its ratio leaves Coulomb's cone.
Slide next_slide(Slide now, double slipped, double log_ratio, double max_log_ratio, double max_back_log_ratio) {
  if (now == Slide::Pulled) return slipped < -kSmallestSlip_mm ? Slide::Stuck : now;
  if (now == Slide::Back) return slipped > kSmallestSlip_mm ? Slide::Stuck : now;
  if (log_ratio > max_log_ratio + kSmallestRatio) return Slide::Pulled;
  return log_ratio < -max_back_log_ratio - kSmallestRatio ? Slide::Back : now;
}

// Every number carries its derivatives to all unknowns of a finger with up to kJoints joints.
template <int kJoints>
class PathAssembly {
 public:
  PathAssembly(const Finger& finger, const std::vector<Contact>& contacts, double compliance, const PathStep& before,
               PathStep& at)
      : finger_(finger),
        contacts_(contacts),
        d_(finger.design),
        layout_(finger, contacts.size()),
        compliance_(compliance),
        before_(before),
        at_(at) {
    system_.jacobian.setZero(layout_.size(), layout_.size());
    system_.residual.setZero(layout_.size());
    for (int i = 0; i < layout_.spans(); ++i) {
      log_tension_[i] = Real::variable(at.log_tension[i], layout_.tension(i));
      tension_[i] = exp(log_tension_[i]);
    }
    for (int c = 0; c < layout_.contacts; ++c) force_[c] = Real::variable(at.force_N[c], layout_.force(c));
    place_links();
    meet_objects();
    for (int j = 0; j < d_.joints; ++j) finger.is_flexure() ? balance_flexure(j) : balance_hinge(j);
    pull_cable();
  }

  PathSystem close_with(Control control, double target) {
    const bool by_length = control == Control::PulledLength;
    set_row(layout_.control(), by_length ? pulled_ - target : log_tension_[0] - std::log(target));
    return system_;
  }

 private:
  using Real = Jet<3 * kJoints + 2 * kJoints + 1 + kMaxContacts>;
  using Pose = PoseOf<Real>;
  struct Place {
    Real x, y;
  };

  void set_row(int row, const Real& value) {
    system_.residual[row] = value.value;
    for (int i = 0; i < layout_.size(); ++i) system_.jacobian(row, i) = value.d[i];
  }

  Real angle_of(int j) const { return Real::variable(at_.angle_rad[j], layout_.joint(j)); }
  Real shift_of(int j, int i) const {
    return finger_.is_flexure() ? Real::variable(at_.shift_mm[j][i], layout_.joint(j) + 1 + i) : Real(0.0);
  }

  // The frames before the joints, the links' middles, and the angles between these.
  void place_links() {
    Pose at;
    for (int j = 0; j < d_.joints; ++j) {
      joint_[j] = at;
      angle_[j] += angle_of(j);
      at = at.after(Pose::turned(-1.0 * angle_of(j), shift_of(j, 0), shift_of(j, 1)));
      if (finger_.is_flexure()) {
        const LinkEndOf<double>&exit = finger_.flexure.exit_end[j], &entry = finger_.flexure.entry_end[j];
        const Real& tension = tension_[2 * j + 2];
        angle_[j] += exit.turn * tension;
        if (j + 1 < d_.joints) angle_[j + 1] += entry.turn * tension;
        link_[j] = at.after(link_middle<Real>(exit, tension));
        at = link_[j].after(link_far_end<Real>(d_.link_mm[j], entry, tension));
      } else {
        link_[j] = at;
        at = at.after(Pose::turned(Real(0.0), Real(d_.link_mm[j]), Real(0.0)));
      }
      at_.seen_rad[j] = angle_[j].value;
    }
    at_.tip_mm = {at.x.value, at.y.value};
  }

  // A point on a link's line. The halves of a link of mode F bend away from its middle, as far as their ends do.
  Place place_on(int j, double along_mm) const {
    Real x(along_mm), y(0.0);
    if (finger_.is_flexure()) {
      const double half = 0.5 * d_.link_mm[j], share = (along_mm - half) / half;
      const LinkEndOf<double>& end = share > 0.0 ? finger_.flexure.entry_end[j] : finger_.flexure.exit_end[j];
      const Real bent = (share * share) * tension_[2 * j + 2];
      x += (share > 0.0 ? -end.along : end.along) * bent;
      y -= end.across * bent;
    }
    return {link_[j].x + link_[j].cosine * x - link_[j].sine * y, link_[j].y + link_[j].sine * x + link_[j].cosine * y};
  }

  void meet_objects() {
    for (int c = 0; c < layout_.contacts; ++c) {
      const Contact& contact = contacts_[c];
      const Real gap = contact.kind == ContactKind::JointLimit ? limit(contact, force_[c]) : push(contact, force_[c]);
      const int row = layout_.force(c);
      at_.gap_mm[c] = gap.value;
      system_.touches[c] = at_.touches[c] ? at_.force_N[c] > 0.0 : gap.value < -kSmallestGap;
      set_row(row, at_.touches[c] ? gap : force_[c]);
    }
  }

  Real limit(const Contact& contact, const Real& moment) {
    object_[contact.index].moment -= moment;
    return contact.limit_rad - angle_[contact.index];
  }

  // A force along the surface's normal; every strip before it carries its share.
  Real push(const Contact& contact, const Real& force) {
    const Place point = place_on(contact.index, contact.along_mm);
    Place normal{Real(contact.x_mm), Real(contact.y_mm)};
    Real gap;
    if (contact.kind == ContactKind::Plane) {
      gap = normal.x * point.x + normal.y * point.y - contact.size_mm;
    } else {
      const Place away{point.x - contact.x_mm, point.y - contact.y_mm};
      const Real distance = sqrt(Real(away.x * away.x + away.y * away.y));
      normal = {away.x / distance, away.y / distance};
      gap = distance - contact.size_mm;
    }
    for (int j = 0; j <= contact.index; ++j) {
      const Pose& frame = joint_[j];
      const Real dx = point.x - frame.x, dy = point.y - frame.y;
      object_[j].force_x -= force * (frame.cosine * normal.x + frame.sine * normal.y);
      object_[j].force_y -= force * (frame.cosine * normal.y - frame.sine * normal.x);
      object_[j].moment -= force * (dx * normal.y - dy * normal.x);
    }
    return gap;
  }

  void balance_hinge(int j) {
    const Real q = angle_of(j);
    const GrooveOf<Real> groove(d_.opening_rad[j], q, d_.routing_mm[2 * j], d_.routing_mm[2 * j + 1]);
    const Moment strip = finger_.strip[j].at(q.value), stop = stop_moment(d_.stop, d_.opening_rad[j], q.value);
    const Real held = q.through(strip.value_Nmm + stop.value_Nmm, strip.d_angle + stop.d_angle);
    set_row(layout_.joint(j), held - tension_[2 * j + 1] * groove.arm_mm - object_[j].moment);
    at_.strip_bend_rad[j] = q.value;
    span_[j] = groove.span_mm;
    taken_[j] = finger_.straight_span_mm[j] - groove.span_mm;
    phi_[2 * j] = finger_.slope_rad[j] - groove.direction_rad;
    phi_[2 * j + 1] = groove.direction_rad - finger_.slope_rad[j + 1] + q;
  }

  void balance_flexure(int j) {
    const FlexuresOf<double>& f = finger_.flexure;
    const Real q = angle_of(j);
    FlexureState<Real, double> joint(f.joint[j], q, shift_of(j, 0), shift_of(j, 1));
    const Moment stop = stop_moment(d_.stop, d_.opening_rad[j], q.value);
    joint.load(
        tension_[2 * j + 1], [&](const Real& bend) { return finger_.strip_moment(f, j, bend); },
        q.through(stop.value_Nmm, stop.d_angle), object_[j]);
    for (int i = 0; i < 3; ++i) set_row(layout_.joint(j) + i, joint.residual[i]);
    at_.strip_bend_rad[j] = joint.bend_rad.value;
    span_[j] = joint.span_mm;
    taken_[j] = f.straight_span_mm[j] - joint.span_mm;
    shortening_[j] = f.link_shortening(j) * tension_[2 * j + 2];
    phi_[2 * j] = f.entry_bend(j, joint.direction_rad, tension_[2 * j + 1]);
    phi_[2 * j + 1] = f.exit_bend(j, joint.direction_rad, q, tension_[2 * j + 2]);
  }

  // Cable past point i: what the free spans and links beyond it gave up, and their stretch.
  void pull_cable() {
    Real slip(0.0);
    for (int i = layout_.points() - 1; i >= 0; --i) {
      slip += given_up(i + 1);
      at_.slip_mm[i] = slip.value;
      bend(i, slip - before_.slip_mm[i]);
    }
    pulled_ = slip + given_up(0);
    at_.pulled_mm = pulled_.value;
  }

  Real given_up(int span) const {
    const int j = span / 2;
    const Real stretch = compliance_ * tension_[span];
    if (span % 2 == 1) return taken_[j] + stretch * span_[j];
    if (span == 0) return stretch * std::max(finger_.link_span_mm[0], kMinLead_mm);
    return shortening_[j - 1] + stretch * finger_.link_span_mm[j];
  }

  void bend(int i, const Real& slipped) {
    const Real& phi = phi_[i];
    const Real ratio = log_tension_[i] - log_tension_[i + 1];
    const PointFriction<friction::Slopes::State> pulled(finger_, phi.value, {finger_.friction, at_.log_tension[i + 1]});
    const PointFriction<friction::Slopes::State> back(finger_, phi.value, {finger_.friction, at_.log_tension[i]});
    at_.phi_rad[i] = phi.value;
    system_.friction_status |= pulled.law.status | back.law.status;
    system_.required_slide[i] =
        next_slide(at_.slide[i], slipped.value, ratio.value, pulled.law.log_ratio, back.law.log_ratio);
    auto held = [&](const auto& point, const Real& log_low) {
      return phi.through(point.law.log_ratio, point.d_phi) + log_low.through(0.0, point.law.d_log_tension);
    };
    Real row = slipped;
    if (at_.slide[i] == Slide::Pulled) row = ratio - held(pulled, log_tension_[i + 1]);
    if (at_.slide[i] == Slide::Back) row = ratio + held(back, log_tension_[i]);
    set_row(layout_.bend(i), row);
  }

  const Finger& finger_;
  const std::vector<Contact>& contacts_;
  const Design& d_;
  PathLayout layout_;
  double compliance_;
  const PathStep& before_;
  PathStep& at_;
  PathSystem system_;

  std::array<Real, 2 * kJoints + 1> log_tension_, tension_;
  std::array<Real, kMaxContacts> force_;
  std::array<Pose, kJoints> joint_, link_;
  std::array<ObjectLoad<Real>, kJoints> object_;
  std::array<Real, kJoints> angle_, span_, taken_, shortening_;
  std::array<Real, 2 * kJoints> phi_;
  Real pulled_;
};

}  // namespace

int PathSystem::revise(PathStep& at, const PathLayout& layout, bool all) const {
  int changed = 0;
  for (int i = 0; i < layout.points() && (all || changed == 0); ++i) {
    changed += required_slide[i] != at.slide[i] ? 1 : 0;
    at.slide[i] = required_slide[i];
  }
  for (int c = 0; c < layout.contacts && (all || changed == 0); ++c) {
    changed += touches[c] != at.touches[c] ? 1 : 0;
    at.touches[c] = touches[c];
  }
  return changed;
}

int PathSystem::give_way(PathStep& at, const PathLayout& layout) const {
  int changed = 0;
  for (int i = 0; i < layout.points(); ++i) {
    if (at.slide[i] != Slide::Stuck || required_slide[i] == Slide::Stuck) continue;
    at.slide[i] = required_slide[i];
    ++changed;
  }
  return changed;
}

PathSystem path_system(const Finger& finger, const std::vector<Contact>& contacts, double compliance,
                       const PathStep& before, PathStep& at, Control control, double target) {
  if (finger.design.joints <= 3) {
    return PathAssembly<3>(finger, contacts, compliance, before, at).close_with(control, target);
  }
  return PathAssembly<kMaxJoints>(finger, contacts, compliance, before, at).close_with(control, target);
}

}  // namespace softgrip::finger
