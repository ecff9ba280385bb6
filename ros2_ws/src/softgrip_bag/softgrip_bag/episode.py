# SPDX-License-Identifier: Apache-2.0
"""One grasp or demonstration as learning stacks want it: frames at a fixed rate, each with what was last known then."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_time.units import to_s

Array = NDArray[np.float64]

#: Outcomes that are a success: of cell/grasp, and of a teleoperated demonstration.
SUCCESSES = ("GRIPPED", "SUCCEEDED")


@dataclass(frozen=True)
class StampedSeries:
    """Values of one topic over time.

    Attributes:
        stamps_ns: (n,) of the sources, growing.
        values: (n, k).
    """

    stamps_ns: tuple[int, ...]
    values: Array

    def at(self, times_ns: Sequence[int]) -> tuple[Array, NDArray[np.int64]]:
        """Return the last value at or before each time, (m, k), and its stamp, (m,); before the first: zeros and -1."""
        found = np.zeros((len(times_ns), self.values.shape[1]))
        stamps = np.full(len(times_ns), -1, np.int64)
        for row, time_ns in enumerate(times_ns):
            at = bisect_right(self.stamps_ns, time_ns) - 1
            if at >= 0:
                found[row], stamps[row] = self.values[at], self.stamps_ns[at]
        return found, stamps


@dataclass(frozen=True)
class TendonCommand:
    """A move that was commanded: one tendon, from a moment on.

    Attributes:
        time_ns: when it was sent.
        tendon: its number.
        length_m: target; NaN where a tension is the target.
        speed_m_s: of pulled length.
        tension_n: target, or the limit of a move to a length.
    """

    time_ns: int
    tendon: int
    length_m: float
    speed_m_s: float
    tension_n: float


@dataclass(frozen=True)
class Episode:
    """One grasp of the manager's, or one demonstration of a person's.

    Attributes:
        bag: name of the bag.
        task: what is done, in words.
        product, finger_set, outcome, reason: of the grasp; a demonstration has no product.
        evidence: the verdict's numbers, JSON.
        tendons: their names.
        times_ns: (n,) of the frames, one period apart, since the epoch.
        state_stamps_ns: (n,) stamp of the tendon/state that a frame shows.
        lengths_m, tensions_n: (n, tendons) measured.
        commanded_lengths_m, commanded_tensions_n: (n, tendons).
        predicted_rad, measured_rad: (n, joints) of all fingers, and of the finger that the camera follows.
        measured_stamps_ns: (n,) of the camera frame of `measured_rad`; -1: none yet.
        images: (n,) encoded camera images; empty where the bag has none.
        image_stamps_ns: (n,) of these; empty where the bag has none.
    """

    bag: str
    task: str
    product: str
    finger_set: str
    outcome: str
    reason: str
    evidence: str
    tendons: tuple[str, ...]
    times_ns: NDArray[np.int64]
    state_stamps_ns: NDArray[np.int64]
    lengths_m: Array
    tensions_n: Array
    commanded_lengths_m: Array
    commanded_tensions_n: Array
    predicted_rad: Array
    measured_rad: Array
    measured_stamps_ns: NDArray[np.int64]
    images: tuple[bytes, ...]
    image_stamps_ns: NDArray[np.int64]

    @property
    def is_success(self) -> bool:
        """Whether the cell's verdict is GRIPPED, or a person's SUCCEEDED."""
        return self.outcome in SUCCESSES


def commanded(
    commands: Sequence[TendonCommand], times_ns: Sequence[int], lengths_m: Array, full_length_m: float
) -> tuple[Array, Array]:
    """Return what each tendon was commanded at each time: length [m] and tension [N], (n, tendons) each.

    A move to a length goes there at its speed from where the tendon is; its tension is the limit. A move to a tension
    may wind to the full length. Before the first move the command is to stay, without tension.

    Args:
        commands: in order of time.
        times_ns: of the frames.
        lengths_m: (n, tendons) measured.
        full_length_m: that a tendon may be pulled at most [m].
    """
    length, tension = lengths_m.copy(), np.zeros_like(lengths_m)
    for tendon in range(lengths_m.shape[1]):
        own = [one for one in commands if one.tendon == tendon]
        if not own:
            continue
        sent_ns = [one.time_ns for one in own]
        for row, time_ns in enumerate(times_ns):
            at = bisect_right(sent_ns, time_ns) - 1
            if at < 0:
                continue
            one = own[at]
            tension[row, tendon] = one.tension_n
            if np.isnan(one.length_m):
                length[row, tendon] = full_length_m
                continue
            # where it was when the command came: the frame at or after it
            began = lengths_m[min(int(np.searchsorted(times_ns, one.time_ns)), len(times_ns) - 1), tendon]
            way = one.length_m - began
            gone = min(abs(way), one.speed_m_s * to_s(time_ns - one.time_ns))
            length[row, tendon] = began + np.sign(way) * gone
    return length, tension
