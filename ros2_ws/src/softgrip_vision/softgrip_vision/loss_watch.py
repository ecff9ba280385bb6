# SPDX-License-Identifier: Apache-2.0
"""Tells a finger that is lost from one whose markers are hidden for a moment, as each grasp hides some."""

from __future__ import annotations

from typing import Final

#: A finger that is not measured for longer than this is said to be lost [s].
LOST_S: Final = 5.0


class LossWatch:
    """Follows since when each finger has not been measured.

    Args:
        lost_s: a loss is lasting when it is longer than this [s].
    """

    def __init__(self, lost_s: float = LOST_S) -> None:
        self._lost_s = lost_s
        self._measured_s: dict[str, float] = {}

    def is_lasting(self, finger: str, stamp_s: float, *, is_measured: bool) -> bool:
        """Take what one frame showed of a finger; returns whether its loss is a lasting one.

        Args:
            finger: its slot.
            stamp_s: of the frame [s]; one that goes back begins again.
            is_measured: whether the frame gave its joints.
        """
        last_s = self._measured_s.setdefault(finger, stamp_s)
        if is_measured or stamp_s < last_s:
            self._measured_s[finger] = stamp_s
            return False
        return stamp_s - last_s > self._lost_s
