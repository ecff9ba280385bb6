# SPDX-License-Identifier: Apache-2.0
"""What a drive remembers from one step to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.motions import DriveObservation, Motion, MoveOutcome


@dataclass
class DriveMemory:
    """What a drive remembers between steps."""

    motion: Motion | None = None
    zero: float | None = None
    origin: float = 0.0
    reading: DriveReading | None = None
    tension: float = 0.0
    acceleration: float = 0.0
    last_step: float | None = None
    lost: int = 0
    mark: int | None = None
    job: int = 0
    outcome: MoveOutcome | None = None
    reason: str = ""
    fault: str = ""
    fault_reason: str = ""
    restoring: bool = False
    restored_once: bool = False
    setpoint: float | None = None
    allowed: float = math.inf
    warnings: dict[str, str] = field(default_factory=dict)

    @property
    def frame(self) -> float:
        """[m] in the device's frame from which lengths count: the zero, or where it was switched on."""
        return self.origin if self.zero is None else self.zero

    def view(self, reading: DriveReading, now: float, dt: float, cap: float) -> DriveObservation:
        """Return what a motion sees at a time [s], ``dt`` [s] after the step before, with ``cap`` [N] allowed."""
        length = reading.position - self.frame
        ahead = 0.0 if self.setpoint is None else self.setpoint - length
        return DriveObservation(
            now, dt, length, reading.velocity, self.tension, reading.pull, cap, reading.tension_stddev,
            self.acceleration, ahead,
        )  # fmt: skip
