# SPDX-License-Identifier: Apache-2.0
"""The guided measurement: asks for a setting, pulls, judges, repeats what fails, keeps every accepted point, fits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from typing import Protocol

import numpy as np

from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DriverError,
    GaugeFaultError,
    NoReplyError,
    StoppedError,
    UnitChangedError,
)
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.journal import MeasuredPoint, PlanJournal, Request
from softgrip_driver.rig.plan import ADAPTIVE, PULLEY, Point, next_point, points_of
from softgrip_driver.rig.pull import PullSettings, RigClock, RigSample, Stroke, record_pull
from softgrip_driver.rig.slide import PointVerdict, Slide, SlideSettings, analyse, check_weight_at_rest
from softgrip_model.friction.assess import AcceptanceLimits
from softgrip_model.friction.calibration import Calibration, SurfacePair, calibrate
from softgrip_model.friction.laws import GRAVITY, Law
from softgrip_model.friction.measurements import Measurements, measurements


class ProcedurePhase(IntEnum):
    """Where the measurement is; numbers as in CalibrateFriction's feedback."""

    SET_UP = 0
    CHECKING = 1
    PULLING = 2
    ACCEPTED = 3
    REPEATING = 4


@dataclass(frozen=True)
class ProcedureStep:
    """What the person is told: phase, which point of how many, its setting, and the instruction in words."""

    phase: ProcedurePhase
    index: int
    total: int
    point: Point
    instruction: str


@dataclass(frozen=True)
class JudgedPoint:
    """One attempt at one point, accepted or not."""

    plan_id: str
    index: int
    point: Point
    slide: Slide
    speed: float


class RigOperator(Protocol):
    """The person at the rig, and whoever listens."""

    def show_step(self, step: ProcedureStep) -> None:
        """Show a step."""
        ...

    def confirmed(self, step: ProcedureStep) -> None:
        """Show a step that asks for something; return when the person has done it.

        Raises:
            StoppedError: the measurement is to stop.
        """
        ...

    def judged(self, point: JudgedPoint) -> None:
        """Record an attempt."""
        ...

    def sampled(self, sample: RigSample) -> None:
        """Record a raw reading."""
        ...


@dataclass(frozen=True)
class RigSettings:
    """How to measure.

    Attributes:
        pull, slide: of one pull. limits: of the model.
        attempts: at one point before the plan fails.
        recheck_rounds: how often points that the others contradict are measured again at the end.
        recheck_significance: of the outlier test that asks for it.
        agreement: relative difference of two measurements of one point that are both believed [1].
        pulley_ratio: tension ratio over the guide pulley [1], 1 when never calibrated.
        common_stddev: relative error that all points share [1]: of the pulley ratio and the gauge's gain.
        zero_drift_limit: [N] of the gauge over the plan.
        adaptive_interval: the adaptive plan stops when the widest 95 % interval is below it [1].
        adaptive_max_points: points it may take.
    """

    pull: PullSettings = field(default_factory=PullSettings)
    slide: SlideSettings = field(default_factory=SlideSettings)
    limits: AcceptanceLimits = field(default_factory=AcceptanceLimits)
    attempts: int = 3
    recheck_rounds: int = 2
    recheck_significance: float = 0.05
    agreement: float = 0.06
    pulley_ratio: float = 1.0
    common_stddev: float = 0.01
    zero_drift_limit: float = 0.05
    adaptive_interval: float = 0.03
    adaptive_max_points: int = 20


#: [1] three weights cannot tell the pulley's ratio better than the weights themselves are known.
MIN_PULLEY_STDDEV = 0.002


#: Points before an adaptive plan may stop: with fewer than three degrees of freedom luck looks like precision.
ADAPTIVE_MIN_POINTS = 7
_ZERO_READINGS = 20


class PlanFailedError(DriverError):
    """A plan came to no model; says which point and why."""


@dataclass(frozen=True, eq=False)
class PlanOutcome:
    """What a plan gave.

    Attributes:
        plan_id: its record's name. calibration: fit, assessment, model; None for a pulley plan.
        points: those used. pulley_ratio, pulley_stddev: of a pulley plan [1], else those used.
    """

    plan_id: str
    calibration: Calibration | None
    points: tuple[MeasuredPoint, ...]
    pulley_ratio: float
    pulley_stddev: float


