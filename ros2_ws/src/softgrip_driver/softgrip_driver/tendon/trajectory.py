# SPDX-License-Identifier: Apache-2.0
"""A streamed trajectory of one tendon: checked when it comes, interpolated when it runs."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from softgrip_driver.errors import ConfigurationError

#: of one trajectory: at 100 Hz that is 20 s, and a stream sends the next one long before
MAX_POINTS = 2000


@dataclass(frozen=True)
class TendonTrajectory:
    """Pulled lengths over time.

    Attributes:
        times: [s] from its start, growing, shape (n,).
        lengths: [m] shape (n,).
        speeds: [m/s] shape (n,), or empty: then straight lines join the points.
    """

    times: tuple[float, ...]
    lengths: tuple[float, ...]
    speeds: tuple[float, ...] = ()

    @classmethod
    def checked(
        cls, times: Sequence[float], lengths: Sequence[float], speeds: Sequence[float], travel: float, max_speed: float
    ) -> TendonTrajectory:
        """Return a trajectory within 0 .. ``travel`` [m] whose speeds stay within ``max_speed`` [m/s].

        Raises:
            ConfigurationError: no points or too many, wrong counts, times that do not grow, numbers that are none,
                lengths outside the travel, or speeds beyond the limit.
        """
        if len(times) > MAX_POINTS:
            raise ConfigurationError(f"trajectory: expected at most {MAX_POINTS} points, found {len(times)}; stream it")
        if not times or len(lengths) != len(times) or len(speeds) not in (0, len(times)):
            raise ConfigurationError(
                "trajectory: expected as many positions (and velocities, if any) as points, found "
                f"{len(times)} points, {len(lengths)} positions, {len(speeds)} velocities"
            )
        if not all(math.isfinite(number) for number in (*times, *lengths, *speeds)):
            raise ConfigurationError("trajectory: expected finite numbers, found NaN or infinity")
        if times[0] < 0.0 or any(b <= a for a, b in pairwise(times)):
            raise ConfigurationError(f"trajectory: expected growing times from 0 s on, found {list(times)[:5]}")
        low, high = min(lengths), max(lengths)
        if low < -1e-9 or high > travel + 1e-9:
            raise ConfigurationError(
                f"trajectory: expected pulled lengths between 0 and {travel:.4f} m, found {low:.4f} .. {high:.4f} m"
            )
        fastest = max(map(abs, speeds), default=0.0)
        if fastest > max_speed:
            raise ConfigurationError(f"trajectory: expected velocities up to {max_speed:g} m/s, found {fastest:g} m/s")
        return cls(tuple(times), tuple(lengths), tuple(speeds))

    @property
    def duration(self) -> float:
        """Length of the trajectory in time [s]."""
        return self.times[-1]

    def starting_from(self, length: float, speed: float) -> TendonTrajectory:
        """Return the trajectory led in from where the drive is [m], [m/s] at its start."""
        if self.times[0] == 0.0:
            return self
        speeds = (speed, *self.speeds) if self.speeds else ()
        return TendonTrajectory((0.0, *self.times), (length, *self.lengths), speeds)

    def length(self, time: float) -> float:
        """Return the pulled length [m] at a time [s] since the start; the ends are held."""
        if time <= self.times[0]:
            return self.lengths[0]
        if time >= self.times[-1]:
            return self.lengths[-1]
        i = bisect_right(self.times, time) - 1
        span = self.times[i + 1] - self.times[i]
        s = (time - self.times[i]) / span
        a, b = self.lengths[i], self.lengths[i + 1]
        if not self.speeds:
            return a + s * (b - a)
        # Cubic Hermite: positions and velocities of both ends are met.
        m, n = self.speeds[i] * span, self.speeds[i + 1] * span
        return a + s * (m + s * ((3.0 * (b - a) - 2.0 * m - n) + s * (2.0 * (a - b) + m + n)))
