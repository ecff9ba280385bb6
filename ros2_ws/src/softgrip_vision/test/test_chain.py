# SPDX-License-Identifier: Apache-2.0
"""The chain: geometry against closed forms and finite differences, the filter against what it must conclude."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import least_squares

from softgrip_vision.chain import (
    MOUNT_DRIFT,
    SPEED_STDDEV,
    SPEED_TIME,
    ChainFilter,
    ChainGeometry,
    Spread,
)
from softgrip_vision.layout import ChainLayout

GEOMETRY = ChainGeometry(ChainLayout((0.045, 0.027, 0.023)), 0.020)
#: [m^2] twenty micrometres
SHARP = Spread(4e-10, 0.0, 4e-10)
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
        jacobian = GEOMETRY.jacobian(points, marker)
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
            chain.update(marker, point, SHARP)
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
                chain.update(marker, point, SHARP)
    expected, spread = chain.expect(3)
    assert math.dist(expected, points[3]) < 1e-4
    assert math.sqrt(spread.xx + spread.yy) < 1e-3


def test_a_hidden_tip_makes_the_last_joint_uncertain_and_only_that() -> None:
    points = GEOMETRY.markers(state_of(np.array([0.5, 0.6, 0.4])))
    chain = ChainFilter(GEOMETRY)
    chain.place(points)
    for frame in range(15):
        chain.predict(1 / 30)
        for marker, point in enumerate(points):
            if frame < 5 or marker != 4:
                chain.update(marker, point, SHARP)
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
    x, y = chain.expect(3)[0]
    chain.update(3, (x + 1e-3, y + 1e-3), Spread(1e-8, 0.0, 1e-8))
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
            chain.update(int(marker), noisy, SHARP)
        assert np.linalg.eigvalsh(chain.covariance).min() > -1e-12


def test_process_noise_is_the_exact_integral() -> None:
    """Two half steps predict what one whole step does (the model is linear and exact)."""
    once, twice = ChainFilter(GEOMETRY), ChainFilter(GEOMETRY)
    for chain in (once, twice):
        chain.state = np.array([0.0] * 6 + [1.0, -2.0, 0.5])
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
    chain.state = state_of(GEOMETRY.angles(mirrored))
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


def test_closed_forms_of_two_by_two_matrices() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        root = random.normal(size=(2, 2))
        covariance, miss = root @ root.T + 0.01 * np.eye(2), random.normal(size=2)
        spread = Spread(covariance[0, 0], covariance[0, 1], covariance[1, 1])
        assert spread.largest == pytest.approx(np.linalg.eigvalsh(covariance)[-1], rel=1e-10)
        assert spread.distance2(*miss) == pytest.approx(miss @ np.linalg.solve(covariance, miss), rel=1e-8)


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


def numeric_jacobian(geometry: ChainGeometry, state: np.ndarray, marker: int) -> np.ndarray:
    """(2, s) central differences."""
    shifts = 1e-6 * np.eye(len(state))
    rows = [geometry.markers(state + shift)[marker] - geometry.markers(state - shift)[marker] for shift in shifts]
    return np.array(rows).T / 2e-6


@pytest.mark.parametrize("lengths", [(0.08,), (0.05, 0.04), (0.03, 0.025, 0.02, 0.02, 0.015, 0.01)])
def test_chains_of_any_length(lengths: tuple[float, ...]) -> None:
    n = len(lengths)
    geometry = ChainGeometry(ChainLayout(lengths), 0.015)
    state = np.concatenate([[1e-3, -2e-3, 0.1], np.linspace(0.2, 0.6, n), np.ones(n)])
    points = geometry.markers(state)
    assert points.shape == (n + 2, 2)
    assert np.hypot(*np.diff(points[1:], axis=0).T) == pytest.approx(lengths)
    for marker in range(n + 2):
        assert geometry.jacobian(points, marker) == pytest.approx(numeric_jacobian(geometry, state, marker), abs=1e-8)
    chain = ChainFilter(geometry)
    chain.place(points)
    assert chain.angles()[0] == pytest.approx(state[3 : 3 + n])
    for marker in range(n + 2):
        chain.update(marker, tuple(points[marker]), SHARP)
        hidden = [index == marker for index in range(n + 2)]
        assert chain.settle_hidden(hidden).shape == (n,)
    assert chain.settle_hidden([True] * (n + 2)) == pytest.approx(np.full(n, math.pi if n > 1 else 0.0))


@pytest.mark.parametrize("marker", range(5))
def test_a_small_surprise_is_taken_in_as_by_the_textbook(marker: int) -> None:
    """One linear Kalman update, with the derivative from finite differences and Joseph's form of the covariance."""
    random = np.random.default_rng(marker)
    root = random.normal(size=(9, 9)) * np.array([1e-3] * 2 + [1e-2] * 4 + [1.0] * 3)[:, None]
    state, covariance = state_of(np.array([0.5, 0.6, 0.4]), (1e-3, -5e-4, 0.02)), root @ root.T
    chain = ChainFilter(GEOMETRY)
    chain.state, chain.covariance = state, covariance
    noise = Spread(4e-8, 1e-8, 9e-8)
    matrix = np.array([[noise.xx, noise.xy], [noise.xy, noise.yy]])
    jacobian = numeric_jacobian(GEOMETRY, state, marker)
    place, spread = chain.expect(marker)
    predicted = jacobian @ covariance @ jacobian.T
    assert [spread.xx, spread.xy, spread.yy] == pytest.approx(predicted[[0, 0, 1], [0, 1, 1]], rel=1e-5)
    surprise = np.array([3e-5, -2e-5])
    chain.update(marker, (place[0] + surprise[0], place[1] + surprise[1]), noise)
    gain = covariance @ jacobian.T @ np.linalg.inv(predicted + matrix)
    keep = np.eye(9) - gain @ jacobian
    assert chain.state == pytest.approx(state + gain @ surprise, rel=1e-4, abs=1e-6)
    joseph = keep @ covariance @ keep.T + gain @ matrix @ gain.T
    scale = np.sqrt(np.diag(covariance))
    assert chain.covariance / np.outer(scale, scale) == pytest.approx(joseph / np.outer(scale, scale), abs=2e-3)


