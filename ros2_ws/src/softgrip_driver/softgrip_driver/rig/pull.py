# SPDX-License-Identifier: Apache-2.0
"""One pull: dwell, slide at constant speed, slide back; limits checked all along, the stage stopped on every exit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_driver.errors import DriverError, LimitError, StageStalledError, StoppedError
from softgrip_driver.rig.devices import Gauge, Stage

Array = NDArray[np.float64]

#: [m] how near to its target the stage must come.
_ARRIVED = 0.03e-3
#: So many readings in a row at the same place: fewer are a pause of the computer, which no stage can help.
_STALL_READINGS = 10
#: [m] travel against the asked direction that is no jitter of the encoder.
_WRONG_WAY = 0.1e-3


class RigClock(Protocol):
    """Rig time [s]: real time, or faster on an emulated rig."""

    def now(self) -> float:
        """Monotonic rig time [s]."""
        ...

    def wait(self, duration: float) -> bool:
        """Wait [s] of rig time; return True at once when the measurement is to stop."""
        ...


@dataclass(frozen=True)
class PullSettings:
    """How to pull.

    Attributes:
        speed: [m/s] of the measured stroke; 40 mm/min in the thesis. return_speed: [m/s] back.
        stroke: [m]; the cable stretches first, then slides.
        dwell: [s] of rest before, for the static tension.
        sample_period: [s] between samples.
        force_limit: [N] stop above it. negative_limit: [N] stop so far below nothing: a cable can not push.
        travel_low, travel_high: [m] the stage may never leave.
        stall_time: [s] without progress that counts as stalled.
    """

    speed: float = 40e-3 / 60.0
    return_speed: float = 120e-3 / 60.0
    stroke: float = 12e-3
    dwell: float = 1.0
    sample_period: float = 0.05
    force_limit: float = 45.0
    negative_limit: float = 1.0
    travel_low: float = -1e-3
    travel_high: float = 60e-3
    stall_time: float = 1.5


@dataclass(frozen=True)
class RigSample:
    """One reading: rig time [s], travel [m], tension at the gauge [N]."""

    time: float
    travel: float
    tension: float


@dataclass(frozen=True, eq=False)
class Stroke:
    """Readings of one stroke, each array (samples,): rig time [s], travel [m], tension [N]."""

    time: Array
    travel: Array
    tension: Array

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, eq=False)
class Trace:
    """One pull: at rest, pulling, letting back."""

    rest: Stroke
    pull: Stroke
    release: Stroke

    def without(self, zero: float) -> Trace:
        """Return the trace with the gauge's zero [N] taken out."""
        strokes = (Stroke(s.time, s.travel, s.tension - zero) for s in (self.rest, self.pull, self.release))
        return Trace(*strokes)


def record_pull(
    stage: Stage,
    gauge: Gauge,
    settings: PullSettings,
    clock: RigClock,
    on_sample: Callable[[RigSample], None],
    check_rest: Callable[[Stroke], None] = lambda _: None,
) -> Trace:
    """Rest, pull one stroke and come back, recording all of it.

    Args:
        stage: pulls.
        gauge: feels.
        settings: how to pull.
        clock: rig time.
        on_sample: takes each reading.
        check_rest: looks at the readings before anything moves; what it raises ends the pull there.

    Raises:
        LimitError: force or travel beyond its limit, before or during motion.
        StageStalledError: the stage does not move.
        StoppedError: the clock said stop.
        DriverError: a device failed. The stage is told to stop in every case.
    """
    recorder = _Recorder(stage, gauge, settings, clock, on_sample)
    try:
        start = stage.travel()
        rest = recorder.rest(start)
        check_rest(rest)
        pull = recorder.stroke(start + settings.stroke, settings.speed)
        release = recorder.stroke(start, settings.return_speed)
    except BaseException as error:
        _stop(stage, error)
        raise
    stage.stop()
    return Trace(rest, pull, release)


