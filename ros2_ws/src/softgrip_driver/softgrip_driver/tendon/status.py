# SPDX-License-Identifier: Apache-2.0
"""What a drive tells (snapshot) and what it asks of its device (actions)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softgrip_driver.tendon.backend import Setpoint
from softgrip_driver.tendon.motions import DriveState, MoveOutcome


@dataclass(frozen=True)
class DriveSnapshot:
    """What one drive is and does, for whoever watches.

    Lengths [m] are pulled lengths; NaN until something was read. ``zero`` [m] is where they count from in the device's
    own frame, NaN while no tendon was homed. ``job`` counts the motions that were asked for; ``outcome`` and ``reason``
    are the last one's.
    """

    tendon: str
    state: DriveState
    homed: bool
    pulled_length_m: float = math.nan
    speed: float = math.nan
    tension: float = math.nan
    tension_stddev: float = math.nan
    current: float = math.nan
    temperature: float = math.nan
    voltage: float = math.nan
    hardware_error: int = 0
    fault: str = ""
    fault_reason: str = ""
    outcome: MoveOutcome | None = None
    reason: str = ""
    lost_replies: int = 0
    time: float = 0.0
    warnings: tuple[str, ...] = ()
    job: int = 0
    zero: float = math.nan


@dataclass
class DriveActions:
    """What a step asks of the device.

    Attributes:
        setpoint: to be written, None = nothing.
        power: True / False = switch, None = leave.
        restore: reboot and set up the device again.
    """

    setpoint: Setpoint | None = None
    power: bool | None = None
    restore: bool = False
