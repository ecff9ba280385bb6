# SPDX-License-Identifier: Apache-2.0
"""Measured minus predicted over the last hour, with the limits that the predictor decides by."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from softgrip_panel.model.facts import ResidualView

#: A finger's residual is kept so often [s], and whenever one of its statistics changes; so many are kept.
EVERY_S: Final = 10.0
MAX_SAMPLES: Final = 360


class WatchKind(StrEnum):
    """What the statistics are (parameter `watch` of kinematics_predictor); UNKNOWN = not read yet."""

    UNKNOWN = ""
    CAUSES = "causes"
    SHIFTS = "shifts"


@dataclass(frozen=True)
class WatchLimits:
    """From where on a statistic means something; NaN = not read yet.

    Attributes:
        kind: CUSUM of shifts in standard deviations, or log-likelihood ratio of causes.
        low: a finger is to be watched, or a cause is named.
        high: it is decided: recalibrate or worn.
    """

    kind: WatchKind = WatchKind.UNKNOWN
    low: float = math.nan
    high: float = math.nan

    @classmethod
    def of(cls, watch: str, watch_limit: float, worn_limit: float, cusum_limit: float) -> WatchLimits:
        """Return the limits by the predictor's parameters of these names; a CUSUM is watched from half its limit on."""
        if watch == WatchKind.SHIFTS:
            return cls(WatchKind.SHIFTS, cusum_limit / 2.0, cusum_limit)
        return cls(WatchKind.CAUSES, watch_limit, worn_limit) if watch == WatchKind.CAUSES else cls()


@dataclass(frozen=True)
class ResidualSample:
    """A finger at a moment; `at_s` by the panel's steady clock."""

    at_s: float
    tip_error_m: float
    friction: float
    stiffness: float


class ResidualHistory:
    """The last hour of every finger that is measured."""

    def __init__(self) -> None:
        self._fingers: dict[str, deque[ResidualSample]] = {}

    def observe(self, residual: ResidualView, now_s: float) -> None:
        """Take a residual; it is kept when a statistic has changed, or the last one is old."""
        kept = self._fingers.setdefault(residual.finger, deque(maxlen=MAX_SAMPLES))
        last = kept[-1] if kept else None
        is_same = last is not None and (last.friction, last.stiffness) == (
            residual.cusum_friction, residual.cusum_stiffness,
        )  # fmt: skip
        if last is None or not is_same or now_s - last.at_s >= EVERY_S:
            kept.append(ResidualSample(now_s, residual.tip_error_m, residual.cusum_friction, residual.cusum_stiffness))

    @property
    def fingers(self) -> tuple[str, ...]:
        """Fingers of which something is known."""
        return tuple(sorted(self._fingers))

    def samples(self, finger: str) -> tuple[ResidualSample, ...]:
        """Return what is kept of a finger, oldest first."""
        return tuple(self._fingers.get(finger, ()))
