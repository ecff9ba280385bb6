// SPDX-License-Identifier: Apache-2.0
// All cables in the iteration: the forces they put on the mesh, and the tension that brings a driven one to its length.
//
// A cable driven by length has its anchor tension among the unknowns. One step of it is a Schur complement on the
// constant matrix, or on what stands in for it: with d = the direction of its pull and s = d length / d x, tension
// changes by (missing length - s . dx) / (s . L^-1 d). The columns L^-1 S^T of the points that a cable runs through are
// solved for once.
#pragma once

#include <Eigen/SparseCore>
#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "softgrip/gdfe/preconditioner.hpp"
#include "softgrip/gdfe/problem.hpp"

namespace softgrip::gdfe {

// How the mesh's unknowns answer forces on a cable's points, one column each.
using PointAnswer = std::function<Eigen::VectorXd(std::size_t cable, const Eigen::Matrix3Xd& force)>;

class CableSystem {
 public:
  CableSystem(std::vector<Cable> cables, const Nodes& rest, Preconditioner& preconditioner);

  std::size_t count() const { return cables_.size(); }

  // Friction acts on forces only: neither the matrix nor the points' compliance depends on it.
  void set_friction(std::size_t cable, const friction::Model& friction) { cables_.at(cable).friction = friction; }

  // Writes the tensions that an iteration starts from into the state.
  void set_tensions(const std::vector<double>& anchor_tension, std::vector<double>& x);

  // force[node][kStride] -= what the cables put on the nodes, at positions [node][kStride].
  void subtract_forces(const Task& task, const std::vector<double>& x, const double* position, double* force);

  // The last forces: whether the friction laws have values, squares added to `sum`, largest error of a driven length.
  bool are_sound() const;
  double add_force_squares(double sum) const;
  double length_error(const Task& task, const std::vector<double>& x) const;

  // Adds to the step what brings every driven cable to its length, and the tension that does it.
  void drive_lengths(const Task& task, const std::vector<double>& x, std::vector<double>& step,
                     const PointAnswer& answer) const;

  // The constant matrix's.
  Eigen::VectorXd answer_of_constant(std::size_t cable, const Eigen::Matrix3Xd& force) const;

  // A cable only pulls: tensions below zero become zero, in the step that led there as well.
  void clip_tensions(std::vector<double>& x, std::vector<double>& step) const;

  void report(const Task& task, const std::vector<double>& x, Outcome& outcome) const;

  // For a second level, and for the tangent.

  // Points of the cables before this one, and of all cables.
  std::size_t first_point(std::size_t cable) const { return first_point_[cable]; }
  std::size_t points() const { return first_point_.back(); }
  double tension(const std::vector<double>& x, std::size_t cable) const;
  double tension_scale(std::size_t cable) const { return states_[cable].tension_scale; }

  // What is missing to the target of a driven length.
  double missing_length(const Task& task, std::size_t cable) const;

  // Forces at a unit tension at the anchor; a slack cable has its direction at the friction law's floor.
  CableState unit_forces(const std::vector<double>& x, std::size_t cable) const;

  // How the forces on a cable's points fall as these move, at its present tension; by differences.
  Eigen::MatrixXd stiffness(const Task& task, const std::vector<double>& x, std::size_t cable) const;

  // Unknowns of the mesh, three columns a point: what a unit force on each puts on them.
  Eigen::SparseMatrix<double> point_reach() const;

  // visit(unknown, point, weight) for every free node that a cable's points hang on, where axes have a shared dof map.
  template <class Visit>
  void for_each_free_node(std::size_t cable, const Visit& visit) const {
    for (std::size_t p = 0; p < cables_[cable].points.size(); ++p) {
      const CablePoint& point = cables_[cable].points[p];
      for (std::size_t k = 0; k < point.nodes.size(); ++k) {
        const std::int32_t dof = unknowns_.axes[0].dof[static_cast<std::size_t>(point.nodes[k])];
        if (dof >= 0) visit(static_cast<std::size_t>(dof), p, point.weights[k]);
      }
    }
  }

 private:
  struct IterationState {
    std::vector<Eigen::Vector3d> points;
    CableState forces;
    double rest_length = 0.0;
    double tension_scale = 1.0;  // of the tension's entry in the state
  };

  // visit(unknown, axis, point, weight) for every unknown that a cable's points hang on.
  template <class Visit>
  void for_each_unknown(std::size_t cable, const Visit& visit) const {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const AxisUnknowns& a = unknowns_.axes[axis];
      for (std::size_t p = 0; p < cables_[cable].points.size(); ++p) {
        const CablePoint& point = cables_[cable].points[p];
        for (std::size_t k = 0; k < point.nodes.size(); ++k) {
          const std::int32_t dof = a.dof[static_cast<std::size_t>(point.nodes[k])];
          if (dof >= 0) visit(a.offset + static_cast<std::size_t>(dof), axis, p, point.weights[k]);
        }
      }
    }
  }

  void solve_point_columns(Preconditioner& preconditioner);
  void measure_rest_lengths(const Nodes& rest);
  void locate_points(std::size_t cable, const double* position, std::vector<Eigen::Vector3d>& points) const;
  CableState forces_at(const Task& task, const std::vector<double>& x, std::size_t cable,
                       const std::vector<Eigen::Vector3d>& points) const;

  std::vector<Cable> cables_;
  const Unknowns& unknowns_;
  const double difference_;  // step of the differences [length]
  std::vector<IterationState> states_;
  std::vector<std::size_t> first_point_;                                 // per cable, and of all behind the last
  std::array<std::shared_ptr<const Eigen::MatrixXd>, 3> point_columns_;  // per axis: L^-1 S^T, one column per point
};

}  // namespace softgrip::gdfe
