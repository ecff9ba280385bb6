# SPDX-License-Identifier: Apache-2.0
"""What one finger touches: a statistical test on its tension beside the predicted one, and on its seen fingertip.

The free motion of a finger is predicted as y = f + o + b with a variance: f is finger/predicted, o the table that the
check after the swap learned for this very finger, b the creep of this closing, followed by a scalar Kalman filter. The
contact tension is what is measured beside it,

    x_k = y_k - (f_k + o_k + b_k) = c_k + m + w_k,   m ~ N(0, s_m^2),   w_k ~ N(0, s_w^2),

with the contact c >= 0 of unknown size and onset, the error m that all readings of a moment share (creep, table, pulled
length, a drive that catches up after a late goal) and the noise w of each. The generalised likelihood ratio of a
contact over the last n readings against free motion (Willsky and Jones 1976, A generalized likelihood ratio approach
to the detection and estimation of jumps in linear systems) is, in its logarithm,

    l = max_n  mean(x)^2 / (2 (s_m^2 + s_w^2 / n)),   mean(x) >= min_contact_tension_n,

and a finger is in contact while l reaches the level that the stated false-alarm rate asks for. How long a contact has
to last follows: a strong one is decided by few readings, a weak one by as many as it takes to average the noise. One
reading alone proves no more than that it is not one of the wild ones (wild_share). The onset is sought after the last
zero of the cumulative sum (CUSUM; Page 1954, Continuous inspection schemes) for the smallest contact.

The distance of a seen fingertip from its predicted place is tested against the same level.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median
from typing import Final

from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.observation import ObservedPair, SeenTip
from softgrip_time.units import to_ns, to_s

#: Period of tendon/state before two samples have shown it [s].
FIRST_PERIOD_S: Final = 0.01

#: The period is the median of so many intervals, whatever single ones are.
PERIOD_INTERVALS: Final = 9


class ContactState(StrEnum):
    """What a finger does. END_STOP and BLOCKED are facts of where it is, CONTACT and FREE of what it feels there."""

    UNKNOWN = "unknown"  # not closed far enough for its tension to show a contact
    FREE = "free"
    CONTACT = "contact"  # touches something in the last bit of its path, where its own stops may hold it
    BLOCKED = "blocked"  # touches something short of its end
    END_STOP = "end_stop"  # closed as far as it may: its tension shows nothing


@dataclass(frozen=True)
class FingerContact:
    """One finger at one instant.

    Attributes:
        state: see ContactState.
        pulled_length_m: pulled length [m].
        tension_n: measured [N].
        free_n: expected of this very finger in this closing if it touched nothing [N].
        contact_tension_n: their difference [N].
        stddev_n: of a single contact tension while nothing is touched [N].
        threshold_n: contact tension from which a single reading speaks for a contact at the level of the test [N].
        punctual_threshold_n: the same without what a late drive adds: that this moment is uncertain is no loss [N].
        strength_n: contact tension that all the readings show which a decision takes at least [N].
        force_n: greatest contact force that this contact tension can mean [N].
        log_likelihood: of a contact against free motion.
        is_touching: the test decides for a contact by tension.
        is_deflected: the test decides for a contact by the seen fingertip.
        since_ns: stamp of the first reading of this contact; None without one.
        is_short: the finger is so far short of its end that its own stops do not hold it.
        is_at_end: it has closed as far as it may.
    """

    state: ContactState
    pulled_length_m: float
    tension_n: float
    free_n: float
    contact_tension_n: float
    stddev_n: float
    threshold_n: float
    punctual_threshold_n: float
    strength_n: float
    force_n: float
    log_likelihood: float
    is_touching: bool
    is_deflected: bool = False
    since_ns: int | None = None
    is_short: bool = True
    is_at_end: bool = False

    @property
    def is_judged(self) -> bool:
        """Whether it has closed far enough for its tension to show a contact."""
        return self.state is not ContactState.UNKNOWN

    @property
    def is_at_threshold(self) -> bool:
        """Whether this very reading is at the threshold: what protects a product does not wait for the test."""
        return self.is_judged and self.contact_tension_n >= self.threshold_n


class RiseTest:
    """Generalised likelihood ratio of a rise of unknown size and onset (see the module).

    Args:
        settings: the level, and what a single reading proves.
    """

    def __init__(self, settings: GraspSettings) -> None:
        self._settings = settings
        self._readings: deque[tuple[int, float]] = deque()
        self._cumulated = 0.0
        self.log_likelihood = 0.0
        self.is_decided = False
        self.strength_n = -math.inf
        self.since_ns: int | None = None

    def clear(self) -> None:
        """Begin again: nothing of before counts."""
        self._readings.clear()
        self._cumulated = 0.0
        self.log_likelihood, self.is_decided, self.strength_n, self.since_ns = 0.0, False, -math.inf, None

    def observe(self, now_ns: int, value_n: float, noise_n: float, model_n: float, period_s: float) -> None:
        """Take a reading.

        Args:
            now_ns: its stamp.
            value_n: contact tension [N].
            noise_n: standard deviation of each reading by itself [N].
            model_n: standard deviation of the error that all readings of the window share [N].
            period_s: of the readings [s].
        """
        settings, level = self._settings, self._settings.decision_level(period_s)
        needed, proof = settings.decision_samples(period_s), math.log(1.0 / settings.wild_share)
        smallest_n = settings.min_contact_tension_n
        gain = smallest_n * (value_n - 0.5 * smallest_n) / (noise_n**2 + model_n**2)
        self._cumulated = min(level, self._cumulated + max(-proof, min(proof, gain)))
        if self._cumulated <= 0.0:
            self.clear()
            return
        self.since_ns = now_ns if self.since_ns is None else self.since_ns
        self._readings.append((now_ns, value_n))
        oldest_ns = now_ns - to_ns(settings.test_window_s)
        while len(self._readings) > needed and self._readings[0][0] < oldest_ns:
            self._readings.popleft()
        self.log_likelihood, total_n = 0.0, 0.0
        for count, (_, reading_n) in enumerate(reversed(self._readings), start=1):
            total_n += reading_n
            mean_n = total_n / count
            if mean_n >= smallest_n:
                ratio = mean_n**2 / (2.0 * (model_n**2 + noise_n**2 / count))
                self.log_likelihood = max(self.log_likelihood, min(ratio, count * proof))
        self.is_decided = self.log_likelihood >= level
        latest = [reading_n for _, reading_n in self._readings][-needed:]
        self.strength_n = min(latest) if len(latest) == needed else -math.inf


def threshold(settings: GraspSettings, noise_n: float, model_n: float, period_s: float) -> float:
    """Return the contact tension of one reading whose likelihood ratio is at the level of the test [N]."""
    sigmas = math.sqrt(2.0 * settings.decision_level(period_s))
    return max(settings.min_contact_tension_n, sigmas * math.hypot(noise_n, model_n))


class CreepFilter:
    """Follows what this closing's free tension is beside the reference: a scalar Kalman filter over the pulled length.

    Printed TPU creeps: a finger that was closed a moment ago needs up to a newton less than in its check, all the way.
    Nothing of that can be predicted, but it is there before anything is touched. Creep changes by creep_slope_n_per_m
    at most (1 sigma of the process, and the bound of a correction), which a contact exceeds; a difference near the
    contact threshold is not followed.
    """

    def __init__(self, settings: GraspSettings) -> None:
        self._settings = settings
        self._first_n: deque[float] = deque(maxlen=settings.creep_samples)
        self._pulled_length_m: float | None = None
        self.value_n = 0.0
        self.variance_n2 = 0.0

    def prepare(self, difference_n: float) -> None:
        """Take a difference [N] of measured and expected tension from where no contact is looked for yet."""
        self._first_n.append(difference_n)

    def follow(self, difference_n: float, pulled_length_m: float, variance_n2: float, threshold_n: float) -> None:
        """Correct the creep by a difference [N] of measured and expected tension, with its variance [N^2]."""
        settings = self._settings
        if self._pulled_length_m is None:
            self._first_n.append(difference_n)
            self.value_n = min(settings.max_creep_n, max(settings.min_creep_n, median(self._first_n)))
            self.variance_n2 = variance_n2
            self._pulled_length_m = pulled_length_m
        travel_m = pulled_length_m - self._pulled_length_m
        self._pulled_length_m = max(self._pulled_length_m, pulled_length_m)
        innovation_n = difference_n - self.value_n
        if travel_m <= 0.0:
            return
        max_step_n = settings.creep_slope_n_per_m * travel_m
        self.variance_n2 += max_step_n**2
        if innovation_n < settings.quiet_share * threshold_n:
            gain = self.variance_n2 / (self.variance_n2 + variance_n2)
            step_n = max(-max_step_n, min(max_step_n, gain * innovation_n))
            self.value_n = max(settings.min_creep_n, self.value_n + step_n)
            self.variance_n2 *= 1.0 - gain


class LateDrive:
    """Widens the uncertainty of a tension while a drive catches up after a late goal.

    A servo under proportional control whose next goal is late falls back, and then pulls as hard as it is behind. The
    samples of a loop that is late show it: their interval is longer than the others'.
    """

    def __init__(self, settings: GraspSettings) -> None:
        self._settings = settings
        self._intervals_s: deque[float] = deque(maxlen=PERIOD_INTERVALS)
        self._last: tuple[int, tuple[float, ...]] | None = None
        self.stddev_n: tuple[float, ...] = ()

    @property
    def period_s(self) -> float:
        """Usual interval of the samples [s]."""
        return median(self._intervals_s) if self._intervals_s else FIRST_PERIOD_S

    def observe(self, now_ns: int, pulled_length_m: Sequence[float]) -> None:
        """Take a sample's stamp and pulled lengths [m]."""
        if self._last is None:
            self.stddev_n = (0.0,) * len(pulled_length_m)
        else:
            before_ns, before_m = self._last
            interval_s = to_s(now_ns - before_ns)
            self._intervals_s.append(interval_s)
            late_s = max(0.0, interval_s - self.period_s)
            kept = math.exp(-interval_s / self._settings.drive_settling_s)
            self.stddev_n = tuple(
                math.hypot(
                    kept * stddev_n,
                    self._settings.drive_stiffness_n_per_m * abs(now_m - then_m) * late_s / interval_s,
                )
                for stddev_n, now_m, then_m in zip(self.stddev_n, pulled_length_m, before_m, strict=True)
            )
        self._last = (now_ns, tuple(pulled_length_m))


