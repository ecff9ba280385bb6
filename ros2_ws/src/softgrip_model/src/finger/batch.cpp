// SPDX-License-Identifier: Apache-2.0
#include "batch.hpp"

#include <atomic>
#include <thread>

// Also compiled for processors with fused multiply-add; the loader takes what the machine has.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define SOFTGRIP_FOR_EACH_PROCESSOR __attribute__((target_clones("arch=x86-64-v3", "default"), flatten))
#else
#define SOFTGRIP_FOR_EACH_PROCESSOR
#endif

namespace softgrip::finger {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Sensitivities of a finger with fewer joints than the batch's widest would shift its columns, so they are placed one
// block at a time.
void write_gradient(const Finger& finger, const Equilibrium& found, Control control, double target, int widest,
                    double* to) {
  const int rows = sensitivity_rows(widest), columns = sensitivity_columns(widest, finger.friction.model.law);
  std::fill_n(to, rows * columns, kNan);
  if ((found.status & (kFailure | kSlack)) != kOk) return;
  const int n = finger.design.joints;
  const SensitivityPass pass(finger, found, control, target);
  const Sensitivity& s = pass.result();
  for (int row = 0; row < sensitivity_rows(n); ++row) {
    double* line = to + (row < n ? row : widest + row - n) * columns;
    const Column& from = s.d[row];
    line[0] = from[0];
    std::copy_n(from.data() + 1, n, line + 1);
    std::copy_n(from.data() + 1 + n, 2 * n, line + 1 + widest);
    std::copy_n(from.data() + 1 + 3 * n, s.columns - 1 - 3 * n, line + 1 + 3 * widest);
  }
}

void write(const Finger& finger, const Equilibrium& found, PerJoint<Turning>& heading, std::size_t at,
           const BatchOut& out) {
  const int n = finger.design.joints, wide = out.joints;
  const bool failed = (found.status & kFailure) != kOk;
  double* angle = out.angle_rad + at * wide;
  double* rate = out.pull_rate + at * wide;
  double* phi = out.phi_rad + at * 2 * wide;
  double* tension = out.tension_N + at * (2 * wide + 1);
  for (int j = 0; j < wide; ++j) {
    angle[j] = j < n ? found.state.angle_rad[j] : kNan;
    rate[j] = j < n ? found.pull_rate[j] : kNan;
  }
  for (int i = 0; i < 2 * wide; ++i) phi[i] = i < 2 * n ? found.phi_rad[i] : kNan;
  for (int i = 0; i <= 2 * wide; ++i) tension[i] = i <= 2 * n ? std::exp(found.log_tension[i]) : kNan;
  const auto turned = [&heading](int j, double rad) { return heading[j].at(rad); };
  const Tip tip = failed ? Tip{kNan, kNan} : tip_of(finger.design, found.state.angle_rad, turned);
  out.tip_mm[2 * at] = tip.x_mm;
  out.tip_mm[2 * at + 1] = tip.y_mm;
  out.pulled_mm[at] = found.pulled_mm;
  out.status[at] = found.status;
  out.iterations[at] = found.iterations;
}

bool sound(const friction::Model& model) {
  return friction::evaluate(model, 0.0, 1.0).has_value();
}

// One design at all of its targets.
SOFTGRIP_FOR_EACH_PROCESSOR void solve_design(const Design& design, const friction::Model& friction, const double* targets,
                                              std::size_t count, Control control, bool march, std::size_t at,
                                              const BatchOut& out) {
  std::uint32_t refusal = sound(design) ? kOk : kBadDesign;
  if (refusal == kOk && !sound(friction)) refusal = kBadFriction;
  Design d = design;
  if (refusal != kOk) d.link_mm.fill(kNan);
  const Finger finger(d, friction);
  const std::size_t gradient_size =
      static_cast<std::size_t>(sensitivity_rows(out.joints) * sensitivity_columns(out.joints, friction.law));
  March marcher(finger, control);
  PerJoint<Turning> heading;
  for (std::size_t k = 0; k < count; ++k, ++at) {
    const Equilibrium found = refusal != kOk ? detail::without_solution(refusal)
                              : march        ? marcher.to(targets[k])
                                             : solve(finger, control, targets[k]);
    write(finger, found, heading, at, out);
    if (out.gradient != nullptr) {
      write_gradient(finger, found, control, targets[k], out.joints, out.gradient + at * gradient_size);
    }
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
