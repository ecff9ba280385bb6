# SPDX-License-Identifier: Apache-2.0
"""From a force trace to T1: find the steady sliding, tell stick-slip from drift, check that the right weight hangs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_driver.errors import GaugeFaultError
from softgrip_driver.rig.pull import Stroke, Trace
from softgrip_model.friction.laws import GRAVITY

Array = NDArray[np.float64]

#: T1 may fall below T2 by the gauge's noise, not by more.
LOWEST_RATIO = 0.97
#: Of the hung weight that the gauge feels at rest at least: at the largest wrap angle friction hides four fifths.
MIN_WEIGHT_SHARE = 0.1
#: Largest share of (ln Rf)^2 by which pulling and letting back underestimate the weight: (1-n)/2, n = 0.4.
_LOW_TENSION_BIAS = 0.3


class PointVerdict(IntEnum):
    """What to do with a point; numbers as in FrictionSample."""

    ACCEPTED = 1
    REPEAT = 2
    REJECTED = 3


@dataclass(frozen=True)
class SlideSettings:
    """When a slide counts as steady, and the right weight as hung.

    Attributes:
        settle: [m] left out after the force first reaches its plateau.
        shortest_window: [m] of steady sliding.
        drift_limit: change of T1 over the window, relative to T1. stick_slip_limit: peak-to-peak, relative to T1.
        load_tolerance: of the hung weight found from pulling and letting back, relative.
        highest_log_ratio: (a, b): no cable has ln Rf above a + b angle; twine on TPU has 0.21 + 0.34 angle at 2 N.
        min_samples: in the window.
    """

    settle: float = 0.7e-3
    shortest_window: float = 3e-3
    drift_limit: float = 0.02
    stick_slip_limit: float = 0.15
    load_tolerance: float = 0.12
    highest_log_ratio: tuple[float, float] = (0.35, 0.45)
    min_samples: int = 25


@dataclass(frozen=True)
class Slide:
    """What one pull says.

    Attributes:
        tension_low: T2 [N] of the asked weight. tension_high: T1 [N], mean over the window, pulley taken out.
        stddev: [N] within the window, drift removed. stick_slip: [N] peak to peak. drift: [N/m] over travel.
        window_start, window_end: [m].
        verdict, reason: may it be used.
        sparse: there were too few readings to tell; a slower pull gives more.
    """

    tension_low: float
    tension_high: float
    stddev: float
    stick_slip: float
    drift: float
    window_start: float
    window_end: float
    verdict: PointVerdict
    reason: str
    sparse: bool = False

    @property
    def ratio(self) -> float:
        """Rf = T1/T2."""
        return self.tension_high / self.tension_low


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the checks look at: trace, provisional slide, window at the gauge, largest believable Rf at this angle."""

    trace: Trace
    slide: Slide
    tension: Array
    highest_ratio: float
    settings: SlideSettings

    @property
    def mean(self) -> float:
        return float(self.tension.mean())


def analyse(
    trace: Trace, angle: float, load: float, settings: SlideSettings | None = None, pulley_ratio: float = 1.0
) -> Slide:
    """Judge one pull.

    Args:
        trace: of the pull.
        angle: asked wrap angle [rad].
        load: asked mass [kg].
        settings: limits.
        pulley_ratio: tension ratio over the guide pulley [1], from its own calibration.
    """
    settings = settings or SlideSettings()
    window = _steady_window(trace.pull, settings)
    travel, tension = trace.pull.travel[window], trace.pull.tension[window]
    if len(trace.pull) < settings.min_samples:
        return _unjudged(load * GRAVITY, _too_few(len(trace.pull), settings), sparse=True)
    if len(tension) < 3 or np.ptp(travel) <= 0.0:
        reason = "no steady sliding found: the force did not settle; lengthen the stroke or check the cable"
        return _unjudged(load * GRAVITY, reason)
    mean = float(tension.mean())
    slope = float(np.polyfit(travel - travel.mean(), tension, 1)[0])
    residual = tension - mean - slope * (travel - travel.mean())
    slide = Slide(
        tension_low=load * GRAVITY,
        tension_high=mean / pulley_ratio,
        stddev=float(residual.std()),
        stick_slip=float(np.subtract(*np.percentile(_fast_part(travel, residual), [99.0, 1.0]))),
        drift=slope,
        window_start=float(travel[0]),
        window_end=float(travel[-1]),
        verdict=PointVerdict.ACCEPTED,
        reason="",
    )
    highest = math.exp(settings.highest_log_ratio[0] + settings.highest_log_ratio[1] * angle)
    evidence = _Evidence(trace, slide, tension, highest, settings)
    for check in _CHECKS:
        found = check(evidence)
        if found is not None:
            sparse = check is _read_often_enough
            return dataclasses.replace(slide, verdict=found[0], reason=found[1], sparse=sparse)
    return slide


def _unjudged(tension_low: float, reason: str, *, sparse: bool = False) -> Slide:
    nan = math.nan
    return Slide(tension_low, nan, nan, nan, nan, nan, nan, PointVerdict.REPEAT, reason, sparse)


def _too_few(found: int, settings: SlideSettings) -> str:
    return f"expected at least {settings.min_samples} readings of a slide, found {found}: pull slower"


def _steady_window(pull: Stroke, settings: SlideSettings) -> slice:
    """The rest of the stroke after the force has first come up to its plateau and a settling way has passed."""
    late = pull.travel >= pull.travel[0] + 0.6 * (pull.travel[-1] - pull.travel[0])
    plateau = float(np.median(pull.tension[late]))
    reached = np.flatnonzero(pull.tension >= plateau)
    if not len(reached):
        return slice(0, 0)
    start = int(np.searchsorted(pull.travel, pull.travel[reached[0]] + settings.settle))
    return slice(start, len(pull))


