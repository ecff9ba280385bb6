// SPDX-License-Identifier: Apache-2.0
// g(x): corner forces of all elements less the forces of cables, of loads that follow the body, and dead loads.
//
// Threads share nodes, elements and unknowns equally; every thread sums its elements' forces by itself, and the sums
// are added in the threads' order: bits depend on the number of threads, not on their timing.
#pragma once

#include <memory>
#include <vector>

#include "softgrip/gdfe/cable_system.hpp"
#include "softgrip/gdfe/node_rows.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

class ForceAssembly {
 public:
  ForceAssembly(const Problem& problem, const std::vector<Element>& elements, const Unknowns& unknowns,
                CableSystem& cables, const Settings& settings);

  // Places the prescribed unknowns and takes the dead loads.
  void set_task(const Task& task);

  // residual = -g(x), zero for the cables' tensions; positions and forces of all nodes at x.
  void compute_residual(const Task& task, const std::vector<double>& x, std::vector<double>& residual);

  // The same of dead loads and elements only, at positions [node][kStride] that are copied.
  void compute_element_residual(const std::vector<double>& position, std::vector<double>& residual);

  // Of the last residual: |g| on the mesh's unknowns, and the reactions or loads that it is measured against.
  double out_of_balance() const;
  double load_scale(const Task& task) const;

  const std::vector<double>& position() const { return position_; }  // [node][kStride]

  // The rigorous law only: of one element at the positions of the last forces.
  ElementTangent element_tangent(std::size_t element) const { return ogden_->tangent(position_.data(), element); }

  void report(const Task& task, Outcome& outcome) const;

  // Corner forces of all elements at a displacement, (n, 3).
  Nodes internal_force(const Nodes& displacement);

  // Strain energy at a displacement; the rigorous law only.
  double energy(const Nodes& displacement);

  // eps_eq (nu = 0.5) of every element at the last positions.
  std::vector<double> strain() const;

  void set_thesis_state(const std::vector<double>& omega, const std::vector<double>& last_strain);

  // Of what one step of all elements reads and writes of them.
  std::size_t element_bytes() const { return blocks_.bytes(); }

 private:
  void share_nodes(const Hexes& hexes);
  void place_nodes(const Nodes& displacement);
  void scatter_state(const std::vector<double>& x, std::size_t share);
  void gather_residual(std::vector<double>& residual, std::size_t share);
  void subtract_followers(const Task& task);
  void add_element_forces(std::size_t share);
  template <class Place, class Loads, class Gather>
  void assemble(const Place& place, const Loads& loads, const Gather& gather);
  double total_force_at(std::size_t node, std::size_t axis) const {
    return total_force(force_shares_, node, kStride * node + axis);
  }
  std::size_t begin_of(std::size_t share, std::size_t count) const { return share_begin(share, threads_, count); }

  const Nodes rest_;
  const Unknowns& unknowns_;
  CableSystem& cables_;
  const Surroundings surroundings_;
  const Law law_;
  const VolumeShape shape_;
  const std::size_t nodes_, threads_;
  const SecantTables tables_;
  ElementBlocks blocks_;
  std::unique_ptr<OgdenElements> ogden_;  // of the rigorous law
  std::vector<double> ogden_strain_;
  double weight_scale_ = 1.0;                        // of the constant matrix: below 1e-12 of it all forces are none
  std::vector<double> base_, dead_load_;             // rest plus prescribed displacements, and loads, [node][kStride]
  std::vector<double> position_, force_, follower_;  // [node][kStride]
  double dead_load_squared_ = 0.0, follower_squared_ = 0.0;
  std::vector<double> shares_;  // forces of every thread but the first, whose are in force_, [thread][node][kStride]
  std::vector<ForceShare> force_shares_;  // per thread
  std::vector<double> free_squared_;      // per thread: of the out-of-balance force on its unknowns
};

}  // namespace softgrip::gdfe
