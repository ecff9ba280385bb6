// SPDX-License-Identifier: Apache-2.0
// Equilibrium of a mesh whose global matrix never changes: x <- x - L^-1 g(x), accelerated.
//
// g is the sum of the elements' corner forces less the loads, in newtons; L = sum_e k_e K_e with Dirichlet rows eliminated is
// factored once. Loads and materials act on g only. Converged means: the out-of-balance force on free unknowns is at most
// `tolerance` times the reactions; a small step is no sign of it.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "softgrip/gdfe/anderson.hpp"
#include "softgrip/gdfe/cable.hpp"
#include "softgrip/gdfe/constant_inverse.hpp"
#include "softgrip/gdfe/contact.hpp"
#include "softgrip/gdfe/factor.hpp"
#include "softgrip/gdfe/follower.hpp"
#include "softgrip/gdfe/local_step.hpp"
#include "softgrip/gdfe/mesh.hpp"
#include "softgrip/gdfe/node_rows.hpp"
#include "softgrip/gdfe/ogden.hpp"
#include "softgrip/gdfe/sections.hpp"

namespace softgrip::gdfe {

// What undoes the constant matrix. Automatic: multigrid where an axis has more unknowns than kMultigridAbove.
enum class Method : std::uint8_t { Automatic = 0, Direct = 1, Multigrid = 2 };

inline constexpr int kMultigridAbove = 20000;

struct Settings {
  Law law = Law::Calibrated;
  VolumeShape shape = VolumeShape::Proj;
  Metric metric = Metric::Laplacian;
  bool single_precision_factor = true;
  Ordering ordering = Ordering::Automatic;
  Method method = Method::Automatic;
  int window = 10;           // of the Anderson acceleration; 0 = plain iteration
  int threads = 1;
  double step_limit = 0.0;   // largest motion of a node in one iteration [length]; 0 = none
  int sections_after = -1;   // iterations after which rigid cross-sections are a second level; negative = never
};

// One cable's drive. By length: `target` is the shortening of the cable since rest [length]; by tension: at the actuator [N].
struct CableDrive {
  bool by_length = false;
  double target = 0.0;
};

// What acts on the mesh from outside, beside dead forces and cables.
struct Surroundings {
  std::vector<PressedSurface> pressed;
  std::vector<FollowerPatch> followers;
  std::vector<Obstacle> obstacles;
};

struct Task {
  Nodes prescribed;                // (n, 3) displacement of prescribed unknowns; others are not read
  Nodes load;                      // (n, 3) dead forces [N]
  std::vector<CableDrive> drives;  // one per cable
  std::vector<double> pressures;   // one per pressed surface [N / length^2]
  std::vector<Eigen::Vector3d> follower_forces;          // one per patch [N], as at rest
  std::vector<Eigen::Vector3d> motions, motions_before;  // of obstacles: in this solve, and where slip counts from
  Nodes before;                    // (n, 3) displacement that slip counts from
  double tolerance = 1e-6;         // out-of-balance force relative to reactions
  double force_floor = 0.0;        // reactions and loads below this count as this [N]
  double length_tolerance = 1e-6;  // of driven cable lengths, and of contact gaps [length]
  int max_iterations = 2000;
};

struct Outcome {
  bool converged = false;
  int iterations = 0;
  double residual = 0.0;         // out-of-balance force relative to reactions
  double length_error = 0.0;     // largest of the driven cables [length]
  Nodes displacement;            // (n, 3)
  Nodes reaction;                // (n, 3) force that holds each prescribed unknown [N]; zero elsewhere
  std::vector<double> strain;    // eps_eq per element, nu = 0.5
  std::vector<double> anchor_tension;        // per cable
  std::vector<std::vector<double>> tension;  // per cable, actuator to anchor
  std::vector<double> shortening;            // per cable
  std::vector<Touch> touches;
  std::vector<double> history;   // residual of every iteration
};

// Where an unknown lives: for each axis, node -> group (nodes of one group move alike) or -1 = prescribed.
using DofMap = std::vector<std::int32_t>;

class Solver {
 public:
  Solver(Nodes rest, const Hexes& hexes, const std::vector<int>& materials, SecantTables tables,
         const std::vector<double>& matrix_weight, std::array<DofMap, 3> maps, std::vector<Cable> cables,
         std::vector<OgdenMaterial> ogden, Surroundings surroundings, const Settings& settings);

  // From a start state (displacements and anchor tensions).
  Outcome solve(const Task& task, const Nodes& start, const std::vector<double>& start_tension);

  // Friction acts on forces only: neither the matrix nor the points' compliance knows it.
  void set_friction(std::size_t cable, const friction::Model& friction) { cables_.at(cable).friction = friction; }

  // Strain energy at a state, of the rigorous law.
  double energy(const Nodes& displacement);

  // Corner forces of all elements at a state, and the elements' strains.
  Nodes internal_force(const Nodes& displacement);

  // eps_eq (nu = 0.5) of every element at the state last looked at.
  std::vector<double> strain() const;

