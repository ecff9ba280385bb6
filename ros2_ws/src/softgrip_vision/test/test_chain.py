# SPDX-License-Identifier: Apache-2.0
"""The chain: geometry against closed forms and finite differences, the filter against what it must conclude."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from softgrip_vision.chain import (
    MOUNT_DRIFT,
    SPEED_STDDEV,
    SPEED_TIME,
    ChainFilter,
    ChainGeometry,
    inverse2,
    largest_eigenvalue,
    mahalanobis2,
)
from softgrip_vision.layout import ChainLayout

GEOMETRY = ChainGeometry(ChainLayout((0.045, 0.027, 0.023)), 0.020)
angles = st.lists(st.floats(-0.3, 1.6), min_size=3, max_size=3).map(np.array)


def state_of(q: np.ndarray, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return np.concatenate([mount, q, np.zeros(3)])


def test_straight_finger_lies_on_x() -> None:
    points = GEOMETRY.markers(state_of(np.zeros(3)))
    assert points == pytest.approx(np.array([[-0.02, 0], [0, 0], [0.045, 0], [0.072, 0], [0.095, 0]]))


def test_right_angle_at_the_first_joint_closes_towards_minus_y() -> None:
    points = GEOMETRY.markers(state_of(np.array([math.pi / 2, 0.0, 0.0])))
    assert points[-1] == pytest.approx([0.0, -0.095], abs=1e-15)


@given(q=angles)
def test_angles_are_the_inverse_of_markers(q: np.ndarray) -> None:
    mount = (1e-3, -2e-3, 0.05)
    assert GEOMETRY.angles(GEOMETRY.markers(state_of(q, mount))) == pytest.approx(q, abs=1e-12)


@given(q=angles)
def test_jacobian_is_the_derivative(q: np.ndarray) -> None:
    state, step = state_of(q, (1e-3, -2e-3, 0.05)), 1e-6
    points = GEOMETRY.markers(state)
    for marker in range(5):
        jacobian = GEOMETRY.jacobian(points, marker, len(state))
        for column in range(len(state)):
            shift = np.zeros(len(state))
            shift[column] = step
            difference = (GEOMETRY.markers(state + shift) - GEOMETRY.markers(state - shift))[marker] / (2 * step)
            assert jacobian[:, column] == pytest.approx(difference, abs=1e-8)


def test_the_filter_finds_angles_and_a_shifted_mount() -> None:
    truth = state_of(np.array([0.4, 0.5, 0.3]), (1e-3, -5e-4, 0.02))
    points = GEOMETRY.markers(truth)
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    for _ in range(20):
        chain.predict(1 / 30)
        for marker, point in enumerate(points):
            chain.update(marker, point, np.eye(2) * (2e-5) ** 2)
    assert chain.angles()[0] == pytest.approx(truth[3:6], abs=2e-3)
    assert chain.state[:3] == pytest.approx(truth[:3], abs=2e-4)


def test_a_hidden_joint_follows_from_its_neighbours() -> None:
    """The link lengths and the marker beyond leave a bent chain no freedom."""
    truth = state_of(np.array([0.5, 0.6, 0.4]))
    points = GEOMETRY.markers(truth)
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    for frame in range(10):
        chain.predict(1 / 30)
        for marker, point in enumerate(points):
            if frame < 5 or marker != 3:
                chain.update(marker, point, np.eye(2) * (2e-5) ** 2)
    expected, spread = chain.expect(3)
    assert math.dist(expected, points[3]) < 1e-4
    assert math.sqrt(np.trace(spread)) < 1e-3


def test_a_hidden_tip_makes_the_last_joint_uncertain_and_only_that() -> None:
    points = GEOMETRY.markers(state_of(np.array([0.5, 0.6, 0.4])))
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    for frame in range(15):
        chain.predict(1 / 30)
        for marker, point in enumerate(points):
            if frame < 5 or marker != 4:
                chain.update(marker, point, np.eye(2) * (2e-5) ** 2)
    _, stddev = chain.angles()
    assert stddev[2] > math.radians(5.0)
    assert stddev[:2].max() < math.radians(0.5)


def test_the_tip_is_given_from_the_mount_not_from_where_the_camera_has_it() -> None:
    """A mount that stands a millimetre off and two degrees askew moves no tip; its spread is that of drawn angles."""
    q = np.array([0.6, 0.4, 0.3])
    chain = ChainFilter(GEOMETRY)
    chain.state = state_of(q, (1e-3, -5e-4, 0.035))
    random = np.random.default_rng(2)
    root = random.normal(size=(9, 9)) * 1e-3
    chain.covariance = root @ root.T
    headings = -np.cumsum(q)
    lengths = np.array(GEOMETRY.layout.link_lengths_m)
    tip, stddev = chain.tip()
    assert tip == pytest.approx([lengths @ np.cos(headings), lengths @ np.sin(headings)], abs=1e-15)
    drawn = q + random.multivariate_normal(np.zeros(9), chain.covariance, size=20_000)[:, 3:6]
    turned = -np.cumsum(drawn, axis=1)
    spread = np.stack([np.cos(turned) @ lengths, np.sin(turned) @ lengths], axis=1).std(axis=0)
    assert stddev == pytest.approx(spread, rel=0.03)


def test_what_is_worked_out_once_is_that_of_the_present_state() -> None:
    """Update and settling put other angles in: what is expected afterwards follows them."""
    chain = ChainFilter(GEOMETRY)
    chain.state = state_of(np.array([0.2, -0.1, 0.1]))
    chain.expect(3)
    chain.settle_hidden([False, False, True, False, False])
    assert chain.expect(3)[0] == pytest.approx(GEOMETRY.markers(chain.state)[3], abs=0.0)
    chain.update(3, chain.expect(3)[0] + 1e-3, 1e-8 * np.eye(2))
    assert chain.expect(3)[0] == pytest.approx(GEOMETRY.markers(chain.state)[3], abs=0.0)
    chain.place(GEOMETRY.markers(state_of(np.array([0.5, 0.5, 0.5]))))
    assert chain.expect(3)[0] == pytest.approx(GEOMETRY.markers(chain.state)[3], abs=0.0)


def test_covariance_stays_a_covariance() -> None:
    random = np.random.default_rng(3)
    points = GEOMETRY.markers(state_of(np.array([0.5, 0.6, 0.4])))
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    for _ in range(200):
        chain.predict(float(random.uniform(0.005, 0.1)))
        for marker in random.permutation(5)[: random.integers(0, 6)]:
            noisy = points[marker] + random.normal(0, 2e-5, 2)
            chain.update(int(marker), noisy, np.eye(2) * (2e-5) ** 2)
        assert np.linalg.eigvalsh(chain.covariance).min() > -1e-12


def test_process_noise_is_the_exact_integral() -> None:
    """Two half steps predict what one whole step does (the model is linear and exact)."""
    once, twice = ChainFilter(GEOMETRY), ChainFilter(GEOMETRY)
    for chain in (once, twice):
        chain.state[6:] = (1.0, -2.0, 0.5)
    once.predict(0.2)
    twice.predict(0.1)
    twice.predict(0.1)
    assert twice.state == pytest.approx(once.state)
    assert twice.covariance == pytest.approx(once.covariance)


def test_a_hidden_joint_is_not_bent_backwards() -> None:
    points = GEOMETRY.markers(state_of(np.array([0.5, 0.4, 0.3])))
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    chord, offset = points[4] - points[2], points[3] - points[2]
    mirrored = points.copy()
    mirrored[3] = points[2] + 2 * chord * (offset @ chord) / (chord @ chord) - offset
    chain.state[3:6] = GEOMETRY.angles(mirrored)
    assert chain.state[5] < 0
    unknown = chain.settle_hidden([False, False, False, True, False])
    assert GEOMETRY.markers(chain.state) == pytest.approx(points)
    assert unknown == pytest.approx(np.zeros(3))


def test_what_hidden_joints_leave_unknown() -> None:
    chain = ChainFilter(GEOMETRY)
    chain.place(GEOMETRY.markers(state_of(np.array([0.5, 0.02, 0.3]))))
    assert chain.settle_hidden([True, True, False, False, True]) == pytest.approx(np.zeros(3))
    assert chain.settle_hidden([False, False, True, False, False]) == pytest.approx(np.full(3, 0.02))
    assert chain.settle_hidden([False, False, True, True, False]).min() > 3.0


def test_inverse2() -> None:
    matrix = np.array([[3.0, 1.0], [-2.0, 5.0]])
    assert inverse2(matrix) @ matrix == pytest.approx(np.eye(2))


def test_closed_forms_of_two_by_two_matrices() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        root = random.normal(size=(2, 2))
        covariance, miss = root @ root.T + 0.01 * np.eye(2), random.normal(size=2)
        assert largest_eigenvalue(covariance) == pytest.approx(np.linalg.eigvalsh(covariance)[-1], rel=1e-10)
        assert mahalanobis2(miss, covariance) == pytest.approx(miss @ np.linalg.solve(covariance, miss), rel=1e-8)


def test_prediction_is_the_exact_solution_of_the_motion_model() -> None:
    """Van Loan's matrix exponential of dx = A x dt + noise, for a joint's speed that forgets within SPEED_TIME."""
    random = np.random.default_rng(5)
    chain = ChainFilter(GEOMETRY)
    root = random.normal(size=(9, 9))
    state, covariance, seconds = random.normal(size=9), root @ root.T, 0.04
    chain.state, chain.covariance = state.copy(), covariance.copy()
    drift, density = np.zeros((9, 9)), np.zeros((9, 9))
    drift[3:6, 6:], drift[6:, 6:] = np.eye(3), -np.eye(3) / SPEED_TIME
    density[:3, :3] = np.diag(np.square(MOUNT_DRIFT))
    density[6:, 6:] = np.eye(3) * 2.0 * SPEED_STDDEV**2 / SPEED_TIME
    block = expm(np.block([[-drift, density], [np.zeros((9, 9)), drift.T]]) * seconds)
    transition = block[9:, 9:].T
    chain.predict(seconds)
    assert chain.state == pytest.approx(transition @ state, rel=1e-9)
    assert chain.covariance == pytest.approx(
        transition @ covariance @ transition.T + transition @ block[:9, 9:], rel=1e-9, abs=1e-12
    )