def _fast_part(travel: Array, residual: Array) -> Array:
    """What is left without a running mean over a millimetre: the saw-tooth, not the surface's waves."""
    per_millimetre = max(3, round(len(travel) * 1e-3 / max(float(np.ptp(travel)), 1e-9)))
    if per_millimetre >= len(residual):
        return residual
    kernel = np.ones(per_millimetre)
    mean = np.convolve(residual, kernel, "same") / np.convolve(np.ones(len(residual)), kernel, "same")
    return residual - mean


def check_weight_at_rest(rest: Stroke, load: float) -> None:
    """Check at rest, before anything is wound in, that the gauge feels the weight at all, and as a pull.

    Args:
        rest: readings with the zero taken out.
        load: hung mass [kg].

    Raises:
        GaugeFaultError: it does not; says what is likely.
    """
    hung, static = load * GRAVITY, float(np.median(rest.tension))
    if hung == 0.0 or static >= MIN_WEIGHT_SHARE * hung:
        return
    found = f"before motion: expected the {_grams(load * GRAVITY)} that were asked for, found {static:.2f} N; "
    if static <= -MIN_WEIGHT_SHARE * hung:
        raise GaugeFaultError(
            f"{found}the load cell is reversed: change the sign of counts_per_newton, or swap its two signal wires"
        )
    raise GaugeFaultError(f"{found}hang the weight that was asked for; where it hangs, the load cell is cut")


_Found = tuple[PointVerdict, str] | None


def _stuck(e: _Evidence) -> _Found:
    if np.ptp(e.trace.pull.tension) > 0.0:
        return None
    return PointVerdict.REJECTED, (
        f"the gauge read {e.mean:.2f} N {len(e.trace.pull)} times without any noise: its reading is stuck; restart it"
    )


def _static_load(e: _Evidence) -> _Found:
    static = float(np.median(e.trace.rest.tension))
    lowest = e.slide.tension_low / e.highest_ratio / (1.0 + e.settings.load_tolerance)
    highest = e.slide.tension_low * e.highest_ratio
    if lowest <= static <= highest:
        return None
    return PointVerdict.REJECTED, (
        f"before motion: expected {lowest:.2f} .. {highest:.2f} N for {_grams(e.slide.tension_low)} hung, "
        f"found {static:.2f} N; hang the weight that was asked for"
    )


def _read_often_enough(e: _Evidence) -> _Found:
    if len(e.tension) >= e.settings.min_samples:
        return None
    return PointVerdict.REPEAT, _too_few(len(e.tension), e.settings)


def _window_long_enough(e: _Evidence) -> _Found:
    length = e.slide.window_end - e.slide.window_start
    if length >= e.settings.shortest_window:
        return None
    return PointVerdict.REPEAT, (
        f"expected {e.settings.shortest_window * 1e3:g} mm of steady sliding, found {length * 1e3:.1f} mm; "
        "lengthen the stroke or check the cable"
    )


def _steady(e: _Evidence) -> _Found:
    length = e.slide.window_end - e.slide.window_start
    change = abs(e.slide.drift) * length / e.mean if e.mean > 0.0 else math.inf
    if change > e.settings.drift_limit:
        return PointVerdict.REPEAT, (
            f"T1 drifts by {change:.1%} over the window (limit {e.settings.drift_limit:.0%}); "
            "let the gauge warm up, check that the cable runs freely"
        )
    if e.slide.stick_slip > e.settings.stick_slip_limit * e.mean:
        return PointVerdict.REPEAT, (
            f"stick-slip of {e.slide.stick_slip / e.mean:.1%} (limit {e.settings.stick_slip_limit:.0%}); "
            "pull slower, check the cable"
        )
    return None


def _sliding_load(e: _Evidence) -> _Found:
    """Pulling gives T2 Rf, letting back about T2 / Rf: their geometric mean is the hung weight, whatever Rf is."""
    release = e.trace.release
    late = release.travel <= release.travel[-1] + 0.3 * (release.travel[0] - release.travel[-1])
    back = float(np.median(release.tension[late]))
    if back <= 0.0:
        return PointVerdict.REPEAT, f"expected tension going back, found {back:.2f} N; check the weight and the tare"
    hung = math.sqrt(e.mean * back)
    log_ratio = 0.5 * math.log(e.mean / back)
    # Friction is larger at the lower tension of the way back, so the mean comes out too small, by the square of ln Rf.
    shortfall = _LOW_TENSION_BIAS * log_ratio**2
    if -e.settings.load_tolerance - shortfall <= hung / e.slide.tension_low - 1.0 <= e.settings.load_tolerance:
        return None
    return PointVerdict.REJECTED, (
        f"expected {_grams(e.slide.tension_low)} hung, found about {_grams(hung)} (pulling {e.mean:.2f} N, "
        f"letting back {back:.2f} N); hang the weight that was asked for"
    )


def _believable(e: _Evidence) -> _Found:
    if LOWEST_RATIO <= e.slide.ratio <= e.highest_ratio:
        return None
    return PointVerdict.REPEAT, (
        f"expected T1/T2 within {LOWEST_RATIO} .. {e.highest_ratio:.2f}, found {e.slide.ratio:.3f}; "
        "check the angle, the weight and the tare"
    )


_CHECKS: tuple[Callable[[_Evidence], _Found], ...] = (
    _stuck,
    _static_load,
    _read_often_enough,
    _window_long_enough,
    _steady,
    _sliding_load,
    _believable,
)


def _grams(newtons: float) -> str:
    return f"{newtons / GRAVITY * 1e3:.0f} g"
