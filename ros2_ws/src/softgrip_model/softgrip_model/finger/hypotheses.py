# SPDX-License-Identifier: Apache-2.0
"""What each cause of a change does to a finger's closing, and how likely a cause makes what has changed.

A sensor's or an actuator's error (zero, cable, tension gain, camera, mounting) changes how the finger's own closing is
read: its effect follows from the calm closings and is exact. Friction and strips change the finger: their effect is the
kernel's, which knows it to some tens of per cent, and smoothly along the closing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyder, polyfit, polyval
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.hand import Softening
from softgrip_model.finger.learning import Expectation
from softgrip_model.finger.uncertainty import Causes

Array = NDArray[np.float64]


class Cause(StrEnum):
    """What may have changed."""

    FRICTION = "friction"
    STIFFNESS = "stiffness"
    TEMPERATURE = "temperature"
    CONDITIONS = "speed or rest"
    RUNNING_IN = "running-in"
    STRIP = "one strip"
    ZERO = "zero"
    CABLE = "cable's stretch"
    TENSION_GAIN = "tension gain"
    CAMERA = "camera"
    OUT_OF_PLANE = "out of plane"
    NONE_OF_THESE = "none of these"


#: Standard deviation of each amount before anything was seen, in its own unit.
_FRICTION_SD, _STIFFNESS_SD, _STRIP_SD, _GAIN_SD = 0.25, 0.10, 0.30, 0.10
_ZERO_SD_MM, _CABLE_SD_MM_PER_N = 0.6, 0.10
_CAMERA_SD = (1.0, 1.0, 0.01, 0.015)  # x, y [mm], scale, turn [rad]
# softer as one; from a closing's middle to its end; share of the mean tension that is missing all along
_RELAXED_SD = (_STIFFNESS_SD, 0.05, 0.05)
# out of plane: larger by so much a `_TILT_MM` of y, which 9 degrees are to a camera that is 0.22 m away; and along x
# and y by so much of y, as the camera looks from beside the base, and y is foreshortened
_PLANE_SD, _TILT_MM = (0.07, 0.04, 0.04), 100.0

#: Gauss-Newton steps for a cause's amounts, and the change [prior deviations] at which they have settled.
_MAX_STEPS, _SETTLED = 6, 0.02
#: Of a finite difference [prior deviations].
_DIFFERENCE = 0.02
#: An amount explains nothing below this fall of the squared residuals.
_MIN_FALL = 6.0
#: Friction and moduli keep at least this share of themselves.
_MIN_SHARE = 0.1
#: Degree of the polynomial in the pulled length that calm residuals follow.
_DEGREE = 3
#: Degree of the polynomial that the kernel's error follows.
_SMOOTH = 5
#: [mm] beyond its closings a finger is as at their end; further out errors are so much larger.
_SAME_MM, _GUESS = 0.1, 10.0


@dataclass(frozen=True, eq=False)
class OwnClosing:
    """How a finger closes, as its calm closings have it: the learnt kernel, and a polynomial that it leaves.

    Attributes:
        mean: (N,) learnt deviations.
        pulled_mm, predicted_n: (K,) of the samples.
        left: (3 K,) mean residual of calm closings.
    """

    causes: Causes
    mean: Array
    pulled_mm: Array
    predicted_n: Array
    left: Array

    @cached_property
    def value(self) -> Array:
        """As `at` gives it for the finger unchanged."""
        found = self.at(self.pulled_mm)
        return np.zeros(3 * len(self.pulled_mm)) if found is None else found

    def at(self, pulled_mm: Array, causes: Causes | None = None, mean: Array | None = None) -> Array | None:
        """Return tips and tensions (3 K,), maybe of a changed finger; None: it has no equilibrium there."""
        closing = [
            ClosingInstant(0, max(0.0, float(pull)), np.zeros(2), 0.0, float(expected))
            for pull, expected in zip(pulled_mm, self.predicted_n, strict=True)
        ]
        found = Expectation.of(causes or self.causes, self.mean if mean is None else mean, closing)
        if found is None:
            return None
        left = self._left(pulled_mm)
        return np.asarray(found.value + np.concatenate([left[:, :2].ravel(), left[:, 2]]))

    def _left(self, pulled_mm: Array) -> Array:
        """Return what the kernel leaves of tips and tension (K, 3); beyond the samples it goes on straight."""
        first, last = float(self.pulled_mm[0]), float(self.pulled_mm[-1])
        scaled = (2.0 * pulled_mm - first - last) / (last - first)
        inside, (value, rate) = np.clip(scaled, -1.0, 1.0), self._polynomials
        return np.asarray(polyval(inside, value).T + (scaled - inside)[:, None] * polyval(inside, rate).T)

    @cached_property
    def _polynomials(self) -> tuple[Array, Array]:
        """Those of tip x, tip y and tension (D + 1, 3), and their derivatives, of pulled lengths scaled to -1 to 1."""
        count = len(self.pulled_mm)
        each = np.column_stack([self.left[: 2 * count].reshape(-1, 2), self.left[2 * count :]])
        first, last = float(self.pulled_mm[0]), float(self.pulled_mm[-1])
        scaled = (2.0 * self.pulled_mm - first - last) / (last - first)
        value: Array = np.asarray(polyfit(scaled, each, min(_DEGREE, count - 1)), np.float64)
        return value, np.asarray(polyder(value), np.float64)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause of unknown amounts.

    Attributes:
        cause: that it is.
        stddev: (a,) of the amounts before anything was seen.
        effect: amounts (a,) -> what they change of a closing (3 K,); None: no equilibrium.
        words: form of the first amount, for people.
        guessed: amounts -> samples (K,) whose effect lies beyond all that was seen of the finger; None: none.
        certain: amounts -> what of the effect holds whatever the kernel gets wrong, (3 K,); None: nothing.
        sign: +1 or -1: only amounts of that sign are this cause.
        log_odds: of the cause before anything was seen, beside the others.
    """

    cause: Cause
    stddev: Array
    effect: Callable[[Array], Array | None]
    words: str = "{:+.0%}"
    guessed: Callable[[Array], NDArray[np.bool_]] | None = None
    certain: Callable[[Array], Array] | None = None
    sign: int = 0
    log_odds: float = 0.0

    def errors(self, amounts: Array, effect: Array) -> Array:
        """Return how the kernel's part of the effect may be wrong, (3 K, D), by its own size."""
        doubtful = effect if self.certain is None else effect - self.certain(amounts)
        shapes = _smooth(doubtful)
        if self.guessed is None:
            return shapes
        guessed = self.guessed(amounts)
        rows = np.concatenate([np.repeat(guessed, 2), guessed])
        return np.column_stack([shapes, _GUESS * np.diag(np.abs(doubtful))[:, rows]])

    def slopes(self, amounts: Array, effect: Array) -> Array | None:
        """Return the effect's change per prior deviation of each amount, (3 K, a)."""
        columns = []
        for step in _DIFFERENCE * np.diag(self.stddev):
            moved = self.effect(amounts + step)
            if moved is None:
                return None
            columns.append((moved - effect) / _DIFFERENCE)
        return np.column_stack(columns)

    @cached_property
    def first_slopes(self) -> Array | None:
        """Those of no change, whose effect is none."""
        return self.slopes(np.zeros(len(self.stddev)), np.zeros(1))


