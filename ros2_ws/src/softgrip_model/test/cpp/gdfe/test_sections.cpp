// SPDX-License-Identifier: Apache-2.0
// Sections on a mesh of random springs: their tangent, its solves and what they leave, against dense matrices.
#include <gtest/gtest.h>

#include <numeric>

#include "meshes.hpp"
#include "softgrip/gdfe/sections.hpp"

namespace softgrip::gdfe {
namespace {

// A bar of 5 x 1 x 1 elements held at x = 0: sections 0..4 at x = 1..5, nodes 4 .. 23 free, unknown u is node u + 4.
class SectionsOfABar : public ::testing::Test {
 protected:
  static constexpr Eigen::Index kHeld = 4, kFree = 20, kSections = 5;

  SectionsOfABar() : block_(testing::make_block({5, 1, 1}, Eigen::Vector3d::Ones())) {
    std::vector<std::int32_t> node_of(kFree);
    std::iota(node_of.begin(), node_of.end(), kHeld);
    sections_ = std::make_unique<Sections>(block_.hexes, static_cast<std::size_t>(block_.rest.rows()), node_of);
    // symmetric positive definite, of element matrices: only nodes of one element meet
    stiffness_ = Eigen::MatrixXd::Zero(3 * kFree, 3 * kFree);
    for (Eigen::Index e = 0; e < block_.hexes.rows(); ++e) {
      const Eigen::MatrixXd half = Eigen::MatrixXd::Random(24, 24);
      const Eigen::MatrixXd own = half * half.transpose() + Eigen::MatrixXd::Identity(24, 24);
      for (int a = 0; a < 24; ++a) {
        for (int b = 0; b < 24; ++b) {
          const Eigen::Index row = unknown(block_.hexes(e, a / 3), a % 3),
                             column = unknown(block_.hexes(e, b / 3), b % 3);
          if (row >= 0 && column >= 0) stiffness_(row, column) += own(a, b);
        }
      }
    }
    // rigid motions of every section about its middle
    motions_ = Eigen::MatrixXd::Zero(3 * kFree, 6 * kSections);
    for (Eigen::Index u = 0; u < kFree; ++u) {
      const Eigen::Index section = u / 4;
      const Eigen::Vector3d arm = block_.rest.row(u + kHeld).transpose() - Eigen::Vector3d(section + 1.0, 0.5, 0.5);
      for (int axis = 0; axis < 3; ++axis) {
        motions_(axis * kFree + u, 6 * section + axis) = 1.0;
        const Eigen::Vector3d turned = Eigen::Vector3d::Unit(axis).cross(arm);
        for (int to = 0; to < 3; ++to) motions_(to * kFree + u, 6 * section + 3 + axis) = turned[to];
      }
    }
  }

  static Eigen::Index unknown(std::int32_t node, int axis) { return node < kHeld ? -1 : axis * kFree + node - kHeld; }

  // Takes the tangent of the springs.
  void measure() {
    const std::vector<double> rest = testing::strided(block_.rest);
    const auto forces = [&](const std::vector<double>& position, std::vector<double>& force) {
      Eigen::VectorXd moved(3 * kFree);
      for (Eigen::Index u = 0; u < kFree; ++u) {
        for (int axis = 0; axis < 3; ++axis) {
          const std::size_t at = kStride * static_cast<std::size_t>(u + kHeld) + static_cast<std::size_t>(axis);
          moved(axis * kFree + u) = position[at] - rest[at];
        }
      }
      const Eigen::VectorXd found = -stiffness_ * moved;
      force.assign(found.data(), found.data() + found.size());
    };
    ASSERT_TRUE(sections_->measure(rest, 1e-3, forces));
  }

