# SPDX-License-Identifier: Apache-2.0
"""The objectives against finite differences, their definition, and the figures of docs/finger.md."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softgrip_design import hand
from softgrip_design.errors import DesignError
from softgrip_design.objective import CloseUniformly, FollowTrajectory, Objective, Weights
from softgrip_design.target import DesignTarget, target
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model.finger import Control, Kernel
from softgrip_model.finger.published import OPTIMISED_ROUTING_MM, chapter_3_finger
from softgrip_model.friction.published import published

BRAID = published("braid-tpu-chapter4").law
TWINE = published("twine-tpu").law


def following(finger: str = "index", weights: Weights | None = None) -> FollowTrajectory:
    return FollowTrajectory(
        hand.blank(finger),
        BRAID,
        target(load(SHIPPED / "hand_power.csv"), finger, 20),
        weights or Weights(),
        hand.THICKNESS_BOUNDS_MM,
        hand.ROUTING_BOUNDS_MM,
    )


def uniform() -> CloseUniformly:
    return CloseUniformly(chapter_3_finger(OPTIMISED_ROUTING_MM), TWINE, (4.0, 12.0), 20.0, 200)


@pytest.mark.parametrize("objective", [following(), following("thumb"), uniform()])
def test_gradients_against_finite_differences(objective: Objective) -> None:
    rng = np.random.default_rng(3)
    for x in rng.uniform(objective.lower, objective.upper, (5, len(objective.lower))):
        value, gradient = objective.value_and_gradient(x)
        assert value == pytest.approx(objective.value(x), rel=1e-12)
        step = 1e-4
        numerical = [
            (objective.value(x + step * e) - objective.value(x - step * e)) / (2 * step) for e in np.eye(len(x))
        ]
        assert gradient == pytest.approx(numerical, rel=1e-5, abs=1e-5)


def test_the_objective_is_two_errors_and_one_force() -> None:
    """Eq 4.4 and 4.5 written out, from the kernel's own equilibria."""
    objective = following()
    x = np.array([3.0, 3.5, 4.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0])
    finger = hand.blank("index").with_design(x[:3], x[3:])
    closing = Kernel([finger], BRAID).solve(objective.target.deflection_rad, Control.DEFLECTION)
    summed = 0.0
    for t in range(20):
        for j in range(3):
            summed += math.degrees(closing.angle_rad[0, t, j] - objective.target.angle_rad[t, j]) ** 2
    error = math.sqrt(summed / (3 * 20))
    assert objective.error_deg(x) == pytest.approx(error)
    assert objective.value(x) == pytest.approx(2.0 * error + closing.tension_n[0, -1, 0])
    assert following(weights=Weights(0.0, 1.0)).value(x) == pytest.approx(objective.force_n(x))


def test_the_published_routing_has_the_spread_of_the_reference() -> None:
    """An independent program gives 4.71 deg for joints 10 mm long (docs/finger.md); the thesis 4.7."""
    assert uniform().value(np.array(OPTIMISED_ROUTING_MM)) == pytest.approx(4.71, abs=0.005)


def test_targets_beyond_the_grooves_are_refused() -> None:
    total = np.radians(np.linspace(10.0, 290.0, 10))
    beyond = DesignTarget(total, np.outer(total, np.full(3, 1 / 3)))
    with pytest.raises(DesignError, match=r"255 deg at most.*found 290"):
        FollowTrajectory(hand.blank("index"), BRAID, beyond, Weights(), (2.5, 5.0), (5.0, 13.0))
    with pytest.raises(DesignError, match="2 joints, found 3"):
        FollowTrajectory(hand.blank("thumb"), BRAID, beyond, Weights(), (2.5, 5.0), (5.0, 13.0))


def test_fingers_without_equilibrium_are_infinitely_bad() -> None:
    objective = following()
    x = np.array([3.0, 3.0, 3.0, 8.0, 8.0, 60.0, 60.0, 8.0, 8.0])  # routing points overlap on the link
    assert objective.value(x) == math.inf
    assert objective.value_and_gradient(x)[0] == math.inf


def test_the_hand_has_the_lengths_that_the_thesis_prints() -> None:
    """Fig 4.1: the thumb stands on a rigid metacarpal; section 4.2.2: the tangent modulus."""
    thumb, little = hand.blank("thumb"), hand.blank("little")
    assert (thumb.base_mm, thumb.link_mm, thumb.joints) == (60.0, (40.0, 30.0), 2)
    assert (little.base_mm, little.link_mm, little.width_mm) == (0.0, (38.0, 20.0, 20.0), 12.0)
    assert thumb.strip.modulus_mpa == (110.08, -89.33, 21.89)
