# SPDX-License-Identifier: Apache-2.0
"""A drive that waits for a late goal and then catches up is no touch; what presses ever harder, or stays, is one."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from softgrip_cell.grasp.reading import Baseline, Reading
from softgrip_cell.grasp.sequence import GraspSequence
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.touches import LASTS_S, Touches
from softgrip_cell.grasp.values import GraspOutcome, Press

SETTINGS = GraspSettings()
PERIOD_NS = 10_000_000
THRESHOLD_N = 0.5

#: What a closing of 10 mm/s pulls in a period [m].
TRAVEL_M = 1e-4


def reading(contact_tension_n: float) -> Reading:
    return Reading(
        0.005, 3.0 + contact_tension_n, 3.0, contact_tension_n, THRESHOLD_N, force_n=max(0.0, contact_tension_n)
    )


def sure_after(contact_tension_n: list[float]) -> int | None:
    """Number of samples after which a finger touches for sure."""
    touches = Touches(1, SETTINGS)
    for number, each in enumerate(contact_tension_n, start=1):
        touches.look(number * PERIOD_NS, (reading(each),))
        if touches.sure[0]:
            return number
    return None


def test_what_presses_ever_harder_is_told_after_a_run() -> None:
    rising = [0.1, 0.3, *(THRESHOLD_N + 0.1 * sample for sample in range(20))]
    assert sure_after(rising) == 2 + SETTINGS.run


@pytest.mark.parametrize("tau_s", [0.01, 0.03, 0.06])
@pytest.mark.parametrize("surge_n", [0.6, 1.2])
def test_a_drive_that_catches_up_touches_nothing(surge_n: float, tau_s: float) -> None:
    """The current of a catching-up servo dies away with its own time constant: 0.06 s and shorter."""
    dying = [surge_n * math.exp(-sample * PERIOD_NS * 1e-9 / tau_s) for sample in range(30)]
    assert sure_after([0.0, 0.0, *dying]) is None


def test_what_stays_is_a_touch_though_it_does_not_grow() -> None:
    steady = [1.0, *(0.9 for _ in range(30))]
    assert sure_after(steady) == 1 + round(LASTS_S * 1e9 / PERIOD_NS)


def test_a_touch_that_ends_has_to_begin_anew() -> None:
    touches = Touches(1, SETTINGS)
    for number, contact_tension_n in enumerate([0.6, 0.7, 0.8, 0.2, 0.9, 1.0]):
        touches.look(number * PERIOD_NS, (reading(contact_tension_n),))
        assert touches.sure[0] == (number == 2)


def test_what_is_kept_is_what_no_sample_of_a_run_lacks() -> None:
    touches = Touches(1, SETTINGS)
    kept = []
    for number, contact_tension_n in enumerate([0.0, 0.0, 3.0, 3.0, 0.4, 2.0, 2.5, 2.2]):
        touches.look(number * PERIOD_NS, (reading(contact_tension_n),))
        kept.append(touches.kept_n[0])
    assert kept == [-math.inf, -math.inf, 0.0, 0.0, 0.4, 0.4, 0.4, 2.0]


def followed(differences_n: list[float], prepared_n: list[float] | None = None) -> float:
    """Baseline [N] after these differences, one a period of a closing."""
    baseline = Baseline()
    for difference_n in prepared_n or []:
        baseline.prepare(difference_n)
    for sample, difference_n in enumerate(differences_n):
        baseline.follow(difference_n, 0.003 + sample * TRAVEL_M, THRESHOLD_N)
    return baseline.value_n


def test_what_a_waiting_drive_lacks_is_not_missed_ever_after() -> None:
    """A fall of 0.5 N for three samples; had the baseline gone along, all that follows would be a touch of 0.5 N."""
    fallen = [0.0] * 10 + [-0.5] * 3
    assert followed(fallen) == pytest.approx(-3 * 120.0 * TRAVEL_M)
    assert followed(fallen + [0.0] * 20) == pytest.approx(0.0, abs=0.001)


def test_a_closing_that_begins_with_a_fall_starts_from_before_it() -> None:
    assert followed([-0.5], prepared_n=[-0.1, -0.2, -0.1, -0.2, -0.5, -0.5]) == pytest.approx(-0.2)
    assert followed([-0.4]) == pytest.approx(-0.4)


@pytest.mark.parametrize("slope", [-100.0, 100.0])
def test_creep_along_the_path_is_followed(slope: float) -> None:
    """0.1 N a millimetre either way, what TPU at its worst loses over a path."""
    creeping = [slope * TRAVEL_M * sample for sample in range(100)]
    assert followed(creeping) == pytest.approx(creeping[-1], abs=0.05)


def late(*from_m: float) -> Callable[[float], float]:
    """Tension [N] that a drive shows beside its tendon's, by pulled length: a fall for 0.2 mm, a surge that dies."""

    def beside_n(pulled_m: float) -> float:
        behind_m = min((pulled_m - each for each in from_m if pulled_m >= each), default=math.inf)
        return -0.5 if behind_m < 0.0002 else 1.5 * math.exp((0.0002 - behind_m) / 0.0002)

    return beside_n


@pytest.mark.parametrize("seed", range(5))
def test_a_late_drive_closes_on_nothing(run, task, bench, seed: int) -> None:
    made = bench(drive_n=late(0.0042, 0.0060, 0.0085, 0.0110), noise_n=0.04, seed=seed)
    steps = list(run(GraspSequence(task(), SETTINGS), made))
    assert not any(isinstance(command, Press) for command in made.commands)
    assert steps[-1].verdict is not None
    assert steps[-1].verdict.outcome is GraspOutcome.EMPTY
    assert "closed on nothing" in steps[-1].verdict.reason


@pytest.mark.parametrize("seed", range(5))
def test_a_late_drive_does_not_press_before_the_product_is_touched(run, task, bench, seed: int) -> None:
    contact_m = 0.008
    made = bench(contact_m=(contact_m,) * 3, drive_n=late(0.0042, 0.0060), noise_n=0.04, seed=seed)
    for step in run(GraspSequence(task("orange"), SETTINGS), made):
        if any(isinstance(command, Press) for command in step.commands):
            assert min(made.pulled_m) >= contact_m
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.GRIPPED
