// SPDX-License-Identifier: Apache-2.0
// The second level of an iteration: rigid motions of the cross-sections, and tensions of driven cables, that answer an
// out-of-balance force before the constant matrix does (sections.hpp).
#pragma once

#include "softgrip/gdfe/cable_system.hpp"
#include "softgrip/gdfe/force_assembly.hpp"
#include "softgrip/gdfe/sections.hpp"

namespace softgrip::gdfe {

class SectionLevel {
 public:
  SectionLevel(const Problem& problem, const Unknowns& unknowns, ForceAssembly& forces, CableSystem& cables,
               int first_iteration);

  // A solve begins: no tangent yet.
  void restart();

  // Whether another tangent is due in iteration k, and measures it at the positions of the last forces.
  bool is_update_due(int k) const { return k >= next_update_; }
  void update_tangent(const Task& task, const std::vector<double>& x, int k);

  // Returns the motion Z a and the cables' changes of tension; residual <- what they leave for the constant matrix.
  // Empty where the tangent is singular.
  std::vector<double> correct(const Task& task, const std::vector<double>& x, std::vector<double>& residual);

 private:
  // Motions of the sections, and changes of the cables' tensions in force.
  struct Answer {
    Eigen::VectorXd amounts, tensions;
  };

  bool measure_tangent(const Task& task, const std::vector<double>& x);
  Answer solve_motions(const Task& task, const std::vector<double>& x, const std::vector<double>& residual,
                       const std::vector<CableState>& unit_forces) const;
  void limit_turn(Answer& answer);
  void subtract_point_forces(std::size_t cable, const Eigen::VectorXd& force, std::vector<double>& residual) const;

  const Unknowns& unknowns_;
  ForceAssembly& forces_;
  CableSystem& cables_;
  Sections sections_;
  const int first_iteration_;
  const double difference_;  // step of the differences [length]
  int next_update_ = 0;
  bool has_tangent_ = false;
  Eigen::MatrixXd point_reach_,
      point_stiffness_;  // of cable points, three columns each: Z^T W; how forces on them fall
};

}  // namespace softgrip::gdfe
