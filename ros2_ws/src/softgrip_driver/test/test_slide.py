# SPDX-License-Identifier: Apache-2.0
"""A pull in closed form, and what is wrong with one: each must be told by its own reason and never give a point.

1 kg on a cable with Rf = 1.2: at rest between, T1 = 9.81 N x 1.2 while pulling, 9.81 N / 1.2 while letting back.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from softgrip_driver.rig.pull import LimitError, PullSettings, RigSample, StoppedError, Stroke, Trace, record_pull
from softgrip_driver.rig.slide import PointVerdict, Slide, analyse

LOAD, RATIO = 1.0, 1.2
T2 = 9.80665 * LOAD
ANGLE = math.radians(45.0)
STROKE, COUNT = 12e-3, 400


def trace(
    load: float = LOAD,
    ratio: float = RATIO,
    noise: float = 0.01,
    shape: Callable[[NDArray[np.float64]], NDArray[np.float64]] = np.zeros_like,
) -> Trace:
    """A pull of a mass [kg]; ``shape`` adds [N] over the travel [m] of the pull."""
    rng = np.random.default_rng(1)
    weight = 9.80665 * load
    travel = np.linspace(0.0, STROKE, COUNT)
    # The cable stretches over the first 2 mm, then it slides.
    pull = weight * np.interp(travel, [0.0, 2e-3], [1.0, ratio]) + shape(travel)
    back = weight * np.interp(travel, [STROKE - 2e-3, STROKE], [1.0 / ratio, ratio])

    def stroke(travel: NDArray[np.float64], tension: NDArray[np.float64]) -> Stroke:
        return Stroke(np.linspace(0.0, 18.0, len(travel)), travel, tension + noise * rng.standard_normal(len(travel)))

    rest = stroke(np.zeros(20), np.full(20, weight))
    return Trace(rest, stroke(travel, pull), stroke(travel[::-1], back[::-1]))


def judge(one: Trace, pulley_ratio: float = 1.0) -> Slide:
    return analyse(one, ANGLE, LOAD, pulley_ratio=pulley_ratio)


def test_a_good_pull_gives_the_ratio_that_it_was_made_of() -> None:
    slide = judge(trace())
    assert slide.verdict is PointVerdict.ACCEPTED, slide.reason
    assert slide.ratio == pytest.approx(RATIO, rel=2e-3)
    assert slide.stddev == pytest.approx(0.01, rel=0.2)


def test_the_pulley_s_own_friction_is_divided_out() -> None:
    assert judge(trace(), pulley_ratio=1.05).ratio == pytest.approx(RATIO / 1.05, rel=2e-3)


@pytest.mark.parametrize(
    ("found", "verdict", "reason"),
    [
        (trace(load=0.75), PointVerdict.REJECTED, r"expected 1000 g hung, found about 7\d\d g"),
        (trace(load=1.3), PointVerdict.REJECTED, r"expected 1000 g hung, found about 1[23]\d\d g"),
        (trace(shape=lambda x: -60.0 * x), PointVerdict.REPEAT, r"T1 drifts by \d"),
        (trace(shape=lambda x: 1.5 * np.sign(np.sin(x * 2e4))), PointVerdict.REPEAT, r"stick-slip of 2\d"),
        (trace(ratio=0.93), PointVerdict.REPEAT, r"expected T1/T2 within 0.97 .. \d.*found 0.9[23]"),
        (trace(ratio=3.0), PointVerdict.REPEAT, r"expected T1/T2 within 0.97 .. 2.02, found (2.99|3.0)"),
    ],
    ids=["too little weight", "too much weight", "drift", "stick-slip", "less than the weight", "too much friction"],
)
def test_what_is_wrong_with_a_pull_is_told_and_gives_no_point(found: Trace, verdict: PointVerdict, reason: str) -> None:
    slide = judge(found)
    assert slide.verdict is verdict
    assert re.search(reason, slide.reason), slide.reason


def test_a_gauge_that_shows_one_number_is_stuck() -> None:
    good = trace()
    flat = Stroke(good.pull.time, good.pull.travel, np.full(COUNT, T2 * RATIO))
    slide = judge(Trace(good.rest, flat, good.release))
    assert slide.verdict is PointVerdict.REJECTED
    assert "its reading is stuck" in slide.reason


# --- the stroke itself ---------------------------------------------------------------------------------------------


class Clock:
    def __init__(self) -> None:
        self.time, self.stop_at = 0.0, math.inf

    def now(self) -> float:
        return self.time

    def wait(self, duration: float) -> bool:
        self.time += duration
        return self.time >= self.stop_at


class Stage:
    """Goes to its target at its speed, or as a test lets it; counts how often it was stopped since it was started."""

    def __init__(self, clock: Clock, where: float = 0.0, way: float = 1.0) -> None:
        self._clock, self._from, self._way = clock, where, way
        self._target, self._speed, self._since = where, 0.0, 0.0
        self.stands = True

    def start(self, target: float, speed: float) -> None:
        self._from, self._target, self._speed, self._since = self.travel(), target, speed, self._clock.now()
        self.stands = False

    def travel(self) -> float:
        gone = self._speed * (self._clock.now() - self._since)
        left = self._target - self._from
        return self._from + self._way * math.copysign(min(abs(left), gone), left)

    def stop(self) -> None:
        self.stands = True


class Gauge:
    def __init__(self, shows: Callable[[], float] = lambda: 5.0) -> None:
        self.tension = shows


def pull(
    stage: Stage, clock: Clock, gauge: Gauge | None = None, on_sample: Callable[[RigSample], None] = lambda _: None
) -> Trace:
    settings = PullSettings(speed=2e-3, return_speed=4e-3, dwell=0.2)
    return record_pull(stage, gauge or Gauge(), settings, clock, on_sample)  # type: ignore[arg-type]


def test_a_stage_that_goes_the_wrong_way_is_stopped_at_once() -> None:
    clock = Clock()
    stage = Stage(clock, where=5e-3, way=-1.0)
    with pytest.raises(LimitError, match="expected travel to grow, found it at 4"):
        pull(stage, clock)
    assert stage.stands
    assert clock.time < 0.5, "one tenth of a millimetre takes 0.05 s"


@pytest.mark.parametrize("outside", [-2e-3, 61e-3])
def test_a_stage_outside_its_limits_is_not_moved(outside: float) -> None:
    clock = Clock()
    stage = Stage(clock, where=outside)
    with pytest.raises(LimitError, match=r"expected travel within -1 \.\. 60 mm"):
        pull(stage, clock)
    assert stage.stands


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError(), RuntimeError("a defect")])
def test_whatever_ends_a_pull_stops_the_stage(error: BaseException) -> None:
    clock = Clock()
    stage = Stage(clock)

    def fail(sample: RigSample) -> None:
        if sample.travel > 2e-3:
            raise error

    with pytest.raises(type(error)):
        pull(stage, clock, on_sample=fail)
    assert stage.stands


def test_a_pull_that_is_to_stop_stops_its_stage() -> None:
    clock = Clock()
    clock.stop_at = 1.0
    stage = Stage(clock)
    with pytest.raises(StoppedError):
        pull(stage, clock)
    assert stage.stands


def test_more_force_than_the_limit_stops_the_stage() -> None:
    clock = Clock()
    stage = Stage(clock)
    with pytest.raises(LimitError, match=r"expected at most 45 N, found 46\.00 N"):
        pull(stage, clock, Gauge(lambda: 46.0 if stage.travel() > 3e-3 else 5.0))
    assert stage.stands
