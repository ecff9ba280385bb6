# SPDX-License-Identifier: Apache-2.0
"""docs/build: what is written of servos is what the drivers have of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from softgrip_driver.damiao.frames import MODELS as DAMIAO
from softgrip_driver.dynamixel.registers import MODELS as DYNAMIXEL
from softgrip_driver.feetech.registers import MODELS as FEETECH

BUILD = Path(__file__).parents[2] / "docs" / "build"
ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \| ([\d.]+) V \| ([\d.]+) A[^|]*\| ([^|]+) \|$", re.MULTILINE)
ROWS = {row[0]: row[1:] for row in ROW.findall((BUILD / "bill.md").read_text(encoding="utf-8"))}
WIRING = (BUILD / "wiring.md").read_text(encoding="utf-8")


def test_the_bill_has_a_row_for_every_servo_that_the_drivers_know() -> None:
    assert {*ROWS} == {*DYNAMIXEL, *FEETECH, *DAMIAO}


@pytest.mark.parametrize("name", [*DYNAMIXEL, *FEETECH])
def test_a_servos_supply_in_the_bill_is_that_which_the_wizard_accepts(name: str) -> None:
    model = (DYNAMIXEL | FEETECH)[name]
    order, takes, rated, stall, source = ROWS[name]
    low, high = model.voltage_range
    assert takes == f"{low:g} to {high:g} V"
    assert float(rated) == model.rated_voltage
    assert float(stall) == pytest.approx(model.stall_current, abs=0.05)
    assert order
    assert source


def test_a_damiao_motors_current_is_that_of_its_largest_torque() -> None:
    for name, model in DAMIAO.items():
        assert float(ROWS[name][3]) == pytest.approx(model.stall_torque / model.torque_per_ampere, abs=0.05)


@pytest.mark.parametrize("name", ROWS)
def test_the_wiring_names_every_servo_under_its_voltage_and_no_other(name: str) -> None:
    named = [
        float(volts)
        for volts, servos in re.findall(r"^ +\| ([\d.]+) V \| (.+) \|$", WIRING, re.MULTILINE)
        if any(name.startswith(re.split(r"[ ;]", word)[0]) for word in servos.split(", "))
    ]
    assert named == [float(ROWS[name][2])]
