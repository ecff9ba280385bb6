// SPDX-License-Identifier: Apache-2.0
// Equilibrium of a mesh whose global matrix never changes: x <- x - L^-1 g(x), accelerated.
//
// g is the sum of the elements' corner forces less the loads, in newtons; L = sum_e k_e K_e with Dirichlet rows
// eliminated is factored once. Loads and materials act on g only. Converged means: the out-of-balance force on free
// unknowns is at most `tolerance` times the reactions; a small step is no sign of it.
#pragma once

#include <memory>
#include <vector>

#include "softgrip/gdfe/anderson.hpp"
#include "softgrip/gdfe/cable_system.hpp"
#include "softgrip/gdfe/contact.hpp"
#include "softgrip/gdfe/force_assembly.hpp"
#include "softgrip/gdfe/preconditioner.hpp"
#include "softgrip/gdfe/problem.hpp"
#include "softgrip/gdfe/section_level.hpp"
#include "softgrip/gdfe/tangent.hpp"

namespace softgrip::gdfe {

class Solver {
 public:
  // Throws std::invalid_argument for settings that the problem does not allow, std::runtime_error where the constant
  // matrix turns out not to be positive definite. Rounding may hide that: whether the mesh is held is for the caller to
  // check.
  Solver(const Problem& problem, const Settings& settings);

  // From a start state: displacements (n, 3), and a tension at the anchor of every cable.
  Outcome solve(const Task& task, const Nodes& start, const std::vector<double>& start_tension);

  CableSystem& cables() { return cables_; }
  ForceAssembly& forces() { return forces_; }
  const ForceAssembly& forces() const { return forces_; }
  const Preconditioner& preconditioner() const { return preconditioner_; }

 private:
  // How far a state is from equilibrium.
  struct Balance {
    double residual = 0.0;      // |g| relative to what it is measured against
    double scale = 0.0;         // that: reactions or loads [N]
    double length_error = 0.0;  // of driven cables and contact gaps [length]
    bool is_sound = true;       // no element is turned inside out, no cable wrapped too far

    bool is_converged(const Task& task) const {
      return is_sound && residual <= task.tolerance && length_error <= task.length_tolerance;
    }
  };

  Solver(const Problem& problem, const Settings& settings, const std::vector<Element>& elements);

  std::vector<double> start_solve(const Task& task, const Nodes& start, const std::vector<double>& start_tension);
  Balance measure_balance(const Task& task, const std::vector<double>& x) const;
  void resolve_contact(const Task& task, const std::vector<double>& x, int k, std::vector<double>& z, Balance& balance);
  void compute_step(const Task& task, const std::vector<double>& x, int k, std::vector<double>& z);
  void accelerate(std::vector<double>& x, const std::vector<double>& z, std::vector<double>& dx);
  void back_track(std::vector<double>& x, std::vector<double>& dx, double share);
  void report(const Task& task, const std::vector<double>& x, Outcome& outcome) const;

  const Settings settings_;
  Preconditioner preconditioner_;
  CableSystem cables_;
  ForceAssembly forces_;
  std::unique_ptr<Contact> contact_;        // where there are obstacles
  std::unique_ptr<SectionLevel> sections_;  // where they are asked for
  std::unique_ptr<Tangent> tangent_;        // of the rigorous law, where it is fit
  Anderson anderson_;
};

}  // namespace softgrip::gdfe
