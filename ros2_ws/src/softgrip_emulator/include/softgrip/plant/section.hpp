// SPDX-License-Identifier: Apache-2.0
// The cross-section of a strip as fibres: what strain and curvature do to its normal force and moment. SI units.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace softgrip::plant {

// Nominal stress [Pa] of a fibre stretched by e: e (c1 + c2 e + c3 e^2) in tension, and the same of |e| in compression.
struct StressLaw {
  std::array<double, 3> tension, compression;

  struct Point {
    double stress_pa, tangent_pa;
  };

  Point at(double strain) const {
    const auto& c = strain < 0.0 ? compression : tension;
    const double size = std::abs(strain);
    const double stress = size * (c[0] + size * (c[1] + size * c[2]));
    const double tangent = c[0] + size * (2.0 * c[1] + 3.0 * size * c[2]);
    // A fibre that is stretched beyond what was measured keeps a rest of its stiffness.
    return {strain < 0.0 ? -stress : stress, std::max(tangent, kMinTangentShare * c[0])};
  }

 private:
  static constexpr double kMinTangentShare = 0.1;
};

struct SectionForce {
  double normal_n, moment_nm;
  double by_strain_n, by_both_nm, by_curvature_nm2;  // tangent: dN/de, dN/dk = dM/de, dM/dk
};

// A rectangle, `thickness_m` in the plane of bending, `width_m` across it; positive curvature compresses positive y.
class Section {
 public:
  // `plate`: how much stiffer than a narrow bar, 1 / (1 - nu^2) where the strip is too wide to contract across.
  Section(const StressLaw& law, double thickness_m, double width_m, double plate)
      : law_(law), half_m_(0.5 * thickness_m), area_m2_(plate * thickness_m * width_m) {}

  SectionForce force(double strain, double curvature) const {
    SectionForce sum{};
    for (std::size_t k = 0; k < kPlaces.size(); ++k) {
      const double y = kPlaces[k] * half_m_, area = 0.5 * kWeights[k] * area_m2_;
      const auto [stress, tangent] = law_.at(strain - y * curvature);
      sum.normal_n += area * stress;
      sum.moment_nm -= area * y * stress;
      sum.by_strain_n += area * tangent;
      sum.by_both_nm -= area * y * tangent;
      sum.by_curvature_nm2 += area * y * y * tangent;
    }
    return sum;
  }

 private:
  // Gauss' four points: exact for stresses up to the sixth power of the place.
  static constexpr std::array<double, 4> kPlaces{-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                                 0.8611363115940526};
  static constexpr std::array<double, 4> kWeights{0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                                  0.3478548451374538};
  StressLaw law_;
  double half_m_, area_m2_;
};

}  // namespace softgrip::plant