def hypotheses(own: OwnClosing, softening: Cause, softening_odds: float) -> list[Hypothesis]:
    """Return all causes.

    Args:
        own: the finger's closing.
        softening: what a common change of the strips' moduli is called, by how the closing was made,
        softening_odds: and the logarithm of its odds.
    """
    causes, one = own.causes, np.ones(1)

    def of(cause: Cause, stddev: float, effect: Callable[[float], Array | None], **rest: object) -> Hypothesis:
        return Hypothesis(cause, stddev * one, lambda amounts: effect(float(amounts[0])), **rest)  # type: ignore[arg-type]

    def learnt(place: int, unit: float) -> Callable[[float], Array | None]:
        direction = np.eye(len(own.mean))[place] / unit
        return lambda amount: _less(
            own.at(own.pulled_mm, mean=own.mean + max(amount, _MIN_SHARE - 1.0) * direction), own
        )

    in_proportion = proportional(own, softening, softening_odds)
    found = [
        in_proportion,
        of(Cause.FRICTION, _FRICTION_SD, learnt(causes.factor, causes.prior.friction)),
        of(
            softening,
            _STIFFNESS_SD,
            learnt(causes.factor + 1, causes.prior.stiffness),
            certain=in_proportion.effect,
            log_odds=softening_odds,
        ),
        _relaxed(own, learnt(causes.factor + 1, causes.prior.stiffness), softening, softening_odds),
        of(
            Cause.ZERO,
            _ZERO_SD_MM,
            lambda mm: _less(own.at(own.pulled_mm + mm), own),
            words="{:+.2f} mm",
            guessed=lambda mm: own.pulled_mm + mm > own.pulled_mm[-1] + _SAME_MM,
        ),
        of(Cause.CABLE, _CABLE_SD_MM_PER_N, _stretched(own), words="{:+.3f} mm/N", sign=1),
        *_read_differently(own),
    ]
    for joint in range(causes.finger.joints):
        words = f"{{:+.0%}} of strip {joint}'s stiffness"
        odds = -math.log(causes.finger.joints)  # of this strip, if it is one
        found.append(of(Cause.STRIP, _STRIP_SD, _narrower(own, joint), words=words, sign=-1, log_odds=odds))
    return found