class TipTest:
    """Compares seen fingertips with predicted ones, at the level of the tension's test.

    A finger that has nothing in its way takes the predicted shape whatever its tension. One that is bent by a product
    is tens of millimetres off at the same pulled length, where its tension says little, as free motion is not what it
    does. A distance in the plane exceeds r with exp(-r^2 / 2 s^2) (Rayleigh), so r^2 / 2 s^2 is compared with the level
    itself; s is chosen so that tip_m is at the level for a camera without error.

    Beyond the path that the check covered nobody has seen the finger: it may stand at its stops there, or go on. So
    tip_m grows there by the way that is predicted from the end of that path, up to tip_unchecked_factor times itself.
    """

    def __init__(self, slots: Sequence[str], references: Sequence[FreeReference], settings: GraspSettings) -> None:
        self._slots = tuple(slots)
        self._references = tuple(references)
        self._settings = settings
        self._pairs: deque[ObservedPair] = deque()
        self._checked_tip_m: dict[int, tuple[float, float]] = {}  # predicted, where each finger last was on that path
        self._seen: dict[int, tuple[int, float, float]] = {}

    def predict(self, pair: ObservedPair) -> None:
        """Take a tendon sample with its prediction."""
        self._pairs.append(pair)
        for slot, reference in enumerate(self._references):
            if pair.sample.pulled_length_m[slot] <= reference.reach_m:
                self._checked_tip_m[slot] = pair.free.tip_m[slot]
        keep_s = self._settings.tip_pair_s + self._settings.tip_fresh_s
        while self._pairs[0].sample.stamp_ns < pair.sample.stamp_ns - to_ns(keep_s):
            self._pairs.popleft()

    def observe(self, tip: SeenTip, period_s: float = FIRST_PERIOD_S) -> None:
        """Take a fingertip; one without a prediction of its time is left out."""
        if tip.slot not in self._slots or not self._pairs:
            return
        slot = self._slots.index(tip.slot)
        pair = min(self._pairs, key=lambda each: abs(each.sample.stamp_ns - tip.stamp_ns))
        if abs(pair.sample.stamp_ns - tip.stamp_ns) > to_ns(self._settings.tip_pair_s):
            return
        deviation_m = math.dist(tip.tip_m, pair.free.tip_m[slot])
        if math.isfinite(deviation_m):
            level = self._settings.decision_level(period_s)
            max_m = self._tolerance_m(slot, pair)
            camera_m = tip.stddev_m if math.isfinite(tip.stddev_m) else 0.0
            variance_m2 = max_m**2 / (2.0 * level) + camera_m**2
            self._seen[slot] = (tip.stamp_ns, deviation_m, deviation_m**2 / (2.0 * variance_m2 * level))

    def _tolerance_m(self, slot: int, pair: ObservedPair) -> float:
        """Return the distance [m] of a fingertip from its predicted place that is called a contact there."""
        settings = self._settings
        if pair.sample.pulled_length_m[slot] <= self._references[slot].reach_m:
            return settings.tip_m
        max_m = settings.tip_m * settings.tip_unchecked_factor
        way_m = math.dist(pair.free.tip_m[slot], self._checked_tip_m.get(slot, (math.nan, math.nan)))
        return min(max_m, settings.tip_m + way_m) if math.isfinite(way_m) else max_m

    def deviation_m(self, now_ns: int) -> dict[int, float]:
        """Return the distance of every slot's fingertip that was seen a moment ago from its predicted place [m]."""
        fresh_ns = now_ns - to_ns(self._settings.tip_fresh_s)
        return {slot: deviation_m for slot, (at_ns, deviation_m, _) in self._seen.items() if at_ns >= fresh_ns}

    def deflected(self, now_ns: int) -> frozenset[int]:
        """Return the slots whose finger is bent by something."""
        fresh = self.deviation_m(now_ns)
        return frozenset(slot for slot, (_, _, ratio) in self._seen.items() if slot in fresh and ratio >= 1.0)


