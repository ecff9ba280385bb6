# SPDX-License-Identifier: Apache-2.0
"""The control table against the numbers of ROBOTIS' e-manual (pages XL330-M288, XC330, XM430-W350)."""

from __future__ import annotations

import pytest

from softgrip_driver.dynamixel import registers as reg

#: name: (address, size [byte], signed)
E_MANUAL = {
    "model number": (0, 2, False),
    "firmware version": (6, 1, False),
    "ID": (7, 1, False),
    "baud rate": (8, 1, False),
    "return delay time": (9, 1, False),
    "drive mode": (10, 1, False),
    "operating mode": (11, 1, False),
    "secondary ID": (12, 1, False),
    "temperature limit": (31, 1, False),
    "PWM limit": (36, 2, False),
    "current limit": (38, 2, False),
    "startup configuration": (60, 1, False),
    "shutdown": (63, 1, False),
    "torque enable": (64, 1, False),
    "status return level": (68, 1, False),
    "hardware error status": (70, 1, False),
    "position D gain": (80, 2, False),
    "bus watchdog": (98, 1, True),
    "goal PWM": (100, 2, True),
    "goal current": (102, 2, True),
    "goal velocity": (104, 4, True),
    "profile acceleration": (108, 4, False),
    "profile velocity": (112, 4, False),
    "goal position": (116, 4, True),
    "present PWM": (124, 2, True),
    "present current": (126, 2, True),
    "present velocity": (128, 4, True),
    "present position": (132, 4, True),
    "present input voltage": (144, 2, False),
    "present temperature": (146, 1, False),
}


def test_every_item_has_the_address_size_and_sign_of_the_e_manual() -> None:
    items = [item for item in vars(reg).values() if isinstance(item, reg.ControlItem)]
    assert {item.name: (item.address, item.size, item.signed) for item in items} == E_MANUAL


def test_units_are_those_of_the_e_manual() -> None:
    assert reg.PULSES_PER_TURN == 4096
    assert pytest.approx(0.229 / 60.0 * 6.283185307, rel=1e-9) == reg.RAD_PER_S_PER_UNIT
    assert (reg.VOLT_PER_UNIT, reg.WATCHDOG_SECONDS_PER_UNIT, reg.RETURN_DELAY_SECONDS_PER_UNIT) == (0.1, 0.020, 2e-6)


@pytest.mark.parametrize(
    ("name", "number", "milliampere", "largest_limit", "hottest"),
    [
        ("XL330-M288", 1200, 1.0, 1750, 70.0),
        ("XC330-M288", 1240, 1.0, 2352, 70.0),
        ("XC330-T288", 1220, 1.0, 910, 70.0),
        ("XM430-W210", 1030, 2.69, 1193, 80.0),
        ("XM430-W350", 1020, 2.69, 1193, 80.0),
        ("XM540-W150", 1130, 2.69, 2047, 80.0),
        ("XM540-W270", 1120, 2.69, 2047, 80.0),
        ("XL430-W250", 1060, 0.0, 0, 72.0),
        ("XC430-W150", 1070, 0.0, 0, 80.0),
        ("XC430-W240", 1080, 0.0, 0, 80.0),
    ],
)
def test_a_model_has_the_scales_and_limits_of_its_page(
    name: str, number: int, milliampere: float, largest_limit: int, hottest: float
) -> None:
    model = reg.MODELS[name]
    assert (model.number, model.current_limit_units, model.temperature_limit) == (number, largest_limit, hottest)
    assert model.ampere_per_unit == pytest.approx(milliampere * 1e-3, rel=1e-9)


def test_a_servo_lets_go_by_itself_of_heat_shock_and_overload_and_not_of_a_weak_supply() -> None:
    """Bits 2, 4 and 5 of item 63: 52, what an XM430 leaves the factory with."""
    assert int(reg.SHUTDOWN_ERRORS) == 52
