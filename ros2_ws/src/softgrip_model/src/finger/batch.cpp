// SPDX-License-Identifier: Apache-2.0
#include "batch.hpp"

#include <atomic>
#include <thread>

// Also compiled for processors with fused multiply-add and wide registers; the loader takes what the machine has.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define SOFTGRIP_SEVERAL_PROCESSORS
#define SOFTGRIP_FOR_EACH_PROCESSOR __attribute__((target_clones("arch=x86-64-v3", "default"), flatten))
#else
#define SOFTGRIP_FOR_EACH_PROCESSOR
#endif

namespace softgrip::finger {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kWaitForLanes = 4;  // targets solved one by one before lanes are tried again

// Sensitivities of a finger with fewer joints than the batch's widest would shift its columns, so they are placed one
// block at a time.
void write_gradient(const Finger& finger, const Equilibrium& found, Control control, double target, int widest,
                    double* to) {
  const int rows = sensitivity_rows(widest), columns = sensitivity_columns(widest, finger.friction.model.law);
  std::fill_n(to, rows * columns, kNan);
  if ((found.status & (kFailure | kSlack)) != kOk) return;
  const int n = finger.design.joints;
  const Sensitivity s = sensitivity_of(finger, found, control, target);
  for (int row = 0; row < sensitivity_rows(n); ++row) {
    double* line = to + (row < n ? row : widest + row - n) * columns;
    const Column& from = s.d[row];
    line[0] = from[0];
    std::copy_n(from.data() + 1, n, line + 1);
    std::copy_n(from.data() + 1 + n, 2 * n, line + 1 + widest);
    std::copy_n(from.data() + 1 + 3 * n, s.columns - 1 - 3 * n, line + 1 + 3 * widest);
  }
}

std::uint32_t status_of(std::uint32_t status, int) {
  return status;
}
template <typename Flags>
std::uint32_t status_of(const Flags& status, int i) {
  return static_cast<std::uint32_t>(status[i]);
}

// One element, or several beside one another. `headings` gives the links' directions.
template <typename Real, typename Headings>
void write(const Finger& finger, const EquilibriumOf<Real>& found, Headings&& headings, std::size_t at,
           const BatchOut& out) {
  const int n = finger.design.joints, wide = out.joints;
  PerJoint<Real> angle_rad = found.state.angle_rad;
  TipOf<Real> tip;
  if (finger.is_flexure()) {
    if constexpr (kLanes<Real> == 1) {
      const auto seen = posture_of(finger, found);
      angle_rad = seen.angle_rad;
      tip = {seen.x_mm, seen.y_mm};
    }
  } else {
    tip = tip_of(finger.design, angle_rad, headings);
  }
  PerSpan<Real> tension;
  for (int i = 0; i <= 2 * n; ++i) tension[i] = exp(found.log_tension[i]);
  for (int k = 0; k < kLanes<Real>; ++k, ++at) {
    double* angle = out.angle_rad + at * wide;
    double* rate = out.pull_rate + at * wide;
    double* phi = out.phi_rad + at * 2 * wide;
    double* tension_N = out.tension_N + at * (2 * wide + 1);
    for (int j = 0; j < wide; ++j) {
      angle[j] = j < n ? lane(angle_rad[j], k) : kNan;
      rate[j] = j < n ? lane(found.pull_rate[j], k) : kNan;
    }
    for (int i = 0; i < 2 * wide; ++i) phi[i] = i < 2 * n ? lane(found.phi_rad[i], k) : kNan;
    for (int i = 0; i <= 2 * wide; ++i) tension_N[i] = i <= 2 * n ? lane(tension[i], k) : kNan;
    out.tip_mm[2 * at] = lane(tip.x_mm, k);
    out.tip_mm[2 * at + 1] = lane(tip.y_mm, k);
    out.pulled_mm[at] = lane(found.pulled_mm, k);
    out.status[at] = status_of(found.status, k);
    out.iterations[at] = found.iterations;
  }
}

bool sound(const friction::Model& model) {
  return friction::evaluate(model, 0.0, 1.0).has_value();
}

// The next targets of a closing side by side; how many were solved, 0 when they have to be asked for one by one.
template <int lanes>
std::size_t solve_lanes(const Finger& finger, March& marcher, const double* targets, std::size_t left, std::size_t at,
                        const BatchOut& out) {
  EquilibriumOf<Lanes<lanes>> found;
  if (left < lanes || !marcher.to(targets, found)) return 0;
  write(finger, found, [](int, const Lanes<lanes>& heading) { return DirectionOf<Lanes<lanes>>(heading); }, at, out);
  return lanes;
}

// As many lanes as a register has, or two where that is not known.
#define SOFTGRIP_SOLVE_SEVERAL(lanes)                                                                      \
  std::size_t solve_several(const Finger& finger, March& marcher, const double* targets, std::size_t left, \
                            std::size_t at, const BatchOut& out) {                                         \
    return solve_lanes<lanes>(finger, marcher, targets, left, at, out);                                    \
  }
// clang-format off: definitions by a macro look to it like one long declaration
#ifdef SOFTGRIP_SEVERAL_PROCESSORS
__attribute__((target("arch=x86-64-v4"), flatten)) SOFTGRIP_SOLVE_SEVERAL(8)
__attribute__((target("arch=x86-64-v3"), flatten)) SOFTGRIP_SOLVE_SEVERAL(4)
__attribute__((target("default"), flatten)) SOFTGRIP_SOLVE_SEVERAL(2)
#else
SOFTGRIP_SOLVE_SEVERAL(2)
#endif
// clang-format on

// One design at all of its targets.
SOFTGRIP_FOR_EACH_PROCESSOR void solve_design(const Design& design, const friction::Model& friction,
                                              const double* targets, std::size_t count, Control control, bool march,
                                              std::size_t at, const BatchOut& out) {
  std::uint32_t refusal = sound(design) ? kOk : kBadDesign;
  if (refusal == kOk && !sound(friction)) refusal = kBadFriction;
  Design d = design;
  if (refusal != kOk) d.link_mm.fill(kNan);
  const Finger finger(d, friction);
  const std::size_t gradient_size = static_cast<std::size_t>(sensitivity_rows(out.joints)) *
                                    static_cast<std::size_t>(sensitivity_columns(out.joints, friction.law));
  March marcher(finger, control);
  PerJoint<Turning> heading;
  const bool together = march && refusal == kOk && out.gradient == nullptr && !finger.is_flexure();
  std::size_t next_together = 0;  // where lanes are tried next
  for (std::size_t k = 0; k < count;) {
    if (together && k >= next_together) {
      const std::size_t solved = solve_several(finger, marcher, targets + k, count - k, at + k, out);
      k += solved;
      if (solved > 0) continue;
      next_together = k + kWaitForLanes;
    }
    const Equilibrium found = refusal != kOk ? detail::without_solution(refusal)
                              : march        ? marcher.to(targets[k])
                                             : solve(finger, control, targets[k]);
    write(finger, found, [&heading](int j, double rad) { return heading[j].at(rad); }, at + k, out);
    if (out.gradient != nullptr) {
      write_gradient(finger, found, control, targets[k], out.joints, out.gradient + (at + k) * gradient_size);
    }
    ++k;
  }
}

}  // namespace

void solve_batch(const std::vector<Design>& designs, const std::vector<friction::Model>& frictions,
                 const double* targets, std::size_t targets_per_design, Control control, bool march, int threads,
                 const BatchOut& out) {
  std::atomic<std::size_t> next{0};
  constexpr std::size_t kChunk = 16;
  auto work = [&] {
    for (std::size_t begin = next.fetch_add(kChunk); begin < designs.size(); begin = next.fetch_add(kChunk)) {
      for (std::size_t i = begin; i < std::min(begin + kChunk, designs.size()); ++i) {
        const std::size_t at = i * targets_per_design;
        solve_design(designs[i], frictions[i], targets + at, targets_per_design, control, march, at, out);
      }
    }
  };
  std::vector<std::thread> helpers;
  for (int t = 1; t < threads && static_cast<std::size_t>(t) * kChunk < designs.size(); ++t) helpers.emplace_back(work);
  work();
  for (std::thread& helper : helpers) helper.join();
}

}  // namespace softgrip::finger