class Procedure:
    """One plan on one rig.

    Args:
        stage, gauge: opened. operator: who sets and hangs. clock: rig time and the wish to stop.
        settings: how. folder: where plans are recorded.
    """

    def __init__(
        self,
        stage: Stage,
        gauge: Gauge,
        operator: RigOperator,
        clock: RigClock,
        settings: RigSettings,
        folder: Path,
    ) -> None:
        self._stage, self._gauge = stage, gauge
        self._operator, self._clock = operator, clock
        self._settings, self._folder = settings, folder
        self._zero = 0.0

    def run(self, request: Request, *, resume: bool = False) -> PlanOutcome:
        """Measure a plan and fit its model.

        Args:
            request: what to measure; when resuming, the broken plan's own request counts.
            resume: continue the newest plan that never came to its end.

        Raises:
            PlanFailedError: a point failed too often, or there is nothing to resume.
            StoppedError: stopped by request; accepted points are kept and can be resumed.
            DriverError: a device failed for good; likewise.
        """
        journal = self._resumed() if resume else self._begun(request)
        points = dict(enumerate(points_of(journal.request.plan, journal.request.angles, journal.request.loads)))
        # An adaptive plan's own points lie beyond its first ones.
        points |= {i: Point(m.angle, m.load) for i, m in journal.points.items()}
        self._set_zero(points, journal)
        for index in sorted(points):
            if index not in journal.points:
                self._measure(journal, index, points)
        if journal.request.plan == PULLEY:
            return self._pulley_outcome(journal)
        calibration = self._recheck(journal, points)
        while journal.request.plan == ADAPTIVE and self._needs_more_points(calibration):
            index = len(points)
            points[index] = next_point(calibration)
            self._measure(journal, index, points)
            calibration = self._recheck(journal, points)
        self._check_zero(points, journal)
        journal.finish(str(calibration.assessment.verdict))
        settings = self._settings
        return PlanOutcome(
            journal.plan_id, calibration, _in_order(journal), settings.pulley_ratio, settings.common_stddev
        )

    # -- one point -------------------------------------------------------------------------------------------------

    def _measure(self, journal: PlanJournal, index: int, points: dict[int, Point]) -> Slide:
        point, total = points[index], len(points)
        pull, why = self._settings.pull, ""
        for attempt in range(1, self._settings.attempts + 1):
            again = f"Again ({why}): " if why else ""
            self._operator.confirmed(
                ProcedureStep(ProcedurePhase.SET_UP, index, total, point, again + _instruction(point))
            )
            slide = self._attempt(index, total, point, pull)
            if slide.verdict is PointVerdict.ACCEPTED:
                doubt = self._doubt(journal, point, slide) if attempt == 1 else ""
                if doubt:
                    slide = dataclasses.replace(slide, verdict=PointVerdict.REPEAT, reason=doubt)
            self._operator.judged(JudgedPoint(journal.plan_id, index, point, slide, pull.speed))
            if slide.sparse:
                pull = dataclasses.replace(pull, speed=0.5 * pull.speed, return_speed=0.5 * pull.return_speed)
            if slide.verdict is PointVerdict.ACCEPTED:
                journal.accept(MeasuredPoint(index, point.angle, point.load, slide.tension_low, slide.tension_high))
                text = f"{point}: T1/T2 = {slide.ratio:.3f}"
                self._operator.show_step(ProcedureStep(ProcedurePhase.ACCEPTED, index, total, point, text))
                return slide
            why = slide.reason
            self._operator.show_step(ProcedureStep(ProcedurePhase.REPEATING, index, total, point, why))
        raise PlanFailedError(
            f"point {index + 1} of {total} ({point}) failed {self._settings.attempts} times, last: {why}; "
            "put it right and resume the plan"
        )

    def _attempt(self, index: int, total: int, point: Point, pull: PullSettings) -> Slide:
        """Pull once. What a panel or a wire did wrong costs the attempt, not the plan."""
        self._operator.show_step(
            ProcedureStep(ProcedurePhase.CHECKING, index, total, point, "checking the weight at rest, then pulling")
        )
        try:
            self._stage.zero()
            self._operator.show_step(ProcedureStep(ProcedurePhase.PULLING, index, total, point, "pulling"))
            trace = record_pull(
                self._stage, self._gauge, pull, self._clock, self._operator.sampled, self._weight_check(point)
            )
        except GaugeFaultError as error:
            return _unmeasured(point, str(error), PointVerdict.REJECTED)
        except (UnitChangedError, CorruptReplyError, NoReplyError) as error:
            return _unmeasured(point, str(error))
        return analyse(
            trace.without(self._zero), point.angle, point.load, self._settings.slide, self._settings.pulley_ratio
        )

    def _weight_check(self, point: Point) -> Callable[[Stroke], None]:
        """Return what looks at the readings at rest before the pull of a point."""
        return lambda rest: check_weight_at_rest(Stroke(rest.time, rest.travel, rest.tension - self._zero), point.load)

    def _doubt(self, journal: PlanJournal, point: Point, slide: Slide) -> str:
        """Friction grows with the angle: a point that falls clearly below a smaller angle's has the wrong angle."""
        for other in journal.points.values():
            same_load = math.isclose(other.load, point.load, rel_tol=1e-6)
            if not same_load or other.angle >= point.angle - np.radians(5.0):
                continue
            if slide.ratio < 0.96 * other.tension_high / other.tension_low:
                return (
                    f"T1/T2 = {slide.ratio:.3f} is below the {other.tension_high / other.tension_low:.3f} found at "
                    f"{np.degrees(other.angle):g} deg: check the angle"
                )
        return ""

    # -- zero ------------------------------------------------------------------------------------------------------

    def _set_zero(self, points: dict[int, Point], journal: PlanJournal) -> None:
        first = next((points[i] for i in sorted(points) if i not in journal.points), points[0])
        off = Point(first.angle, 0.0)
        text = "Take the weight off and leave the cable slack: the gauge is set to zero."
        self._operator.confirmed(ProcedureStep(ProcedurePhase.SET_UP, 0, len(points), off, text))
        self._gauge.tare()
        # The gauge takes one noisy reading for its zero; the mean of many says what that left.
        self._zero = self._mean_tension()

    def _mean_tension(self) -> float:
        readings = []
        for _ in range(_ZERO_READINGS):
            readings.append(self._gauge.tension())
            if self._clock.wait(self._settings.pull.sample_period):
                raise StoppedError("the measurement was stopped")
        return float(np.mean(readings))

    def _check_zero(self, points: dict[int, Point], journal: PlanJournal) -> None:
        off = Point(points[max(points)].angle, 0.0)
        text = "Take the weight off and leave the cable slack: the gauge's zero is checked."
        self._operator.confirmed(ProcedureStep(ProcedurePhase.SET_UP, len(points) - 1, len(points), off, text))
        drift = self._mean_tension() - self._zero
        if abs(drift) > self._settings.zero_drift_limit:
            for index in list(journal.points):
                journal.withdraw(index, "the gauge's zero drifted")
            journal.finish("zero drift")
            raise PlanFailedError(
                f"the gauge's zero drifted by {drift:+.3f} N over the plan "
                f"(limit {self._settings.zero_drift_limit:g} N): no point can be trusted; "
                "let the gauge warm up, check that the weight was off, and measure again"
            )

    # -- the whole -------------------------------------------------------------------------------------------------

    def _recheck(self, journal: PlanJournal, points: dict[int, Point]) -> Calibration:
        """Fit; measure again what the other points contradict, and believe what two measurements agree on."""
        checked: set[int] = set()
        wary = dataclasses.replace(self._settings.limits, significance=self._settings.recheck_significance)
        for _ in range(self._settings.recheck_rounds):
            calibration = self._fit(journal, wary)
            order = sorted(journal.points)
            suspects = [order[i] for i in calibration.assessment.outliers if order[i] not in checked]
            if not suspects:
                break
            for index in suspects:
                checked.add(index)
                self._measure_again(journal, index, points)
        return self._fit(journal, self._settings.limits)

    def _measure_again(self, journal: PlanJournal, index: int, points: dict[int, Point]) -> None:
        """Replace a point by a second measurement; where both agree, by their mean.

        Taking the second one alone would favour points that please the law, and make the intervals too narrow.
        """
        first = journal.points[index]
        journal.withdraw(index, "contradicted by the other points")
        self._measure(journal, index, points)
        second = journal.points[index]
        if abs(math.log(second.tension_high / first.tension_high)) < self._settings.agreement:
            mean = 0.5 * (first.tension_high + second.tension_high)
            journal.accept(dataclasses.replace(second, tension_high=mean))

    def _fit(self, journal: PlanJournal, limits: AcceptanceLimits) -> Calibration:
        request = journal.request
        pair = SurfacePair(request.cable, request.surface, request.cable_radius, request.surface_radius)
        return calibrate(
            _measurements(journal), pair, Law(request.law), limits=limits, common_stddev=self._settings.common_stddev
        )

    def _needs_more_points(self, calibration: Calibration) -> bool:
        count = len(calibration.fit.points)
        narrow = calibration.assessment.widest_interval <= self._settings.adaptive_interval
        return count < self._settings.adaptive_max_points and (count < ADAPTIVE_MIN_POINTS or not narrow)

    def _pulley_outcome(self, journal: PlanJournal) -> PlanOutcome:
        points = _in_order(journal)
        # Taken out of the measured tensions already: put back what the settings assumed.
        ratios = [p.tension_high / p.tension_low * self._settings.pulley_ratio for p in points]
        journal.finish("pulley")
        stddev = float(np.std(ratios, ddof=1) / math.sqrt(len(ratios)))
        return PlanOutcome(journal.plan_id, None, points, float(np.mean(ratios)), max(stddev, MIN_PULLEY_STDDEV))

    def _begun(self, request: Request) -> PlanJournal:
        _check(request)
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        return PlanJournal.create(self._folder, f"{stamp}-{request.plan}", request)

    def _resumed(self) -> PlanJournal:
        journal = PlanJournal.last_broken(self._folder)
        if journal is None:
            raise PlanFailedError(f"resume: expected a broken plan in {self._folder}, found none; start a new one")
        return journal