def _less(changed: Array | None, own: OwnClosing) -> Array | None:
    return None if changed is None else changed - own.value


def _stretched(own: OwnClosing) -> Callable[[float], Array | None]:
    """The pull that is lost to a cable that gives more: per tension, which falls with it."""
    count = len(own.pulled_mm)

    def effect(mm_per_n: float) -> Array | None:
        tension_n = own.value[2 * count :]
        for _ in range(2):
            changed = own.at(own.pulled_mm - mm_per_n * tension_n)
            if changed is None:
                return None
            tension_n = changed[2 * count :]
        return _less(changed, own)

    return effect


def _narrower(own: OwnClosing, joint: int) -> Callable[[float], Array | None]:
    """A strip that has lost some of its width, as by a crack from its edge."""
    causes, widths = own.causes, np.array(own.causes.finger.widths_mm)

    def effect(share: float) -> Array | None:
        factor = np.where(np.arange(len(widths)) == joint, max(1.0 + share, _MIN_SHARE), 1.0)
        finger = dataclasses.replace(causes.finger, strip_width_mm=tuple(float(w) for w in widths * factor))
        return _less(own.at(own.pulled_mm, dataclasses.replace(causes, finger=finger)), own)

    return effect


def proportional(own: OwnClosing, softening: Cause, log_odds: float) -> Hypothesis:
    """Return softer strips where friction does not depend on the tension: all tensions in proportion, tips as before.

    No mechanics is needed for that. What else the kernel says of softer strips hangs on the learnt stretch of the cable
    and on how friction depends on the tension.
    """
    change = own.value.copy()
    change[: 2 * len(own.pulled_mm)] = 0.0

    def effect(amounts: Array) -> Array:
        return np.asarray(change * amounts[0])

    return Hypothesis(softening, np.array([_STIFFNESS_SD]), effect, certain=effect, log_odds=log_odds)