def test_a_large_surprise_ends_at_the_likeliest_state() -> None:
    """The iterated filter is Gauss-Newton on prior and measurement together: a general minimiser finds the same."""
    chain = ChainFilter(GEOMETRY)
    prior = state_of(np.array([0.3, 0.3, 0.3]))
    deviation = np.array([2e-3, 2e-3, 0.03, 0.4, 0.5, 0.3, 1.0, 1.0, 1.0])
    chain.state, chain.covariance = prior, np.diag(deviation**2)
    seen, stddev = GEOMETRY.markers(state_of(np.array([0.7, 0.5, 0.2])))[4], 3e-3
    chain.update(4, tuple(seen), Spread(stddev**2, 0.0, stddev**2))

    def residuals(state: np.ndarray) -> np.ndarray:
        return np.concatenate([(state - prior) / deviation, (GEOMETRY.markers(state)[4] - seen) / stddev])

    likeliest = least_squares(residuals, prior, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    assert chain.state == pytest.approx(likeliest, abs=2e-3)
    assert np.square(residuals(chain.state)).sum() == pytest.approx(np.square(residuals(likeliest)).sum(), rel=1e-3)


def test_what_a_chain_does_not_have_is_named() -> None:
    chain, points = ChainFilter(GEOMETRY), GEOMETRY.markers(state_of(np.zeros(3)))
    for marker in (-1, 5, 2**40):
        with pytest.raises(ValueError, match=r"marker: expected 0 \.\. 4"):
            chain.expect(marker)
        with pytest.raises(ValueError, match="marker"):
            chain.update(marker, (0.0, 0.0), SHARP)
        with pytest.raises(ValueError, match="marker"):
            GEOMETRY.jacobian(points, marker)
    for link in (-1, 4):
        with pytest.raises(ValueError, match="link"):
            chain.heading(link)
    for wrong in (points[:4], np.zeros((0, 2)), np.zeros((6, 2))):
        for use in (chain.place, GEOMETRY.angles, lambda places: GEOMETRY.jacobian(places, 1)):
            with pytest.raises(ValueError, match="points: expected"):
                use(wrong)
    for seconds in (0.0, -0.1, math.nan):
        with pytest.raises(ValueError, match="seconds"):
            chain.predict(seconds)
    with pytest.raises(ValueError, match="hidden"):
        chain.settle_hidden([True] * 4)
    with pytest.raises(ValueError, match="state"):
        chain.state = np.zeros(8)
    with pytest.raises(ValueError, match="state"):
        GEOMETRY.markers(np.zeros(5))
    with pytest.raises(ValueError, match="covariance"):
        chain.covariance = np.eye(8)


def test_numbers_that_are_none_stay_in_the_filter() -> None:
    chain = ChainFilter(GEOMETRY)
    chain.update(2, (math.nan, math.inf), SHARP)
    assert np.isnan(chain.angles()[0]).any()
    chain.settle_hidden([True, False, True, False, True])
    assert np.isnan(chain.tip()[0]).any()


def test_the_state_is_changed_by_another_one_only() -> None:
    chain = ChainFilter(GEOMETRY)
    with pytest.raises(ValueError, match="read-only"):
        chain.state[3] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        chain.covariance[0, 0] = 1.0


def test_where_links_point() -> None:
    chain = ChainFilter(GEOMETRY)
    chain.state = state_of(np.array([0.5, 0.6, 0.4]), (1e-3, 0.0, 0.02))
    steps = np.diff(GEOMETRY.markers(chain.state), axis=0)
    assert [chain.heading(link) for link in range(4)] == pytest.approx(np.arctan2(steps[:, 1], steps[:, 0]))
