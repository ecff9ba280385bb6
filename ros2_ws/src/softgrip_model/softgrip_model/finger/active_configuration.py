# SPDX-License-Identifier: Apache-2.0
"""What the predictor went by at the stamp of each tendon sample.

Three streams meet in a residual: the tendons, the camera, and what the cell says is mounted and free. Only the order of
the last against the tendons' is written into results. So a measurement is judged by what the tendon sample before it
was predicted with, whatever has come in meanwhile, and a replay comes to the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from softgrip_model.digest import text_digest
from softgrip_model.finger.predictor import Configuration
from softgrip_model.finger.wear import WearMonitor


@dataclass(frozen=True)
class ActiveConfiguration:
    """Fingers and friction, the judges of their wear (slot -> monitor), and whether the fingers are free of objects."""

    configuration: Configuration
    monitors: Mapping[str, WearMonitor]
    free: bool

    @property
    def digest(self) -> str:
        """Name of everything here but the friction and the monitors."""
        digest = self.configuration.digest
        return digest if self.free else text_digest(f"{digest};not free")

    def holds(self, slot: str, profile: str) -> bool:
        """Whether a slot holds a finger of a profile; empty: of any."""
        mounted = self.configuration.mounted.get(slot)
        return mounted is not None and profile in {"", mounted}


class Timeline:
    """Keeps what was in use for ``span`` nanoseconds of tendon samples."""

    def __init__(self, span: int = 2_000_000_000) -> None:
        self._span = span
        self._since: deque[tuple[int, ActiveConfiguration]] = deque()
        self._newest: int | None = None

    def note(self, stamp: int, in_use: ActiveConfiguration) -> None:
        """Take down what the tendon sample of a stamp [ns] meets; a late sample changes nothing."""
        if self._newest is not None and stamp <= self._newest:
            if stamp > self._newest - self._span:
                return
            self._since.clear()  # time only goes back so far when a source restarts
        self._newest = stamp
        if not self._since or self._since[-1][1] != in_use:
            self._since.append((stamp, in_use))
        while len(self._since) > 1 and self._since[1][0] < stamp - self._span:
            self._since.popleft()

    def at(self, stamp: int) -> ActiveConfiguration | None:
        """Return what the last tendon sample up to a stamp [ns] met; None when there was none."""
        return next((in_use for since, in_use in reversed(self._since) if since <= stamp), None)