  // The thesis law's shape factor and last converged strain of every element.
  void set_thesis_state(const std::vector<double>& omega, const std::vector<double>& last_strain);

  // Of what one step of all elements reads and writes of them.
  std::size_t element_bytes() const { return blocks_.bytes(); }
  const ConstantInverse& inverse(int axis) const { return *axes_[static_cast<std::size_t>(axis)].inverse; }
  std::size_t unknowns() const { return unknowns_; }

 private:
  struct Axis {
    std::shared_ptr<const ConstantInverse> inverse;
    DofMap dof;              // node -> place in the inverse's order, -1 prescribed
    std::size_t offset = 0;  // of its unknowns in the state vector
    std::vector<std::int32_t> first_node, nodes;  // unknown -> its nodes, in compressed rows
    std::vector<std::int32_t> held;               // nodes without an unknown
    std::shared_ptr<const Eigen::MatrixXd> point_columns;  // L^-1 S^T, one column per moving cable point
  };
  struct CableWork {
    std::vector<Eigen::Vector3d> points;
    CableState state;
    double rest_length = 0.0;
    double tension_scale = 1.0;  // of the tension's place in the state vector
  };

  void place(const Nodes& displacement);
  std::size_t begin_of(std::size_t share, std::size_t count) const { return share * count / static_cast<std::size_t>(settings_.threads); }
  template <class Place, class Loads, class Take>
  void sum_forces(const Place& place, const Loads& loads, const Take& take);
  void add_followers(const Task& task);
  void build_contact();
  void begin_contact(const Task& task);
  void build_axes(const std::vector<Element>& elements, const Hexes& hexes, const std::vector<double>& weight,
                  const std::array<DofMap, 3>& maps);
  void build_point_columns();
  void build_shares(const Hexes& hexes);
  std::vector<double> elimination_places(const Hexes& hexes) const;
  void list_nodes(Axis& axis) const;
  void lay_out(const Task& task);
  void expand(const std::vector<double>& state, std::size_t share);
  void pull_cables(const Task& task, const std::vector<double>& state);
  void cable_points(std::size_t index, const double* position, std::vector<Eigen::Vector3d>& points) const;
  CableState unit_pull(const std::vector<double>& state, std::size_t cable) const;
  void gather(std::vector<double>& residual, std::size_t share);
  double out_of_balance(const Task& task, std::vector<double>& residual);
  void precondition(std::vector<double>& residual);
  // Dead loads less the elements' forces on every unknown, at positions [node][kStride] that stay where the solver is.
  void forces_at(const std::vector<double>& position, std::vector<double>& force);
  void build_sections(const Hexes& hexes);
  template <class Take>
  void each_cable_node(std::size_t cable, const Take& take) const;
  bool measure_sections(const Task& task, const std::vector<double>& state);
  Eigen::MatrixXd cable_stiffness(const Task& task, const std::vector<double>& state, std::size_t cable, double step) const;
  std::vector<double> answer_of_sections(const Task& task, const std::vector<double>& state, std::vector<double>& residual);
  void answer(const Task& task, const std::vector<double>& state, int iteration, std::vector<double>& residual);
  void drive_lengths(const Task& task, const std::vector<double>& state, std::vector<double>& residual);
  Outcome report(const Task& task, const std::vector<double>& state) const;

  std::size_t nodes_;
  Nodes rest_;
  Settings settings_;
  SecantTables tables_;
  ElementBlocks blocks_;
  std::unique_ptr<OgdenElements> ogden_;  // of the rigorous law
  std::vector<double> ogden_strain_;
  std::array<Axis, 3> axes_;
  bool alike_ = false;        // an unknown is a node, the same on every axis
  std::size_t unknowns_ = 0;  // of the mesh; cables' anchor tensions follow in the state vector
  std::vector<Cable> cables_;
  std::vector<CableWork> cable_work_;
  std::vector<std::size_t> first_column_;  // per cable: column of its first point in point_columns
  Surroundings surroundings_;
  Contact contact_;
  std::unique_ptr<Sections> sections_;
  bool by_sections_ = false;       // they have a tangent
  int measure_at_ = 0;             // iteration from which on they get another
  Eigen::MatrixXd point_reach_, point_stiffness_;  // of cable points, three columns each: Z^T W; how forces on them fall as they move
  double follower_squared_ = 0.0;  // of their forces
  double balance_scale_ = 1.0;     // reactions and loads that the residual is measured against
  std::vector<double> position_, force_, follower_;  // [node][kStride]
  std::vector<double> scratch_;
  std::vector<double> base_, dead_load_;  // of the task: rest plus prescribed displacements, and loads, [node][kStride]
  double dead_load_squared_ = 0.0;
  std::unique_ptr<Anderson> accelerate_;
  std::vector<double> shares_;  // forces of every thread but the first, whose are in force_, [thread][node][kStride]
  std::vector<ForceShare> force_shares_;  // per thread
  std::vector<double> free_squared_;  // per thread: of the out-of-balance force on its unknowns
  double weight_scale_ = 1.0;
};

}  // namespace softgrip::gdfe
