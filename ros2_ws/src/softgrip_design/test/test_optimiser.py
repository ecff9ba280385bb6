# SPDX-License-Identifier: Apache-2.0
"""The search finds what is known to be there."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from softgrip_design import hand
from softgrip_design.design import Task, design_hand, design_uniform, published_on
from softgrip_design.errors import DesignError
from softgrip_design.objective import FollowTrajectory, Weights
from softgrip_design.optimiser import OptimiserSettings, optimise, optimise_all, starting_points
from softgrip_design.target import DesignTarget
from softgrip_design.trajectory import SHIPPED, FingerTrajectory, load
from softgrip_model.finger import Control, Kernel
from softgrip_model.friction.published import published

Array = NDArray[np.float64]
BRAID = published("braid-tpu-chapter4").law


class TwoValleys:
    """f = sum (x^2 - 1)^2 + 0.1 x, per variable: the valley at -1 is the deeper one."""

    lower, upper = np.full(2, -2.0), np.full(2, 2.0)

    def value(self, x: Array) -> float:
        return float(((x**2 - 1.0) ** 2 + 0.1 * x).sum())

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        return self.value(x), 4.0 * x * (x**2 - 1.0) + 0.1


class Nowhere(TwoValleys):
    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        return math.inf, np.zeros_like(x)


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("exact", [True, False])
def test_many_starts_find_the_deepest_valley(exact: bool, workers: int) -> None:
    found = optimise(TwoValleys(), OptimiserSettings(exact=exact, workers=workers))
    deepest = np.roots([4.0, 0.0, -4.0, 0.1]).real.min()
    assert found.x == pytest.approx([deepest, deepest], abs=1e-3)
    assert len(found.start_values) == 16
    assert found.start_values[0] == pytest.approx(found.value, abs=1e-2)
    assert found.start_values[-1] > found.value + 0.1  # the other valley was visited too


def test_starts_fill_every_stratum_and_are_reproducible() -> None:
    lower, upper = np.array([0.0, 10.0]), np.array([1.0, 20.0])
    points = starting_points(lower, upper, 8, seed=5)
    strata = np.sort(np.floor(8 * (points - lower) / (upper - lower)), axis=0)
    assert strata.tolist() == [[float(k)] * 2 for k in range(8)]
    assert points.tolist() == starting_points(lower, upper, 8, seed=5).tolist()


def test_no_solution_is_an_error_and_starts_are_counted() -> None:
    ended: list[str] = []
    with pytest.raises(DesignError, match="nowhere: none of 3 starts"):
        optimise_all({"nowhere": Nowhere()}, OptimiserSettings(starts=3), ended.append)
    assert ended == ["nowhere"] * 3


def test_a_finger_is_found_again_from_what_it_does() -> None:
    """The target is another finger's own closing, so that an error of (almost) nothing can be reached."""
    design = (3.2, 2.8, 3.6), (7.0, 8.0, 9.0, 8.5, 10.0, 9.5)
    total = np.radians(np.arange(4.0, 161.0, 4.0))
    closing = Kernel([hand.blank("index").with_design(*design)], BRAID).solve(total, Control.DEFLECTION)
    objective = FollowTrajectory(
        hand.blank("index"),
        BRAID,
        DesignTarget(total, closing.angle_rad[0]),
        Weights(1.0, 0.0),
        (2.5, 5.0),
        (5.0, 13.0),
    )
    assert objective.error_deg(optimise(objective).x) < 0.05


def test_the_uniform_finger_reaches_what_an_independent_program_reached() -> None:
    """0.24 deg for joints 10 mm long: the least of 22 random starts of a separate implementation."""
    uniform = design_uniform(published("twine-tpu").law, OptimiserSettings())
    assert uniform.spread_deg == pytest.approx(0.24, abs=0.01)
    assert uniform.published_spread_deg == pytest.approx(4.71, abs=0.005)
    assert np.ptp(np.degrees(uniform.closing.angle_rad[0, -1])) < 1.0


def test_a_whole_hand_is_designed_and_beats_the_published_designs() -> None:
    task = Task(BRAID, search=OptimiserSettings(starts=6))
    demonstration = load(SHIPPED / "hand_power.csv")
    design = design_hand(demonstration, hand.FINGERS, task)
    assert tuple(design.fingers) == hand.FINGERS
    for one in design.followed:
        thickness, routing = one.finger.thickness_mm, one.finger.routing_mm
        assert one.error_deg == pytest.approx(math.sqrt(np.mean(np.square(one.error_per_joint_deg))))
        assert one.optimum.value == pytest.approx(2.0 * one.error_deg + one.force_n)
        assert 2.5 <= min(thickness) <= max(thickness) <= 5.0
        assert 5.0 <= min(routing) <= max(routing) <= 13.0
        if one.finger.joints == 3:
            theirs = [
                2.0 * error + force for error, force in published_on(task.objective(demonstration, one.name)).values()
            ]
            assert not any(value <= one.optimum.value for value in theirs)


def test_fingers_that_hardly_move_take_the_design_of_the_index() -> None:
    design = design_hand(
        load(SHIPPED / "hand_pinch.csv"), hand.FINGERS, Task(BRAID, search=OptimiserSettings(starts=2))
    )
    assert [one.name for one in design.followed] == ["thumb", "index"]
    index = design.fingers["index"]
    for other in design.shared:
        assert other.taken_from == "index"
        assert other.finger.routing_mm == index.routing_mm
        assert other.finger.link_mm != index.link_mm


def test_a_still_hand_is_refused() -> None:
    still = FingerTrajectory(np.arange(10) / 30.0, {"index": np.full((10, 3), 0.4), "middle": np.full((10, 3), 0.2)})
    with pytest.raises(DesignError, match="none that moves"):
        design_hand(still, ("index", "middle"), Task(BRAID))
    with pytest.raises(DesignError, match=r"15 deg or more, found 0.0 deg"):
        design_hand(still, ("index",), Task(BRAID))
    with pytest.raises(DesignError, match="one of index, middle, found 'thumb'"):
        design_hand(still, ("thumb",), Task(BRAID))


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    objective = Task(BRAID).objective(load(SHIPPED / "hand_pinch.csv"), "index")
    one, three = (optimise(objective, dataclasses.replace(OptimiserSettings(), workers=n)) for n in (1, 3))
    assert one.x.tolist() == three.x.tolist()
