# SPDX-License-Identifier: Apache-2.0
"""What a drive remembers from one step to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.motions import Motion, Outcome


@dataclass
class DriveMemory:
    """What a drive remembers between steps."""

    motion: Motion | None = None
    zero: float | None = None
    origin: float = 0.0
    reading: DriveReading | None = None
    asked: float | None = None
    silence: float = 0.0
    tension: float = 0.0
    acceleration: float = 0.0
    last_step: float | None = None
    lost: int = 0
    mark: int | None = None
    job: int = 0
    outcome: Outcome | None = None
    reason: str = ""
    fault: str = ""
    fault_reason: str = ""
    restoring: bool = False
    restored_once: bool = False
    trim: float = 0.0
    setpoint: float | None = None
    allowed: float = math.inf
    warnings: dict[str, str] = field(default_factory=dict)
