# SPDX-License-Identifier: Apache-2.0
"""From the landmarks of one frame after the other to the next pulled lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError
from softgrip_design.landmarks import CHAINS, joint_angles
from softgrip_design.teleoperation.one_euro import OneEuroFilter, OneEuroSettings
from softgrip_design.teleoperation.tendon_table import TendonTable

Array = NDArray[np.float64]

#: Frames of the open hand that say what straight is: landmarks lie on the skin's side of the bones.
REFERENCE_FRAMES: Final = 10
#: A hand that stays away for longer is new when it comes back: its filters begin again [s].
FORGET_S: Final = 0.5


@dataclass(frozen=True)
class FollowerSettings:
    """How the fingers follow.

    Attributes:
        max_speed_m_s: of a pulled length.
        max_step_s: a step is computed for this long at most, however late a frame is.
        smoothing: of a finger's deflection [rad].
    """

    max_speed_m_s: float = 0.05
    max_step_s: float = 0.08
    smoothing: OneEuroSettings = field(default_factory=OneEuroSettings)


class HandFollower:
    """Follows one hand with several fingers; a finger follows the hand's finger of the same name.

    Args:
        tables: tendon -> its table.
        settings: limits and smoothing.

    Raises:
        DesignError: a tendon that no finger of a hand is called after.
    """

    def __init__(self, tables: Mapping[str, TendonTable], settings: FollowerSettings = FollowerSettings()) -> None:
        unknown = sorted(set(tables) - set(CHAINS))
        if unknown or not tables:
            raise DesignError(f"expected tendons named as fingers ({', '.join(CHAINS)}), found {unknown or 'none'}")
        self.tendons = tuple(tables)
        self._tables, self._settings = dict(tables), settings
        self._open: list[Array] = []
        self._filters: list[OneEuroFilter] = []
        self._last_seen_s = -np.inf
        self.deflections_rad: Array = np.full(len(tables), np.nan)
        """(tendons,) of the hand beyond the open hand, smoothed; NaN where there is no hand, or no reference yet."""
        self.joint_angles_rad: Array = np.zeros(0)
        """Of the hand's joints beyond the open hand, finger by finger, as they were seen; empty where unknown."""

    @property
    def has_reference(self) -> bool:
        """Whether the open hand has been seen."""
        return len(self._open) >= REFERENCE_FRAMES

    def observe(self, time_s: float, world: Array | None) -> None:
        """Take a frame.

        Args:
            time_s: of the frame.
            world: (21, 3) landmarks [m], None where there is no hand.
        """
        self.deflections_rad, self.joint_angles_rad = np.full(len(self.tendons), np.nan), np.zeros(0)
        if world is None or not np.isfinite(world).all():
            return
        fingers = [joint_angles(world[None], name)[0] for name in self.tendons]
        angles = np.concatenate(fingers)
        if not np.isfinite(angles).all():
            return
        if time_s - self._last_seen_s > FORGET_S:
            self._filters = [OneEuroFilter(self._settings.smoothing) for _ in self.tendons]
        self._last_seen_s = time_s
        if not self.has_reference:
            self._open.append(angles)
            return
        self.joint_angles_rad = angles - np.median(self._open, axis=0)
        begins = np.cumsum([0, *(len(one) for one in fingers[:-1])])
        sums = np.add.reduceat(self.joint_angles_rad, begins)
        smooth = [one.filter(time_s, float(value)) for one, value in zip(self._filters, sums, strict=True)]
        self.deflections_rad = np.maximum(smooth, 0.0)

    def next_lengths_m(self, lengths_m: Array, step_s: float) -> Array | None:
        """Return where the tendons have to be after a step, (tendons,) [m]; None without a hand to follow.

        Args:
            lengths_m: (tendons,) commanded last, or measured where nothing is commanded.
            step_s: that the step may take.
        """
        if not np.isfinite(self.deflections_rad).all():
            return None
        requested = [
            self._tables[name].length_m(float(deflection))
            for name, deflection in zip(self.tendons, self.deflections_rad, strict=True)
        ]
        furthest = self._settings.max_speed_m_s * min(step_s, self._settings.max_step_s)
        return np.maximum(lengths_m + np.clip(np.array(requested) - lengths_m, -furthest, furthest), 0.0)
