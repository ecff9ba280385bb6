# SPDX-License-Identifier: Apache-2.0
"""When nothing happens at the drives, so that the bus loop may go slower. Pure: the time comes in as `now` [s].

Drives rest while all of them are calm (`GripperController.is_calm`) and nothing that they report changes. One that
pulls, moves, is at fault, does not answer or belongs to somebody is looked at in every period.
"""

from __future__ import annotations

from collections.abc import Sequence

from softgrip_driver.tendon.status import DriveSnapshot

#: [s] without any change before the loop may go slower
REST_AFTER_S = 2.0
#: cycles at least in the time of silence after which a device stops by itself
WATCHDOG_PERIODS = 2.0
#: [m] of pulled length that count as a change: as far as a servo's own resting position wanders
MOTION_M = 1.5e-4


def rest_stride(loop_rate: float, rest_rate: float, watchdog_s: float) -> int:
    """Return how many periods of the loop lie between two cycles at rest; 1 = it never rests.

    Args:
        loop_rate: of the control loop [Hz].
        rest_rate: wanted at rest [Hz]; 0 = never.
        watchdog_s: silence after which a device stops by itself [s]; 0 = never.
    """
    if rest_rate <= 0.0:
        return 1
    needed = WATCHDOG_PERIODS / watchdog_s if watchdog_s > 0.0 else 0.0
    return max(1, int(loop_rate / max(rest_rate, needed) * (1.0 + 1e-9)))


class RestWatch:
    """Tells whether the drives have been at rest for a while.

    Args:
        after_s: without any change [s].
    """

    def __init__(self, after_s: float = REST_AFTER_S) -> None:
        self._after_s = after_s
        self._since_s = 0.0
        self._reference: tuple[DriveSnapshot, ...] = ()

    def disturb(self) -> None:
        """Record that somebody has asked for something."""
        self._reference = ()

    def is_at_rest(self, now: float, drives: Sequence[DriveSnapshot], *, is_calm: bool) -> bool:
        """Take what a cycle has shown; return whether the next one may come later.

        Args:
            now: [s]
            drives: all of the loop.
            is_calm: see above.
        """
        if not is_calm:
            self._reference = ()
            return False
        if not self._reference or not all(map(_is_like, drives, self._reference)):
            self._reference, self._since_s = tuple(drives), now
        return now - self._since_s >= self._after_s


def _is_like(drive: DriveSnapshot, before: DriveSnapshot) -> bool:
    """Whether a drive shows what it did before, but for what wanders at rest."""
    stays = abs(drive.pulled_length_m - before.pulled_length_m) <= MOTION_M
    return stays and _reported(drive) == _reported(before)


def _reported(drive: DriveSnapshot) -> tuple[object, ...]:
    return drive.state, drive.homed, drive.lost_replies, drive.warnings, drive.hardware_error, drive.job
