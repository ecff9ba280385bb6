// SPDX-License-Identifier: Apache-2.0
// What a solver makes once: elements, the constant matrix of every axis and what undoes it, columns of cables, contact.
#include <algorithm>
#include <cmath>
#include <exception>

#include "softgrip/gdfe/multigrid.hpp"
#include "softgrip/gdfe/solver.hpp"
#include "src/gdfe/assembly.hpp"

namespace softgrip::gdfe {
namespace {

std::vector<Element> make_elements(const Nodes& rest, const Hexes& hexes, const Settings& settings) {
  std::vector<Element> elements(static_cast<std::size_t>(hexes.rows()));
#pragma omp parallel for num_threads(settings.threads) if (settings.threads > 1)
  for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
    elements[static_cast<std::size_t>(e)] = make_element(corners_of(rest, hexes, e), settings.metric);
  }
  return elements;
}

// Mean place at rest of the nodes of every unknown.
Eigen::MatrixX3d places_of(const DofMap& map, const Nodes& rest, Eigen::Index size) {
  Eigen::MatrixX3d places = Eigen::MatrixX3d::Zero(size, 3);
  Eigen::VectorXd members = Eigen::VectorXd::Zero(size);
  for (std::size_t i = 0; i < map.size(); ++i) {
    if (map[i] < 0) continue;
    places.row(map[i]) += rest.row(static_cast<Eigen::Index>(i));
    members(map[i]) += 1.0;
  }
  return members.cwiseInverse().asDiagonal() * places;
}

std::shared_ptr<const ConstantInverse> make_inverse(const SparseMatrix& matrix, const DofMap& map, const Nodes& rest,
                                                    const Settings& settings) {
  const bool large = settings.method == Method::Automatic && matrix.rows() > kMultigridAbove;
  if (settings.method == Method::Multigrid || large) {
    return std::make_shared<Multigrid>(matrix, places_of(map, rest, matrix.rows()), settings.single_precision_factor,
                                       settings.threads);
  }
  return std::make_shared<Factor>(matrix, settings.single_precision_factor, settings.ordering, settings.threads);
}

}  // namespace

Solver::Solver(Nodes rest, const Hexes& hexes, const std::vector<int>& materials, SecantTables tables,
               const std::vector<double>& matrix_weight, std::array<DofMap, 3> maps, std::vector<Cable> cables,
               std::vector<OgdenMaterial> ogden, Surroundings surroundings, const Settings& settings)
    : nodes_(static_cast<std::size_t>(rest.rows())),
      rest_(std::move(rest)),
      settings_(settings),
      tables_(std::move(tables)),
      cables_(std::move(cables)),
      cable_work_(cables_.size()),
      surroundings_(std::move(surroundings)) {
  const std::vector<Element> elements = make_elements(rest_, hexes, settings);
  for (std::size_t e = 0; e < elements.size(); ++e) weight_scale_ += matrix_weight[e] * std::cbrt(elements[e].volume);
  build_axes(elements, hexes, matrix_weight, maps);
  blocks_ = ElementBlocks(elements, hexes, materials, tables_.lame_per_mu, elimination_places(hexes));
  if (settings_.law == Law::Rigorous) {
    ogden_ = std::make_unique<OgdenElements>(rest_, hexes, materials, std::move(ogden));
    ogden_strain_.resize(elements.size());
  }
  position_.resize(kStride * nodes_);
  force_.resize(kStride * nodes_);
  build_shares(hexes);
  build_point_columns();
  build_contact();
  build_sections(hexes);
  std::vector<std::size_t> parts;
  for (const Axis& axis : axes_) parts.push_back(static_cast<std::size_t>(axis.inverse->size()));
  parts.push_back(cables_.size());
  accelerate_ = std::make_unique<Anderson>(std::move(parts), settings_.window, settings_.threads);
}

// Where the inverse's order has the nodes of an element, on average: threads that share elements and unknowns in that order have
// most of what they read from their own cache.
std::vector<double> Solver::elimination_places(const Hexes& hexes) const {
  std::vector<double> places(static_cast<std::size_t>(hexes.rows()), 0.0);
  for (Eigen::Index e = 0; e < hexes.rows(); ++e) {
    double sum = 0.0, count = 0.0;
    for (int c = 0; c < 8; ++c) {
      const std::int32_t dof = axes_[0].dof[static_cast<std::size_t>(hexes(e, c))];
      if (dof >= 0) sum += dof, count += 1.0;
    }
    if (count > 0.0) places[static_cast<std::size_t>(e)] = sum / count;
  }
  return places;
}

// The nodes that every thread's elements reach: the rest of its forces is never touched. The first one has loads too, anywhere.
void Solver::build_shares(const Hexes& hexes) {
  const auto threads = static_cast<std::size_t>(settings_.threads);
  shares_.resize(kStride * nodes_ * (threads - 1));
  free_squared_.assign(threads, 0.0);
  force_shares_.push_back({force_.data(), 0, nodes_});
  for (std::size_t t = 1; t < threads; ++t) {
    std::size_t first = nodes_, last = 0;
    const auto reach = [&](std::int32_t node) {
      first = std::min(first, static_cast<std::size_t>(node));
      last = std::max(last, static_cast<std::size_t>(node) + 1);
    };
    if (ogden_) {
      for (std::size_t e = begin_of(t, blocks_.elements); e < begin_of(t + 1, blocks_.elements); ++e) {
        for (int c = 0; c < 8; ++c) reach(hexes(static_cast<Eigen::Index>(e), c));
      }
    } else {
      for (const auto& [from, to] : block_shares(blocks_, t, threads)) {
        std::for_each(blocks_.corner.data() + from * 8 * kBlock, blocks_.corner.data() + to * 8 * kBlock, reach);
      }
    }
    force_shares_.push_back({shares_.data() + (t - 1) * kStride * nodes_, std::min(first, last), last});
  }
}

