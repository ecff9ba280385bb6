# SPDX-License-Identifier: Apache-2.0
"""Homing on pseudo-terminals whose far end falls silent: bytes wait in the terminal, as behind a USB hub that hangs."""

import random
import time

import pytest

from softgrip_driver.tendon.homing import ZERO_ACCURACY
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, MoveOutcome

#: [s] of one silence: longer than may pass unseen at 10 mm/s, shorter than the servos' watchdog on a busy machine
SHORTEST, LONGEST = 0.12, 0.3
#: what may be said of it
NAMED = {"homing_interrupted", "no_reply", "bus_watchdog"}


class SilentNowAndThen:
    """A wire that keeps for a while what it got; its servos live on.

    Args:
        wire: the wire behind it.
        dice: when one of three silences comes while `is_on`, and how long it is.
    """

    def __init__(self, wire, dice):
        self._wire, self._dice = wire, dice
        self.is_on, self.left = False, 3

    def __getattr__(self, name):
        return getattr(self._wire, name)

    def exchange(self, data, now_s, baud):
        if self.is_on and self.left and self._dice.random() < 0.02:
            self.left -= 1
            time.sleep(self._dice.uniform(SHORTEST, LONGEST))
        return self._wire.exchange(data, now_s, baud)


@pytest.fixture(params=range(3))
def silent(benches, tmp_path, world, request):
    """A bench and its wire; the driver waits for replies so long that a silence loses no drive."""
    dice, wires = random.Random(request.param), []

    def around(wire):
        wires.append(SilentNowAndThen(wire, dice))
        return wires[0]

    bench = benches[0](tmp_path, world, rate=100.0, limits=TendonLimits(no_reply=0.6), around=around)
    bench.bus.port.reply_margin = 0.1
    yield bench.open(), wires[0]
    bench.close()


def test_a_zero_on_a_bus_that_falls_silent_is_right_or_a_fault(silent):
    bench, wire = silent
    bench.loop.power(on=True)
    ticket = bench.loop.call(lambda controller, now: controller.home(now))
    assert bench.until(lambda seen: all(drive.state is DriveState.HOMING for drive in seen.drives))
    wire.is_on = True
    outcome, reason = bench.run(ticket, 30.0)
    wire.is_on = False
    assert wire.left == 0
    if outcome is not MoveOutcome.REACHED:  # the machine was silent besides
        assert {drive.fault for drive in bench.loop.snapshot.drives} & NAMED, reason
    slack = bench.plant.bank.slack_m - bench.plant.wound_m()
    for drive, to_taut in zip(bench.controller.drives.values(), slack, strict=True):
        assert drive.zero is None or abs(drive.zero - drive.position - float(to_taut)) < ZERO_ACCURACY