class ContactEstimator:
    """Turns paired observations into contacts.

    The contact force follows from virtual work: pulling dL moves a contact at the fingertip by ds, so that the contact
    tension * dL >= force * ds; friction in the finger only lowers the force. ds/dL is taken from the predicted tip
    path, and lever_factor allows for contacts nearer to the base, which move less.

    Args:
        slots: names, in slot order.
        references: free motion of the finger in each slot.
        paths_m: end of each finger's path [m].
        settings: of the test.
    """

    def __init__(
        self,
        slots: Sequence[str],
        references: Sequence[FreeReference],
        paths_m: Sequence[float],
        settings: GraspSettings,
    ) -> None:
        self._references = tuple(references)
        self._paths_m = tuple(paths_m)
        self._settings = settings
        self._levers = [settings.lever_start] * len(self._references)
        self._anchors: list[tuple[float, tuple[float, float]] | None] = [None] * len(self._references)
        self._creep = [CreepFilter(settings) for _ in self._references]
        self._tests = [RiseTest(settings) for _ in self._references]
        self._late = LateDrive(settings)
        self._tips = TipTest(slots, references, settings)

    @property
    def decision_samples(self) -> int:
        """Readings that a decision takes at least."""
        return self._settings.decision_samples(self._late.period_s)

    def observe_tip(self, tip: SeenTip) -> None:
        """Take a fingertip that the camera has seen; the next sample is judged with it."""
        self._tips.observe(tip, self._late.period_s)

    def tip_deviation_m(self, now_ns: int) -> dict[int, float]:
        """Return how far the fingertips seen a moment ago are from their predicted places, by slot [m]."""
        return self._tips.deviation_m(now_ns)

    def estimate(self, pair: ObservedPair, commanded: Collection[int] = ()) -> tuple[FingerContact, ...]:
        """Return the contact of every slot.

        Args:
            pair: sample and prediction.
            commanded: slots that keep a tension: their motion is not free, their creep stays as it is.
        """
        self._tips.predict(pair)
        self._late.observe(pair.sample.stamp_ns, pair.sample.pulled_length_m)
        deflected = self._tips.deflected(pair.sample.stamp_ns)
        return tuple(
            self._estimate_slot(slot, pair, slot not in commanded, slot in deflected)
            for slot in range(len(self._references))
        )

    def contact_tension_limit_n(self, slot: int, force_limit_n: float) -> float:
        """Return the contact tension that may mean a contact force limit [N]."""
        return force_limit_n * self._levers[slot] / self._settings.lever_factor

    def _estimate_slot(self, slot: int, pair: ObservedPair, is_closing: bool, is_deflected: bool) -> FingerContact:
        settings, reference, creep, test = self._settings, self._references[slot], self._creep[slot], self._tests[slot]
        pulled_length_m, tension_n = pair.sample.pulled_length_m[slot], pair.sample.tension_n[slot]
        predicted_n = pair.free.tension_n[slot]
        self._follow_tip(slot, pair.free.pulled_length_m[slot], pair.free.tip_m[slot])
        # Beyond the checked path the fingers press on something or stand at their stops: the table's end has to do.
        within = pulled_length_m <= reference.reach_m and math.isfinite(predicted_n)
        free_n = (
            max(0.0, predicted_n + reference.offset(pulled_length_m)) if within else reference.tension(pulled_length_m)
        )
        punctual_n = self._model_stddev_n(slot, pulled_length_m, free_n)
        late_n, period_s = self._late.stddev_n[slot], self._late.period_s
        model_n = math.hypot(punctual_n, late_n)
        is_judged = pulled_length_m >= settings.contact_from_m
        if within and is_closing and is_judged:
            max_n = threshold(settings, reference.stddev_n, model_n, period_s)
            # What the table lacks stays so for the next samples: it is for the creep to follow.
            creep.follow(tension_n - free_n, pulled_length_m, math.hypot(reference.stddev_n, late_n) ** 2, max_n)
        elif within and is_closing:
            creep.prepare(tension_n - free_n)
        free_n = max(0.0, free_n + creep.value_n)
        contact_tension_n = tension_n - free_n
        model_n = math.hypot(model_n, math.sqrt(creep.variance_n2))
        punctual_n = math.hypot(punctual_n, math.sqrt(creep.variance_n2))
        if is_judged:
            test.observe(pair.sample.stamp_ns, contact_tension_n, reference.stddev_n, model_n, period_s)
        else:
            test.clear()
        is_short = pulled_length_m <= self._paths_m[slot] - settings.min_blockage_m
        is_at_end = pulled_length_m >= self._paths_m[slot]
        is_deflected = is_deflected and is_judged
        return FingerContact(
            state=_state(is_judged, test.is_decided or is_deflected, is_short, is_at_end),
            pulled_length_m=pulled_length_m,
            tension_n=tension_n,
            free_n=free_n,
            contact_tension_n=contact_tension_n,
            stddev_n=math.hypot(reference.stddev_n, model_n),
            threshold_n=threshold(settings, reference.stddev_n, model_n, period_s),
            punctual_threshold_n=threshold(settings, reference.stddev_n, punctual_n, period_s),
            strength_n=test.strength_n,
            force_n=max(0.0, contact_tension_n) * settings.lever_factor / self._levers[slot],
            log_likelihood=test.log_likelihood,
            is_touching=test.is_decided,
            is_deflected=is_deflected,
            since_ns=test.since_ns if test.is_decided else None,
            is_short=is_short,
            is_at_end=is_at_end,
        )

    def _model_stddev_n(self, slot: int, pulled_length_m: float, free_n: float) -> float:
        """Standard deviation of what the free tension may be off by, beside the creep's and a late drive's [N]."""
        settings, reference = self._settings, self._references[slot]
        near_end = pulled_length_m > reference.reach_m - settings.end_m
        share = settings.end_error_share if near_end else settings.model_error_share
        length_n = settings.length_error_m * reference.slope(pulled_length_m)
        return math.hypot(share * free_n, length_n)

    def _follow_tip(self, slot: int, pulled_length_m: float, tip_m: tuple[float, float]) -> None:
        anchor = self._anchors[slot]
        if anchor is None:
            self._anchors[slot] = (pulled_length_m, tip_m)
        elif abs(pulled_length_m - anchor[0]) >= self._settings.lever_step_m:
            path_m = math.dist(tip_m, anchor[1])
            if math.isfinite(path_m) and path_m > 0.0:
                self._levers[slot] = path_m / abs(pulled_length_m - anchor[0])
            self._anchors[slot] = (pulled_length_m, tip_m)


def _state(is_judged: bool, is_touching: bool, is_short: bool, is_at_end: bool) -> ContactState:
    if not is_judged:
        return ContactState.UNKNOWN
    if is_at_end:
        return ContactState.END_STOP
    if not is_touching:
        return ContactState.FREE
    return ContactState.BLOCKED if is_short else ContactState.CONTACT
