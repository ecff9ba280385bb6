# SPDX-License-Identifier: Apache-2.0
"""Control tables of the Dynamixel X series as data (ROBOTIS e-manual, X330 and X430 pages).

Addresses are common to the models here; scales, limits and defaults differ and stand in `MODELS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, IntFlag

from softgrip_driver.tendon.needs import EARLY_SHUTDOWN_SHARE, TendonNeeds
from softgrip_driver.tendon.winding import RatedMotor

PULSES_PER_TURN = 4096
RAD_PER_PULSE = 2.0 * math.pi / PULSES_PER_TURN
#: one unit of the velocity items: 0.229 rpm
RAD_PER_S_PER_UNIT = 0.229 * 2.0 * math.pi / 60.0
#: [V] one unit of the input voltage items
VOLT_PER_UNIT = 0.1
WATCHDOG_SECONDS_PER_UNIT = 0.020
RETURN_DELAY_SECONDS_PER_UNIT = 2e-6
#: PWM items at a duty cycle of 1 (0.113 % a unit)
PWM_FULL_SCALE = 885
#: modes 4 and 5: +-256 turns
EXTENDED_POSITION_LIMIT = 1_048_575


@dataclass(frozen=True)
class ControlItem:
    """One item of the control table."""

    name: str
    address: int
    size: int
    signed: bool = False

    def decode(self, data: bytes) -> int:
        """Return the value of exactly ``size`` little-endian bytes."""
        if len(data) != self.size:
            raise ValueError(f"{self.name}: expected {self.size} bytes, found {len(data)}")
        return int.from_bytes(data, "little", signed=self.signed)

    def encode(self, value: int) -> bytes:
        """Return a value as ``size`` little-endian bytes; raises OverflowError when it does not fit."""
        return int(value).to_bytes(self.size, "little", signed=self.signed)


MODEL_NUMBER = ControlItem("model number", 0, 2)
FIRMWARE = ControlItem("firmware version", 6, 1)
ID = ControlItem("ID", 7, 1)
BAUD_RATE = ControlItem("baud rate", 8, 1)
RETURN_DELAY = ControlItem("return delay time", 9, 1)
DRIVE_MODE = ControlItem("drive mode", 10, 1)
OPERATING_MODE = ControlItem("operating mode", 11, 1)
SECONDARY_ID = ControlItem("secondary ID", 12, 1)
TEMPERATURE_LIMIT = ControlItem("temperature limit", 31, 1)
PWM_LIMIT = ControlItem("PWM limit", 36, 2)
CURRENT_LIMIT = ControlItem("current limit", 38, 2)
STARTUP_CONFIGURATION = ControlItem("startup configuration", 60, 1)
SHUTDOWN = ControlItem("shutdown", 63, 1)
TORQUE_ENABLE = ControlItem("torque enable", 64, 1)
STATUS_RETURN_LEVEL = ControlItem("status return level", 68, 1)
HARDWARE_ERROR = ControlItem("hardware error status", 70, 1)
POSITION_D_GAIN = ControlItem("position D gain", 80, 2)
BUS_WATCHDOG = ControlItem("bus watchdog", 98, 1, signed=True)
GOAL_PWM = ControlItem("goal PWM", 100, 2, signed=True)
GOAL_CURRENT = ControlItem("goal current", 102, 2, signed=True)
GOAL_VELOCITY = ControlItem("goal velocity", 104, 4, signed=True)
PROFILE_ACCELERATION = ControlItem("profile acceleration", 108, 4)
PROFILE_VELOCITY = ControlItem("profile velocity", 112, 4)
GOAL_POSITION = ControlItem("goal position", 116, 4, signed=True)
PRESENT_PWM = ControlItem("present PWM", 124, 2, signed=True)
PRESENT_CURRENT = ControlItem("present current", 126, 2, signed=True)
PRESENT_VELOCITY = ControlItem("present velocity", 128, 4, signed=True)
PRESENT_POSITION = ControlItem("present position", 132, 4, signed=True)
PRESENT_VOLTAGE = ControlItem("present input voltage", 144, 2)
PRESENT_TEMPERATURE = ControlItem("present temperature", 146, 1)

#: value of the baud rate item for each baud [1/s]; 4.5 M is left out: dynamixel-sdk refuses it
BAUD_CODES: dict[int, int] = {9600: 0, 57600: 1, 115200: 2, 1_000_000: 3, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6}


class OperatingMode(IntEnum):
    """Operating modes a tendon drive may use (address 11)."""

    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5


class HardwareError(IntFlag):
    """Bits of the hardware error status (address 70)."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


#: errors that a servo answers with torque off. A supply that sags is none: it would open a hand that holds something
#: (the XL330 comes with that, the others do not)
SHUTDOWN_ERRORS = HardwareError.OVERHEATING | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERLOAD
#: status return level: every instruction is answered
ANSWER_ALL = 2

#: what the low seven bits of a status packet's error byte say
STATUS_ERRORS: dict[int, str] = {
    1: "result fail",
    2: "undefined instruction",
    3: "the servo saw a bad CRC",
    4: "data range: the value is outside the item's range, or the bus watchdog has tripped",
    5: "data length: fewer bytes than the item has",
    6: "data limit: the value is beyond the matching Limit item",
    7: "access: item undefined or read-only, or EEPROM while torque is on",
}
ALERT_BIT = 0x80


class CurrentSensing(Enum):
    """Where a model senses the current of Present Current (126) (e-manual, notes of items 38 and 102).

    NONE: it has Present Load in its place, and neither Current Limit nor Goal Current.
    """

    WINDING = "winding"
    SUPPLY = "supply"
    NONE = "none"


