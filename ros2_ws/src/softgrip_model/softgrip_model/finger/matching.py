# SPDX-License-Identifier: Apache-2.0
"""Brings together what the tendon and the camera said about the same instant.

A measurement waits until tendon readings before and after its stamp have arrived. So the pairs depend on what was
received, not on the order in which two topics came in, and a replay gives the same ones.
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from softgrip_time.units import to_s

Measured = TypeVar("Measured")

#: [ns] how long samples and measurements are kept, and how far apart samples may be to be interpolated between.
SPAN_NS: Final = 2_000_000_000
MAX_GAP_NS: Final = 100_000_000


@dataclass(frozen=True)
class TendonInput:
    """One tendon at one stamp; floats in SI units."""

    stamp: int
    """[ns]"""
    pulled_length_m: float
    velocity: float
    """NaN when the source gives none: it is then taken from the pulled lengths"""
    tension: float


class Matcher(Generic[Measured]):
    """Pairs of one finger. Keeps `span` nanoseconds of tendon samples."""

    def __init__(self, span: int = SPAN_NS, largest_gap: int = MAX_GAP_NS) -> None:
        """Make an empty one.

        Args:
            span: [ns] how long samples and measurements are kept.
            largest_gap: [ns] samples further apart are not interpolated between.
        """
        self._span = span
        self._largest_gap = largest_gap
        self._samples: list[TendonInput] = []
        self._waiting: list[tuple[int, Measured]] = []

    def add_tendon(self, sample: TendonInput) -> list[tuple[TendonInput, Measured]]:
        """Take a tendon sample; return the pairs that it completes, oldest first."""
        if self._samples and sample.stamp <= self._samples[-1].stamp:
            if sample.stamp >= self._samples[0].stamp:
                return []  # a repeated or late sample; time only goes back when a source restarts
            self._samples.clear()
            self._waiting.clear()
        if math.isnan(sample.velocity) and self._samples:
            last = self._samples[-1]
            velocity = (sample.pulled_length_m - last.pulled_length_m) / to_s(sample.stamp - last.stamp)
            sample = dataclasses.replace(sample, velocity=velocity)
        self._samples.append(sample)
        while sample.stamp - self._samples[0].stamp > self._span:
            self._samples.pop(0)
        return self._complete()

    def add_measured(self, stamp: int, measured: Measured) -> list[tuple[TendonInput, Measured]]:
        """Take a measurement [ns]; return the pairs that are complete, oldest first."""
        if self._waiting and self._waiting[-1][0] - stamp > self._span:
            self._waiting.clear()  # time only goes back so far when a source restarts
        self._waiting.append((stamp, measured))
        self._waiting.sort(key=lambda item: item[0])
        # The tendon may have fallen silent (no zero, a lost bus) while the camera sees on.
        while self._waiting[-1][0] - self._waiting[0][0] > self._span:
            self._waiting.pop(0)
        return self._complete()

    def _complete(self) -> list[tuple[TendonInput, Measured]]:
        if not self._samples:
            return []
        newest = self._samples[-1].stamp
        ready = [item for item in self._waiting if item[0] <= newest]
        self._waiting = [item for item in self._waiting if item[0] > newest]
        pairs = [(self._at(stamp), measured) for stamp, measured in ready]
        return [(sample, measured) for sample, measured in pairs if sample is not None]

    def _at(self, stamp: int) -> TendonInput | None:
        after = bisect_left(self._samples, stamp, key=lambda sample: sample.stamp)
        b = self._samples[after]
        if b.stamp == stamp:
            return b
        if after == 0:
            return None
        a = self._samples[after - 1]
        if b.stamp - a.stamp > self._largest_gap:
            return None
        share = (stamp - a.stamp) / (b.stamp - a.stamp)
        return TendonInput(
            stamp,
            a.pulled_length_m + share * (b.pulled_length_m - a.pulled_length_m),
            a.velocity + share * (b.velocity - a.velocity),
            a.tension + share * (b.tension - a.tension),
        )
