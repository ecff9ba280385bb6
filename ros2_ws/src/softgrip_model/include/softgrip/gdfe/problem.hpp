// SPDX-License-Identifier: Apache-2.0
// What a solver is made for (Problem, Settings), what one solve is asked for (Task) and what it finds (Outcome).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "softgrip/gdfe/cable.hpp"
#include "softgrip/gdfe/factor.hpp"
#include "softgrip/gdfe/follower.hpp"
#include "softgrip/gdfe/local_step.hpp"
#include "softgrip/gdfe/mesh.hpp"
#include "softgrip/gdfe/obstacle.hpp"
#include "softgrip/gdfe/ogden.hpp"
#include "softgrip/gdfe/unknowns.hpp"

namespace softgrip::gdfe {

// How L^-1 is applied. Automatic: by multigrid where an axis has more unknowns than kMultigridAbove, else by a factor.
enum class Method : std::uint8_t { Automatic = 0, Direct = 1, Multigrid = 2 };

inline constexpr int kMultigridAbove = 20000;

struct Settings {
  Law law = Law::Calibrated;
  VolumeShape shape = VolumeShape::Proj;
  Metric metric = Metric::Laplacian;
  bool single_precision_factor = true;
  Ordering ordering = Ordering::Automatic;
  Method method = Method::Automatic;
  int window = 10;  // of the Anderson acceleration; 0 = plain iteration
  int threads = 1;
  double step_limit = 0.0;           // largest motion of a node in one iteration [length]; 0 = none
  int sections_after = -1;           // iterations after which rigid cross-sections are a second level; negative = never
  int max_tangent_unknowns = 20000;  // up to here the rigorous law's own tangent stands in for L; 0 = never
};

// What acts on the mesh from outside, beside dead forces and cables.
struct Surroundings {
  std::vector<PressedSurface> pressed;
  std::vector<FollowerPatch> followers;
  std::vector<Obstacle> obstacles;
};

struct Problem {
  Nodes rest;
  Hexes hexes;
  std::vector<int> materials;         // of every element
  SecantTables tables;                // of every material
  std::vector<double> matrix_weight;  // k_e of L = sum_e k_e K_e, of every element
  std::array<DofMap, 3> maps;         // of every axis
  std::vector<Cable> cables;
  std::vector<OgdenMaterial> ogden;  // of every material, for the rigorous law
  Surroundings surroundings;
  std::vector<std::int32_t> sections;  // of every node, where there are sections; empty: counted from the support
};

// One cable's drive. By length: `target` is the shortening of the cable since rest [length]; by tension: at the
// actuator [N].
struct CableDrive {
  bool by_length = false;
  double target = 0.0;
};

struct Task {
  Nodes prescribed;                              // (n, 3) displacement of prescribed unknowns; others are not read
  Nodes load;                                    // (n, 3) dead forces [N]
  std::vector<CableDrive> drives;                // one per cable
  std::vector<double> pressures;                 // one per pressed surface [N / length^2]
  std::vector<Eigen::Vector3d> follower_forces;  // one per patch [N], as at rest
  std::vector<Eigen::Vector3d> motions, motions_before;  // of obstacles: in this solve, and where slip counts from
  Nodes before;                                          // (n, 3) displacement that slip counts from
  double tolerance = 1e-6;                               // out-of-balance force relative to reactions
  double force_floor = 0.0;                              // reactions and loads below this count as this [N]
  double length_tolerance = 1e-6;                        // of driven cable lengths, and of contact gaps [length]
  int max_iterations = 2000;
};

struct Outcome {
  bool converged = false;
  int iterations = 0;
  double residual = 0.0;                     // out-of-balance force relative to reactions
  double length_error = 0.0;                 // largest of the driven cables and of the contact gaps [length]
  Nodes displacement;                        // (n, 3)
  Nodes reaction;                            // (n, 3) force that holds each prescribed unknown [N]; zero elsewhere
  std::vector<double> strain;                // eps_eq per element, nu = 0.5
  std::vector<double> anchor_tension;        // per cable
  std::vector<std::vector<double>> tension;  // per cable, actuator to anchor
  std::vector<double> shortening;            // per cable
  std::vector<Touch> touches;
  std::vector<double> history;  // residual of every iteration
  int unstable_modes = -1;      // of an equilibrium: independent motions that lower the energy; -1 = not known
};

}  // namespace softgrip::gdfe
