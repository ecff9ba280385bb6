# SPDX-License-Identifier: Apache-2.0
"""What is known of a servo while the loop runs, and the blocks of its table that are read now and then."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.tendon.bus_backend import BusDevice
from softgrip_driver.tendon.winding import MotorReading, WindingWarmth


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
#: of a servo without a goal current
VELOCITY_MARK = SlowRead("goal velocity", 104, 4)
SUPPLY = SlowRead("position trajectory, voltage, temperature", 140, 7)


@dataclass
class ServoState(BusDevice):
    """What is known of a servo while the loop runs.

    Attributes (those that do not speak for themselves):
        anchor: [pulses] goal position that it has rested at; moved_at: [s] when it last left one.
        armed: its bus watchdog runs.
        limit_units: what stands in the servo's `limit_item`; None where it has to be written.
        motor: the last reading of its motor; at rest on the rated supply until there was one.
        warmth: of its winding.
    """

    servo: ServoConfiguration
    suspect: bool = False
    stalled: bool = False
    alert: bool = False
    hardware_error: int = 0
    watchdog_tripped: bool = False
    pwm_limit: int = 885
    limit_units: int | None = None
    anchor: int | None = None
    moved_at: float = -math.inf
    armed: bool = False
    values: dict[str, float] = field(default_factory=dict)
    urgent: list[SlowRead] = field(default_factory=list)
    motor: MotorReading = field(init=False)
    warmth: WindingWarmth = field(default_factory=WindingWarmth)

    def __post_init__(self) -> None:
        self.motor = self.servo.standing()

    @property
    def device_id(self) -> int:
        """ID that the bus knows it by."""
        return self.servo.servo_id

    @property
    def mark_block(self) -> SlowRead:
        """The block with the session mark."""
        return MARK if self.servo.has_current_goal else VELOCITY_MARK

    @property
    def round(self) -> tuple[SlowRead, ...]:
        """The blocks that are read in turn."""
        return (ERRORS, SUPPLY, TORQUE, self.mark_block, WATCHDOG)

    @property
    def tendon(self) -> str:
        """Name of the tendon on its spool."""
        return self.servo.tendon
