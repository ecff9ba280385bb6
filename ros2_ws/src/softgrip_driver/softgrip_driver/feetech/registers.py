# SPDX-License-Identifier: Apache-2.0
"""Memory table of Feetech's STS servos as data (Feetech, "Magnetic encoder STS servo, memory table analysis").

Checked against huggingface/lerobot, motors/feetech/tables.py, and rustypot (feetech/sts3215).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

from softgrip_driver.tendon.needs import TendonNeeds
from softgrip_driver.tendon.winding import RatedMotor

STEPS_PER_TURN = 4096
RAD_PER_STEP = 2.0 * math.pi / STEPS_PER_TURN
#: a goal may be that far from the origin: some seven turns (Feetech: +-30719 in multi-turn absolute position control)
MAX_STEPS = 30_719
#: torque limit and present load at a duty cycle of 1
FULL_SCALE = 1000
VOLT_PER_UNIT = 0.1
AMPERE_PER_UNIT = 0.0065
#: one unit of the speed items, by bit 2 of the phase: 0.732 rpm, or 0.0146 rpm, which is one step a second
RAD_PER_S_COARSE = 0.732 * 2.0 * math.pi / 60.0
RAD_PER_S_FINE = RAD_PER_S_COARSE / 50.0
#: value of the baud rate item for each baud [1/s]
BAUD_CODES: dict[int, int] = {1_000_000: 0, 500_000: 1, 250_000: 2, 128_000: 3, 115_200: 4}


@dataclass(frozen=True)
class FeetechItem:
    """One item, little-endian.

    Attributes:
        sign_bit: the bit that carries the sign beside a magnitude; None = never negative.
    """

    name: str
    address: int
    size: int
    sign_bit: int | None = None

    def decode(self, data: bytes) -> int:
        """Return the value of exactly ``size`` bytes."""
        if len(data) != self.size:
            raise ValueError(f"{self.name}: expected {self.size} bytes, found {len(data)}")
        value = int.from_bytes(data, "little")
        if self.sign_bit is None:
            return value
        magnitude = value & ((1 << self.sign_bit) - 1)
        return -magnitude if value >> self.sign_bit & 1 else magnitude

    def encode(self, value: int) -> bytes:
        """Return a value as ``size`` bytes; raises OverflowError when it does not fit."""
        if self.sign_bit is not None and value < 0:
            if -value >> self.sign_bit:
                raise OverflowError(f"{self.name}: expected at least {1 - (1 << self.sign_bit)}, found {value}")
            value = -value | 1 << self.sign_bit
        return value.to_bytes(self.size, "little")


FIRMWARE = FeetechItem("firmware version", 0, 2)
MODEL_NUMBER = FeetechItem("model number", 3, 2)
ID = FeetechItem("ID", 5, 1)
BAUD_RATE = FeetechItem("baud rate", 6, 1)
RESPONSE_LEVEL = FeetechItem("response status level", 8, 1)
MIN_ANGLE = FeetechItem("minimum angle limit", 9, 2)
MAX_ANGLE = FeetechItem("maximum angle limit", 11, 2)
TEMPERATURE_LIMIT = FeetechItem("maximum temperature limit", 13, 1)
MAX_TORQUE = FeetechItem("maximum torque", 16, 2)
PHASE = FeetechItem("phase", 18, 1)
UNLOADING = FeetechItem("unloading conditions", 19, 1)
ANGLE_RESOLUTION = FeetechItem("angle resolution", 30, 1)
MODE = FeetechItem("operating mode", 33, 1)
TORQUE_ENABLE = FeetechItem("torque switch", 40, 1)
ACCELERATION = FeetechItem("acceleration", 41, 1)
GOAL_POSITION = FeetechItem("target position", 42, 2, 15)
#: of the open-loop mode alone; the driver keeps its session mark there
OPEN_LOOP_SPEED = FeetechItem("PWM open-loop speed", 44, 2)
GOAL_SPEED = FeetechItem("operating speed", 46, 2, 15)
TORQUE_LIMIT = FeetechItem("torque limit", 48, 2)
LOCK = FeetechItem("lock flag", 55, 1)
PRESENT_POSITION = FeetechItem("current position", 56, 2, 15)
PRESENT_SPEED = FeetechItem("current speed", 58, 2, 15)
PRESENT_LOAD = FeetechItem("current load", 60, 2, 10)
PRESENT_VOLTAGE = FeetechItem("current voltage", 62, 1)
PRESENT_TEMPERATURE = FeetechItem("current temperature", 63, 1)
STATUS = FeetechItem("servo status", 65, 1)
PRESENT_CURRENT = FeetechItem("current current", 69, 2, 15)

#: from torque switch to current: what a cycle reads of every servo
CYCLE_BLOCK = (TORQUE_ENABLE.address, PRESENT_CURRENT.address + PRESENT_CURRENT.size - TORQUE_ENABLE.address)

#: value of a session mark's item from which on it is none: 0 or 1000 after power-on, by firmware
MARK_END = 16


class PhaseBits(IntFlag):
    """Bits of the phase (18) that matter here."""

    FINE_SPEED = 0x04
    COUNTS_TURNS = 0x10


class FeetechStatusBits(IntFlag):
    """Bits of the servo status (65) and of the status byte of every answer."""

    VOLTAGE = 0x01
    ENCODER = 0x02
    TEMPERATURE = 0x04
    CURRENT = 0x08
    OVERLOAD = 0x20


#: what a servo answers with torque off. A supply that sags is none: it would open a hand that holds something
UNLOADING_BITS = (
    FeetechStatusBits.ENCODER | FeetechStatusBits.TEMPERATURE | FeetechStatusBits.CURRENT | FeetechStatusBits.OVERLOAD
)


@dataclass(frozen=True, kw_only=True)
class FeetechModel(RatedMotor):
    """What differs between models.

    Attributes:
        number: of the memory table.
        coulomb_share: of the no-load current that does not grow with speed.
        temperature_limit: [degC] factory value of item 13.
        voltage_range: [V] of normal operation.
        needs: limits of a tendon on it, proven in the emulator (test_other_drives.py).
    """

    name: str
    number: int
    coulomb_share: float
    temperature_limit: float
    voltage_range: tuple[float, float]
    needs: TendonNeeds


_KGF_CM = 0.0980665
_RPM = 2.0 * math.pi / 60.0

#: models a tendon may hang on, by name
MODELS: dict[str, FeetechModel] = {
    model.name: model
    for model in (
        # 19 kgf cm at 7.4 V: ftservo-wiki, ST-3215-C001, rev. A/0. 8 kgf cm/A: ftservo-bam, feetech/actuator.py, which
        # makes 2.4 A at stall. 52 rpm and 150 mA without load at 7.4 V, 4 to 7.4 V: DFRobot SER0069. How much of the
        # friction grows with speed nobody says: half of it is assumed.
        FeetechModel(
            name="STS3215", number=777, rated_voltage=7.4, stall_torque=19.0 * _KGF_CM, stall_current=19.0 / 8.0,
            no_load_speed=52.0 * _RPM, no_load_current=0.15, coulomb_share=0.5, temperature_limit=70.0,
            voltage_range=(4.0, 7.4), needs=TendonNeeds(0.12, 3.0, 5.0),
        ),
    )
}  # fmt: skip

#: names of model numbers that have no tendon table here, so that messages can name them (lerobot, tables.py)
MODEL_NAMES: dict[int, str] = {model.number: model.name for model in MODELS.values()} | {
    1284: "SCS0009",
    2825: "STS3250",
    11272: "SM8512BL",
}
#: they count no turns, and a tendon's spool may need more than one
SCS_NUMBERS = frozenset({1284})