def _relaxed(own: OwnClosing, softer: Callable[[float], Array | None], softening: Cause, log_odds: float) -> Hypothesis:
    """Return strips that relax more or less than usual.

    They are softer as one, the more the longer the closing has lasted, and bent already at its begin by what has not
    recovered since the last one: no material's law is needed for that.
    """
    tips = 2 * len(own.pulled_mm)
    tension_n = own.value[tips:]
    drift, offset = np.zeros((2, len(own.value)))
    drift[tips:] = tension_n * np.linspace(-1.0, 1.0, len(tension_n))
    offset[tips:] = tension_n.mean()

    def effect(amounts: Array) -> Array | None:
        changed = softer(float(amounts[0]))
        return None if changed is None else changed + drift * amounts[1] + offset * amounts[2]

    return Hypothesis(softening, np.array(_RELAXED_SD), effect, log_odds=log_odds)


def _read_differently(own: OwnClosing) -> Iterator[Hypothesis]:
    """Yield what leaves the finger as it is: the motor's gain, the camera's plane, a finger turned out of it."""
    tips = 2 * len(own.pulled_mm)
    x, y, tension = own.value[:tips:2], own.value[1:tips:2], own.value[tips:]
    columns = np.zeros((len(own.value), 8))
    columns[:tips:2, 0] = 1.0
    columns[1:tips:2, 1] = 1.0
    columns[:tips, 2] = own.value[:tips]
    columns[:tips:2, 3], columns[1:tips:2, 3] = -y, x
    columns[tips:, 4] = tension
    # A finger that leans by a small angle a comes nearer to the camera by a y, and is seen larger about the point below
    # it, (c, d) of a camera at a distance h: x (1 + a y / h) - c a y / h, y (1 + a y / h) - d a y / h.
    columns[:tips:2, 5], columns[1:tips:2, 5] = x * y / _TILT_MM, y * y / _TILT_MM
    columns[:tips:2, 6] = -y
    columns[1:tips:2, 7] = -y

    def linear(cause: Cause, place: slice, stddev: Sequence[float], words: str) -> Hypothesis:
        def effect(amounts: Array) -> Array:
            return np.asarray(columns[:, place] @ amounts)

        return Hypothesis(cause, np.array(stddev), effect, words, certain=effect)

    yield linear(Cause.TENSION_GAIN, slice(4, 5), (_GAIN_SD,), "{:+.0%}")
    yield linear(Cause.CAMERA, slice(0, 4), _CAMERA_SD, "x {:+.1f} mm, y {:+.1f} mm, scale {:+.1%}, turn {:+.3f} rad")
    yield linear(Cause.OUT_OF_PLANE, slice(5, 8), _PLANE_SD, f"seen {{:+.1%}} larger for {_TILT_MM:g} mm to its side")


@dataclass(frozen=True, eq=False)
class Weighed:
    """A cause beside what was seen.

    Attributes:
        log_ratio: of its marginal likelihood to that of no change, with its odds.
        amounts: (a,) likeliest, own units.
        deviation: of the first.
        remaining: squared residuals that it leaves, in standard deviations.
    """

    hypothesis: Hypothesis
    log_ratio: float
    amounts: Array
    deviation: float
    remaining: float

    @property
    def words(self) -> str:
        """The amounts, for people."""
        return self.hypothesis.words.format(*self.amounts)

    @property
    def softening(self) -> Softening:
        """The first amount, for a comparison with the hand's other fingers."""
        return Softening(float(self.amounts[0]), self.deviation)

    def known(self, cause: Cause, log_odds: float) -> Weighed:
        """Return it as a cause with other odds."""
        hypothesis = dataclasses.replace(self.hypothesis, cause=cause, log_odds=log_odds)
        return dataclasses.replace(
            self, hypothesis=hypothesis, log_ratio=self.log_ratio + log_odds - self.hypothesis.log_odds
        )