def _stop(stage: Stage, cause: BaseException) -> None:
    """Stop; where even that fails, the stage's own limit ends the motion, and the message says so."""
    try:
        stage.stop()
    except DriverError as error:
        cause.add_note(f"and the stage could not be told to stop: {error}; it runs to its own limit at most")


class _Recorder:
    def __init__(
        self,
        stage: Stage,
        gauge: Gauge,
        settings: PullSettings,
        clock: RigClock,
        on_sample: Callable[[RigSample], None],
    ) -> None:
        self._stage, self._gauge = stage, gauge
        self._settings, self._clock, self._on_sample = settings, clock, on_sample

    def rest(self, travel: float) -> Stroke:
        samples: list[RigSample] = []
        end = self._clock.now() + self._settings.dwell
        while not samples or self._clock.now() < end:
            samples.append(self._sample(travel))
            self._pause()
        return _stroke(samples)

    def stroke(self, target: float, speed: float) -> Stroke:
        low, high = self._settings.travel_low, self._settings.travel_high
        if not low <= target <= high:
            raise LimitError(
                f"stage: expected a target within {low * 1e3:g} .. {high * 1e3:g} mm, found {target * 1e3:.2f} mm; "
                "move the stage back or shorten the stroke"
            )
        begin = self._stage.travel()
        direction = 1.0 if target > begin else -1.0
        self._stage.start(target, speed)
        samples: list[RigSample] = []
        furthest, progressed, readings = begin, self._clock.now(), 0
        while True:
            sample = self._sample(self._stage.travel())
            samples.append(sample)
            readings += 1
            if (sample.travel - begin) * direction < -_WRONG_WAY:
                raise LimitError(
                    f"stage: expected travel to {'grow' if direction > 0 else 'shrink'}, found it at "
                    f"{sample.travel * 1e3:.2f} mm from {begin * 1e3:.2f} mm; check the direction of the stage"
                )
            if abs(sample.travel - target) <= _ARRIVED:
                return _stroke(samples)
            if (sample.travel - furthest) * direction > _ARRIVED:
                furthest, progressed, readings = sample.travel, sample.time, 0
            elif sample.time - progressed > self._settings.stall_time and readings >= _STALL_READINGS:
                raise StageStalledError(
                    f"stage: expected it on its way to {target * 1e3:.2f} mm, found it standing at "
                    f"{sample.travel * 1e3:.2f} mm for {sample.time - progressed:.1f} s; "
                    "check for a jam, the shield, and that PC control is on"
                )
            self._pause()

    def _sample(self, travel: float) -> RigSample:
        sample = RigSample(self._clock.now(), travel, self._gauge.tension())
        self._on_sample(sample)
        settings = self._settings
        if sample.tension > settings.force_limit:
            raise LimitError(
                f"gauge: expected at most {settings.force_limit:g} N, found {sample.tension:.2f} N; "
                "look for a caught cable; less weight, or raise the limit within the gauge's capacity"
            )
        if sample.tension < -settings.negative_limit:
            raise LimitError(
                f"gauge: expected at least {-settings.negative_limit:g} N, found {sample.tension:.2f} N: its cell is "
                "reversed or its zero has drifted; change the sign of counts_per_newton, or calibrate_cell"
            )
        if not settings.travel_low <= travel <= settings.travel_high:
            raise LimitError(
                f"stage: expected travel within {settings.travel_low * 1e3:g} .. {settings.travel_high * 1e3:g} mm, "
                f"found {travel * 1e3:.2f} mm"
            )
        return sample

    def _pause(self) -> None:
        if self._clock.wait(self._settings.sample_period):
            raise StoppedError("the measurement was stopped")


def _stroke(samples: list[RigSample]) -> Stroke:
    columns = np.array([(s.time, s.travel, s.tension) for s in samples], dtype=np.float64)
    return Stroke(columns[:, 0], columns[:, 1], columns[:, 2])