  testing::Block block_;
  std::unique_ptr<Sections> sections_;
  Eigen::MatrixXd stiffness_, motions_;
};

TEST_F(SectionsOfABar, AreCountedFromTheSupport) {
  EXPECT_EQ(sections_->count(), static_cast<std::size_t>(kSections));
}

TEST_F(SectionsOfABar, AreThoseThatAreGiven) {
  std::vector<std::int32_t> node_of, section_of(static_cast<std::size_t>(kHeld + kFree), -1);
  for (Eigen::Index u = 0; u < kFree; ++u) {
    node_of.push_back(static_cast<std::int32_t>(u + kHeld));
    section_of[static_cast<std::size_t>(u + kHeld)] =
        static_cast<std::int32_t>(u / 8);  // two layers each, one at the end
  }
  const auto make = [&](const std::vector<std::int32_t>& given) {
    return Sections(block_.hexes, static_cast<std::size_t>(block_.rest.rows()), node_of, given);
  };
  EXPECT_EQ(make(section_of).count(), 3U);
  const auto changed = [&](std::size_t node, std::int32_t section) {
    std::vector<std::int32_t> given = section_of;
    given.at(node) = section;
    return given;
  };
  EXPECT_NO_THROW(make(changed(0, 7)));                       // held: not looked at
  EXPECT_THROW(make(changed(4, 2)), std::invalid_argument);   // meets section 0 in an element
  EXPECT_THROW(make(changed(4, -1)), std::invalid_argument);  // none
  EXPECT_THROW(make(changed(23, 4)), std::invalid_argument);  // section 3 is empty
  EXPECT_THROW(make({section_of.begin(), section_of.end() - 1}), std::invalid_argument);
}

TEST_F(SectionsOfABar, RestrictAndSolveAsTheDenseTangent) {
  measure();
  const Eigen::VectorXd residual = Eigen::VectorXd::Random(3 * kFree);
  const std::vector<double> values(residual.data(), residual.data() + residual.size());
  Eigen::MatrixXd amounts = sections_->restricted(values);
  EXPECT_TRUE(amounts.isApprox(motions_.transpose() * residual, 1e-12));
  const Eigen::MatrixXd tangent = motions_.transpose() * stiffness_ * motions_;
  const Eigen::VectorXd expected = tangent.llt().solve(motions_.transpose() * residual);
  sections_->solve(amounts);
  EXPECT_TRUE(amounts.isApprox(expected, 1e-7));
}

TEST_F(SectionsOfABar, MoveLeavesWhatTheTangentDoesNotAnswer) {
  measure();
  const Eigen::VectorXd amounts = Eigen::VectorXd::Random(6 * kSections), before = Eigen::VectorXd::Random(3 * kFree);
  std::vector<double> motion(3 * kFree), residual(before.data(), before.data() + before.size());
  sections_->move(amounts, motion, residual);
  const Eigen::Map<const Eigen::VectorXd> moved(motion.data(), 3 * kFree), left(residual.data(), 3 * kFree);
  EXPECT_TRUE(moved.isApprox(motions_ * amounts, 1e-12));
  EXPECT_TRUE(left.isApprox(before - stiffness_ * motions_ * amounts, 1e-5));  // the tangent is kept in float
  EXPECT_NEAR(sections_->largest_turn(amounts),
              std::max({amounts.segment<3>(3).norm(), amounts.segment<3>(9).norm(), amounts.segment<3>(15).norm(),
                        amounts.segment<3>(21).norm(), amounts.segment<3>(27).norm()}),
              1e-15);
}

TEST_F(SectionsOfABar, CoupledForcesBelongToTheTangent) {
  measure();
  const Eigen::MatrixXd reach = Eigen::MatrixXd::Random(6 * kSections, 4), half = Eigen::MatrixXd::Random(4, 4);
  const Eigen::MatrixXd coupling = half * half.transpose();
  ASSERT_TRUE(sections_->couple(reach, coupling));
  const Eigen::MatrixXd right = Eigen::MatrixXd::Random(6 * kSections, 2);
  const Eigen::MatrixXd tangent = motions_.transpose() * stiffness_ * motions_ + reach * coupling * reach.transpose();
  Eigen::MatrixXd found = right;
  sections_->solve(found);
  EXPECT_TRUE(found.isApprox(tangent.llt().solve(right), 1e-7));
}

}  // namespace
}  // namespace softgrip::gdfe