def weigh(hypothesis: Hypothesis, residual: Array, root: Array, model_errors: Sequence[float]) -> Weighed | None:
    """Weigh a cause; None where it has no amount of the right sign.

    Its likelihood is marginal over its amounts, about the likeliest (Laplace), and over the kernel's error: each of
    tip x, tip y and tension of its effect is wrong by a factor that is a quadratic of the pulled length, whose
    coefficients deviate by any of `model_errors`, alike likely (MacKay, Neural Computation 4 (1992) 415).

    Args:
        hypothesis: the cause.
        residual: (3 K,) what has changed.
        root: (3 K, 3 K) lower triangular: root root' is the covariance of chance.
        model_errors: relative.
    """
    stddev, errors = hypothesis.stddev, tuple(model_errors)

    def white(columns: Array) -> Array:
        return np.asarray(solve_triangular(root, columns, lower=True, check_finite=False))

    seen, amounts = white(residual), np.zeros(len(stddev))
    effect, slopes = np.zeros(len(residual)), hypothesis.first_slopes
    if slopes is None:
        return None
    slope, shape = white(slopes), np.zeros((len(residual), 0))
    for _ in range(_MAX_STEPS):
        linear = seen - white(effect) + slope @ (amounts / stddev)
        moved = stddev * _posterior(slope, np.column_stack([errors[0] * shape]), linear)
        step = moved - amounts
        if not amounts.any() and float(linear @ slope @ (moved / stddev)) < _MIN_FALL:
            break
        if float(np.abs(step / stddev).max()) < _SETTLED:
            break
        changed = None
        for _ in range(4):
            changed = hypothesis.effect(amounts + step)
            further = None if changed is None else hypothesis.slopes(amounts + step, changed)
            if changed is not None and further is not None:
                break
            changed, step = None, 0.5 * step
        if changed is None or further is None:
            return None
        amounts, effect, slope = amounts + step, changed, white(further)
        shape = white(hypothesis.errors(amounts, effect))
    if hypothesis.sign * float(amounts[0]) < 0.0:
        return None
    linear = seen - white(effect) + slope @ (amounts / stddev)
    ratios, remains = [], []
    for error in errors:
        quadratic, determinant = _gaussian(np.column_stack([slope, error * shape]), linear)
        ratios.append(0.5 * (float(seen @ seen) - quadratic - determinant))
        remains.append(_gaussian(error * shape, seen - white(effect))[0])
    best = int(np.argmax(ratios))
    ratio = ratios[best] + math.log(float(np.mean(np.exp(np.array(ratios) - ratios[best]))))
    deviation = float(stddev[0] * math.sqrt(np.linalg.inv(np.eye(slope.shape[1]) + slope.T @ slope)[0, 0]))
    return Weighed(hypothesis, ratio + hypothesis.log_odds, amounts, deviation, remains[best])


def _smooth(effect: Array) -> Array:
    """Return how an effect may be wrong, (3 K, 3 D): each of tip x, tip y and tension by a smooth factor."""
    samples = len(effect) // 3
    legendre = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, samples), _SMOOTH) / np.arange(1, _SMOOTH + 2)
    shapes = np.zeros((len(effect), 3 * (_SMOOTH + 1)))
    for axis, rows in enumerate((slice(0, 2 * samples, 2), slice(1, 2 * samples, 2), slice(2 * samples, None))):
        shapes[rows, axis::3] = effect[rows, None] * legendre
    return shapes


def _posterior(slope: Array, errors: Array, seen: Array) -> Array:
    """Return the mean of amounts z ~ N(0, 1) in seen = slope z + errors e + noise, e and noise ~ N(0, 1)."""
    both = np.column_stack([slope, errors])
    kept = np.eye(both.shape[1]) + both.T @ both
    return np.asarray(np.linalg.solve(kept, both.T @ seen)[: slope.shape[1]])


def _gaussian(columns: Array, seen: Array) -> tuple[float, float]:
    """Return quadratic form and log-determinant of seen ~ N(0, 1 + columns columns')."""
    kept = np.eye(columns.shape[1]) + columns.T @ columns
    onto = columns.T @ seen
    return float(seen @ seen - onto @ np.linalg.solve(kept, onto)), float(np.linalg.slogdet(kept)[1])
