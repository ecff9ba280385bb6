# SPDX-License-Identifier: Apache-2.0
"""Each servo model with the very limits that its table allows: it homes and closes the emulated fingers."""

from dataclasses import replace

import pytest

from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import MoveOutcome

RADIUS_M = 0.010


def bench_of(name):
    needs = MODELS[name].needs
    limits = replace(
        TendonLimits(no_reply=0.05), homing_tension=needs.homing_torque / RADIUS_M,
        speed=min(TendonLimits().speed, needs.speed * RADIUS_M),
        acceleration=min(TendonLimits().acceleration, needs.acceleration * RADIUS_M),
    )  # fmt: skip
    return {"model": name, "limits": limits, "rate": needs.loop_rate}


@pytest.mark.parametrize(
    "bench", [bench_of(name) for name in ("XC330-M288", "XC330-T288", "XM430-W210", "XM430-W350")], indirect=True
)
def test_a_model_homes_and_closes_within_its_limits(bench):
    limits = bench.controller.drives["index"].limits
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 30.0)
    assert outcome is MoveOutcome.REACHED, reason
    taut = bench.plant.wound_m() - bench.plant.bank.slack_m
    assert [drive.length for drive in bench.loop.snapshot.drives] == pytest.approx(taut, abs=4e-4)
    outcome, reason = bench.run(bench.move([0.015], limits.speed))
    assert outcome is MoveOutcome.REACHED, reason