void Solver::build_contact() {
  if (surroundings_.obstacles.empty()) return;
  UnknownsView view;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    view.dof[axis] = &axes_[axis].dof;
    view.offset[axis] = axes_[axis].offset;
    view.size[axis] = static_cast<std::size_t>(axes_[axis].inverse->size());
    view.same_as[axis] = axis;
    for (std::size_t earlier = axis; earlier-- > 0;) {
      if (axes_[earlier].inverse == axes_[axis].inverse) view.same_as[axis] = earlier;
    }
  }
  view.apply_inverse = [this](std::size_t axis, double* column) { axes_[axis].inverse->solve(&column, 1, scratch_); };
  contact_ = Contact(surroundings_.obstacles, nodes_, std::move(view));
}

void Solver::build_axes(const std::vector<Element>& elements, const Hexes& hexes, const std::vector<double>& weight,
                        const std::array<DofMap, 3>& maps) {
  std::array<std::size_t, 3> like{};  // the first axis with the same map
  for (std::size_t axis = 0; axis < 3; ++axis) {
    like[axis] = static_cast<std::size_t>(std::find(maps.begin(), maps.end(), maps[axis]) - maps.begin());
  }
  std::exception_ptr failure;  // must not leave the threads' region
#pragma omp parallel for schedule(dynamic) num_threads(settings_.threads) if (settings_.threads > 1 && like != decltype(like){})
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (like[axis] != axis) continue;
    try {
      const DofMap& map = maps[axis];
      const int size = map.empty() ? 0 : std::max(0, *std::max_element(map.begin(), map.end()) + 1);
      axes_[axis].inverse = make_inverse(assembled(elements, hexes, weight, map, size), map, rest_, settings_);
    } catch (...) {
#pragma omp critical
      failure = std::current_exception();
    }
  }
  if (failure) std::rethrow_exception(failure);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const DofMap& map = maps[axis];
    axes_[axis].inverse = axes_[like[axis]].inverse;
    axes_[axis].dof.resize(nodes_);
    for (std::size_t i = 0; i < nodes_; ++i) {
      axes_[axis].dof[i] = map[i] < 0 ? -1 : axes_[axis].inverse->position()[static_cast<std::size_t>(map[i])];
    }
    list_nodes(axes_[axis]);
    axes_[axis].offset = unknowns_;
    unknowns_ += static_cast<std::size_t>(axes_[axis].inverse->size());
  }
  alike_ = std::all_of(axes_.begin(), axes_.end(), [&](const Axis& axis) {
    return axis.inverse == axes_[0].inverse && axis.nodes.size() == static_cast<std::size_t>(axis.inverse->size());
  });
}

void Solver::list_nodes(Axis& axis) const {
  const auto size = static_cast<std::size_t>(axis.inverse->size());
  axis.first_node.assign(size + 1, 0);
  for (const std::int32_t dof : axis.dof) {
    if (dof >= 0) ++axis.first_node[static_cast<std::size_t>(dof) + 1];
  }
  for (std::size_t u = 0; u < size; ++u) axis.first_node[u + 1] += axis.first_node[u];
  std::vector<std::int32_t> next(axis.first_node.begin(), axis.first_node.end() - 1);
  axis.nodes.resize(static_cast<std::size_t>(axis.first_node.back()));
  for (std::size_t i = 0; i < nodes_; ++i) {
    const auto node = static_cast<std::int32_t>(i);
    if (axis.dof[i] >= 0) {
      axis.nodes[static_cast<std::size_t>(next[static_cast<std::size_t>(axis.dof[i])]++)] = node;
    } else {
      axis.held.push_back(node);
    }
  }
}

void Solver::build_point_columns() {
  std::size_t columns = 0;
  for (const Cable& cable : cables_) {
    first_column_.push_back(columns);
    columns += cable.points.size();
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    Axis& a = axes_[axis];
    for (std::size_t earlier = 0; earlier < axis; ++earlier) {
      if (axes_[earlier].inverse == a.inverse) a.point_columns = axes_[earlier].point_columns;
    }
    if (a.point_columns || columns == 0) continue;
    auto matrix = std::make_shared<Eigen::MatrixXd>(Eigen::MatrixXd::Zero(a.inverse->size(), static_cast<Eigen::Index>(columns)));
    for (std::size_t c = 0; c < cables_.size(); ++c) {
      for (std::size_t p = 0; p < cables_[c].points.size(); ++p) {
        const CablePoint& point = cables_[c].points[p];
        auto column = matrix->col(static_cast<Eigen::Index>(first_column_[c] + p));
        for (std::size_t k = 0; k < point.nodes.size(); ++k) {
          const int dof = a.dof[static_cast<std::size_t>(point.nodes[k])];
          if (dof >= 0) column(dof) += point.weights[k];
        }
        double* data = column.data();
        a.inverse->solve(&data, 1, scratch_);
      }
    }
    a.point_columns = matrix;
  }
  std::vector<double> at_rest(kStride * nodes_);
  for (std::size_t i = 0; i < nodes_; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) at_rest[kStride * i + axis] = rest_(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(axis));
  }
  for (std::size_t c = 0; c < cables_.size(); ++c) {
    cable_points(c, at_rest.data(), cable_work_[c].points);
    const CableState state = pull_from_anchor(cables_[c], cable_work_[c].points, 0.0);
    cable_work_[c].rest_length = state.length + state.entry_length;
  }
}

}  // namespace softgrip::gdfe