@dataclass(frozen=True, kw_only=True)
class ServoModel(RatedMotor):
    """What differs between models.

    Attributes:
        ampere_per_unit: [A] of one unit of the current items.
        current_limit_units: largest value of the current limit item.
        senses: which current it measures.
        fast_sync_read_firmware: first firmware version with Fast Sync Read.
        temperature_limit: [degC] factory value of item 31.
        voltage_range: [V] of normal operation.
        needs: limits of a tendon on it. With them it homes and closes the emulated fingers on a spool of 10 mm, an
            XM540 a stronger tendon on 25 mm (softgrip_driver/test/test_model_needs.py).
    """

    name: str
    number: int
    ampere_per_unit: float
    current_limit_units: int
    senses: CurrentSensing
    fast_sync_read_firmware: int
    temperature_limit: float
    voltage_range: tuple[float, float]
    needs: TendonNeeds


def _rpm(value: float) -> float:
    """Return a speed [rad/s] of [rpm]."""
    return value * 2.0 * math.pi / 60.0


def _x330(
    name: str, number: int, limit: int, volt: float, torque: float, stall: float, rpm: float, idle: float,
    volts: tuple[float, float], needs: TendonNeeds,
) -> ServoModel:  # fmt: skip
    """Return an XL330 or XC330: 1 mA a unit, of the supply; e-manual pages of xl330-* and xc330-*."""
    return ServoModel(
        name=name, number=number, ampere_per_unit=0.001, current_limit_units=limit, senses=CurrentSensing.SUPPLY,
        rated_voltage=volt, stall_torque=torque, stall_current=stall, no_load_speed=_rpm(rpm), no_load_current=idle,
        fast_sync_read_firmware=46, temperature_limit=70.0, voltage_range=volts,
        needs=needs,
    )  # fmt: skip


def _xm(
    name: str, number: int, limit: int, torque: float, stall: float, rpm: float, idle: float, needs: TendonNeeds
) -> ServoModel:
    """Return an XM430 or XM540: 2.69 mA a unit, of the winding, rated at 12 V; e-manual pages of xm430-*, xm540-*."""
    return ServoModel(
        name=name, number=number, ampere_per_unit=0.00269, current_limit_units=limit, senses=CurrentSensing.WINDING,
        rated_voltage=12.0, stall_torque=torque, stall_current=stall, no_load_speed=_rpm(rpm), no_load_current=idle,
        fast_sync_read_firmware=45, temperature_limit=80.0, voltage_range=(10.0, 14.8),
        needs=replace(needs, lasting_share=EARLY_SHUTDOWN_SHARE),
    )  # fmt: skip


def _430(
    name: str, number: int, hot: float, volt: float, torque: float, stall: float, rpm: float, volts: tuple[float, float]
) -> ServoModel:
    """Return an XL430 or XC430, which know no current; e-manual pages of xl430-w250 and xc430-*."""
    return ServoModel(
        name=name, number=number, ampere_per_unit=0.0, current_limit_units=0, senses=CurrentSensing.NONE,
        rated_voltage=volt, stall_torque=torque, stall_current=stall, no_load_speed=_rpm(rpm), no_load_current=0.05,
        fast_sync_read_firmware=45, temperature_limit=hot, voltage_range=volts, needs=TendonNeeds(0.03, 3.0, 10.0),
    )  # fmt: skip


#: models a tendon may hang on, by name. No page gives the no-load current: it is assumed
MODELS: dict[str, ServoModel] = {
    model.name: model
    for model in (
        # name, number, current limit, rated V, stall torque, stall current, no-load rpm, no-load current, voltage
        # range, needs
        _x330("XL330-M288", 1200, 1750, 5.0, 0.52, 1.47, 103.0, 0.05, (3.7, 6.0), TendonNeeds(0.015, 5.0, 50.0, 10.0)),
        _x330("XC330-M288", 1240, 2352, 5.0, 0.93, 1.80, 81.0, 0.05, (3.7, 6.0), TendonNeeds(0.015, 3.0, 50.0)),
        _x330("XC330-T288", 1220, 910, 11.1, 0.92, 0.80, 65.0, 0.03, (6.5, 12.0), TendonNeeds(0.015, 3.0, 50.0)),
        # name, number, current limit, stall torque, stall current, no-load rpm, no-load current, needs
        _xm("XM430-W210", 1030, 1193, 3.0, 2.3, 77.0, 0.06, TendonNeeds(0.04, 3.0, 10.0)),
        _xm("XM430-W350", 1020, 1193, 4.1, 2.3, 46.0, 0.06, TendonNeeds(0.05, 3.0, 5.0)),
        _xm("XM540-W150", 1130, 2047, 7.3, 4.4, 53.0, 0.08, TendonNeeds(0.25, 2.0, 5.0)),
        _xm("XM540-W270", 1120, 2047, 10.6, 4.4, 30.0, 0.08, TendonNeeds(0.25, 2.0, 5.0)),
        # name, number, temperature limit, rated V, stall torque, stall current, no-load rpm, voltage range
        _430("XL430-W250", 1060, 72.0, 11.1, 1.4, 1.3, 57.0, (6.5, 12.0)),
        _430("XC430-W150", 1070, 80.0, 12.0, 1.6, 1.4, 106.0, (6.5, 14.8)),
        _430("XC430-W240", 1080, 80.0, 12.0, 1.9, 1.4, 70.0, (6.5, 14.8)),
    )
}

#: names of model numbers that are known but have no tendon table here, so that `scan` can name them
MODEL_NAMES: dict[int, str] = {model.number: model.name for model in MODELS.values()} | {
    350: "XL320",
    1000: "XH430-W350",
    1010: "XH430-W210",
    1190: "XL330-M077",
    1210: "XC330-T181",
    1230: "XC330-M181",
    1700: "XC335-T332",
}
