# SPDX-License-Identifier: Apache-2.0
"""From a tendon sample and its prediction to the excess tension of every finger, and the contact force behind it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.observation import ObservedPair

#: Pulled length between two predictions from which the fingertip's path per pulled length is taken [m].
LEVER_STEP_M: Final = 0.0005

#: How far this closing may lie below and above the one that the reference was learned from [N]: printed TPU remembers.
BASELINE_LOW_N: Final = -2.0
BASELINE_HIGH_N: Final = 0.3

#: The baseline follows the free motion, but never as steeply as the softest contact rises [N per m of pulled length],
#: nor as a servo falls that waits for a late goal: what it lacks for some 30 ms would be felt as a touch ever after.
BASELINE_SLOPE_N_PER_M: Final = 120.0
BASELINE_SMOOTHING: Final = 0.3

#: It begins at the median of so many samples: such a servo falls back and catches up in fewer than half of them.
BASELINE_SAMPLES: Final = 7

#: Share of the contact threshold above which an excess is no free motion any more.
QUIET_SHARE: Final = 0.6

#: Fingertip path per pulled length before the fingers have moved [1]: low, so that forces are overstated at first.
LEVER_START: Final = 2.0


@dataclass(frozen=True)
class Reading:
    """One finger at one instant.

    Attributes:
        pulled_m: pulled length [m].
        tension_n: measured [N].
        free_n: expected of this very finger in this closing if it touched nothing [N].
        excess_n: their difference [N].
        threshold_n: excess that is taken for contact [N].
        force_n: greatest contact force that this excess can mean [N].
        judged: closed far enough for its tension to tell a contact.
    """

    pulled_m: float
    tension_n: float
    free_n: float
    contact_tension_n: float
    threshold_n: float
    force_n: float
    judged: bool = True

    @property
    def touching(self) -> bool:
        """More tension than free motion explains."""
        return self.contact_tension_n >= self.threshold_n and self.judged


class Baseline:
    """What this closing's tension is beside the reference while the finger still moves freely.

    Printed TPU creeps: a finger that was closed a moment ago needs up to a newton less than in its check, all the way.
    Nothing of that can be told beforehand, but it is there before anything is touched.
    """

    def __init__(self) -> None:
        self._value_n: float | None = None
        self._first_n: deque[float] = deque(maxlen=BASELINE_SAMPLES)
        self._pulled_m = 0.0

    @property
    def value_n(self) -> float:
        """Tension beside the reference [N]; 0 before the finger has moved far enough to tell."""
        return self._value_n or 0.0

    def prepare(self, difference_n: float) -> None:
        """Take a difference [N] of measured and expected tension from where no contact is looked for yet."""
        self._first_n.append(difference_n)

    def follow(self, difference_n: float, pulled_m: float, threshold_n: float) -> None:
        """Take a difference [N] of measured and expected tension at a pulled length [m]."""
        if self._value_n is None:
            self._first_n.append(difference_n)
            self._value_n = min(BASELINE_HIGH_N, max(BASELINE_LOW_N, median(self._first_n)))
            self._pulled_m = pulled_m
        travel_m = pulled_m - self._pulled_m
        self._pulled_m = max(self._pulled_m, pulled_m)
        off_n = difference_n - self._value_n
        if travel_m > 0.0 and off_n < QUIET_SHARE * threshold_n:
            max_n = BASELINE_SLOPE_N_PER_M * travel_m
            step_n = max(-max_n, min(max_n, BASELINE_SMOOTHING * off_n))
            self._value_n = max(BASELINE_LOW_N, self._value_n + step_n)


class Reader:
    """Turns paired observations into readings.

    The contact force follows from virtual work: pulling dL moves a contact at the fingertip by ds, so that excess * dL
    >= force * ds; friction in the finger only lowers the force. ds/dL is taken from the predicted tip path, and
    lever_factor allows for contacts nearer to the base, which move less.
    """

    def __init__(self, references: Sequence[FreeReference], settings: GraspSettings) -> None:
        self._references = tuple(references)
        self._settings = settings
        self._levers = [LEVER_START] * len(self._references)
        self._baselines = [Baseline() for _ in self._references]
        self._anchors: list[tuple[float, tuple[float, float]] | None] = [None] * len(self._references)

    def read(self, pair: ObservedPair, pressing: Collection[int] = ()) -> tuple[Reading, ...]:
        """Return the reading of every slot.

        Args:
            pair: sample and prediction.
            pressing: slots that keep a tension: their motion is no free one, their baseline stays as it is.
        """
        return tuple(self._read_slot(slot, pair, slot not in pressing) for slot in range(len(self._references)))

    def contact_tension_limit_n(self, slot: int, force_limit_n: float) -> float:
        """Return the excess tension that may mean a contact force limit [N]."""
        return force_limit_n * self._levers[slot] / self._settings.lever_factor

    def _read_slot(self, slot: int, pair: ObservedPair, closing: bool) -> Reading:
        settings, reference = self._settings, self._references[slot]
        pulled_m, tension_n = pair.sample.pulled_m[slot], pair.sample.tension_n[slot]
        predicted_n = pair.free.tension_n[slot]
        # Beyond the checked path the fingers press on something or stand at their stops: the table's end has to do.
        within = pulled_m <= reference.reach_m and math.isfinite(predicted_n)
        free_n = max(0.0, predicted_n + reference.offset(pulled_m)) if within else reference.tension(pulled_m)
        self._follow_tip(slot, pair.free.pulled_m[slot], pair.free.tip_m[slot])
        threshold_n = max(
            settings.contact_floor_n,
            settings.contact_sigma * reference.stddev_n,
            settings.contact_free_fraction * free_n,
            settings.length_error_m * reference.slope(pulled_m),
            settings.end_free_fraction * free_n if pulled_m > reference.reach_m - settings.end_m else 0.0,
        )
        judged = pulled_m >= settings.contact_from_m
        baseline = self._baselines[slot]
        if within and closing and judged:
            baseline.follow(tension_n - free_n, pulled_m, threshold_n)
        elif within and closing:
            baseline.prepare(tension_n - free_n)
        free_n = max(0.0, free_n + baseline.value_n)
        contact_tension_n = tension_n - free_n
        return Reading(
            pulled_m=pulled_m,
            tension_n=tension_n,
            free_n=free_n,
            contact_tension_n=contact_tension_n,
            threshold_n=threshold_n,
            force_n=max(0.0, contact_tension_n) * settings.lever_factor / self._levers[slot],
            judged=judged,
        )

    def _follow_tip(self, slot: int, pulled_m: float, tip_m: tuple[float, float]) -> None:
        anchor = self._anchors[slot]
        if anchor is None:
            self._anchors[slot] = (pulled_m, tip_m)
        elif abs(pulled_m - anchor[0]) >= LEVER_STEP_M:
            path_m = math.dist(tip_m, anchor[1])
            if math.isfinite(path_m) and path_m > 0.0:
                self._levers[slot] = path_m / abs(pulled_m - anchor[0])
            self._anchors[slot] = (pulled_m, tip_m)