def _check(request: Request) -> None:
    """Refuse before the first pull what the fit could only refuse after the last one."""
    points_of(request.plan, request.angles, request.loads)
    if request.law not in set(Law):
        raise ConfigurationError(f"law: expected one of {', '.join(Law)}, found '{request.law}'")
    radii = (request.cable_radius, request.surface_radius)
    if not all(math.isfinite(r) and r >= 0.0 for r in radii) or not 1e-5 < sum(radii) < 1.0:
        raise ConfigurationError(f"expected radii of cable and surface in m, found {radii[0]:g} and {radii[1]:g} m")


def _instruction(point: Point) -> str:
    if point.angle == 0.0:
        return f"Lead the cable past the surface, over the pulley alone, and hang {point.load * 1e3:g} g."
    return f"Set the wrap angle to {np.degrees(point.angle):g} deg and hang {point.load * 1e3:g} g."


def _unmeasured(point: Point, reason: str, verdict: PointVerdict = PointVerdict.REPEAT) -> Slide:
    nan = math.nan
    return Slide(point.load * GRAVITY, nan, nan, nan, nan, nan, nan, verdict, reason)


def _in_order(journal: PlanJournal) -> tuple[MeasuredPoint, ...]:
    return tuple(journal.points[i] for i in sorted(journal.points))


def _measurements(journal: PlanJournal) -> Measurements:
    points = _in_order(journal)
    return measurements(
        [p.angle for p in points],
        [p.tension_low for p in points],
        [p.tension_high for p in points],
        labels=[f"{np.degrees(p.angle):g} deg, {p.load * 1e3:g} g" for p in points],
        source=f"rig plan {journal.plan_id}",
    )
