# SPDX-License-Identifier: Apache-2.0
"""What is known of a servo while the loop runs, and the blocks of its table that are read now and then."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.tendon.bus_backend import BusDevice
from softgrip_driver.tendon.winding import MotorReading


@dataclass(frozen=True)
class SlowRead:
    """A block read now and then. All sizes differ, so that a late answer to one is never taken for another."""

    name: str
    address: int
    size: int


TORQUE = SlowRead("torque enable, LED", 64, 2)
ERRORS = SlowRead("status return level .. hardware error status", 68, 3)
WATCHDOG = SlowRead("bus watchdog", 98, 1)
MARK = SlowRead("goal PWM, goal current", 100, 4)
SUPPLY = SlowRead("position trajectory, voltage, temperature", 140, 7)
ROUND = (ERRORS, SUPPLY, TORQUE, MARK, WATCHDOG)


@dataclass
class ServoState(BusDevice):
    """What is known of a servo while the loop runs.

    Attributes (those that do not speak for themselves):
        anchor: [pulses] goal position that it has rested at; moved_at: [s] when it last left one.
        armed: its bus watchdog runs.
        motor: the last reading of its motor; at rest on the rated supply until there was one.
    """

    servo: ServoConfiguration
    suspect: bool = False
    stalled: bool = False
    alert: bool = False
    hardware_error: int = 0
    watchdog_tripped: bool = False
    pwm_limit: int = 885
    current_units: int | None = None
    anchor: int | None = None
    moved_at: float = -math.inf
    armed: bool = False
    values: dict[str, float] = field(default_factory=dict)
    urgent: list[SlowRead] = field(default_factory=list)
    motor: MotorReading = field(init=False)

    def __post_init__(self) -> None:
        self.motor = self.servo.standing()

    @property
    def tendon(self) -> str:
        """Name of the tendon on its spool."""
        return self.servo.tendon
