# SPDX-License-Identifier: Apache-2.0
"""Homing as the one motion it is, with what the drive reports written by hand."""

import dataclasses

import numpy as np
import pytest

from softgrip_driver.tendon.homing import Homing
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import View

LIMITS = TendonLimits(homing_speed=0.014, release_speed=0.03)
PERIOD = 0.01  # [s]
STIFFNESS = 500.0  # [N/m] of the tendon once it is taut
GEARS = 0.1  # [N] that turning the gears takes
TAUT = 0.002  # [m]


class Finger:
    """A drive that follows what homing asks of it, but winds in with a speed of its own.

    Where it gets going it is too fast for a while, as a servo that lags behind its goal; braking it takes a negative
    current, from the end of the run-up on and over 1.5 mm.

    Args:
        excess: [m/s] of that speed.
        pauses_at: [m] where the bus pauses once and the drive stands.
        taut: [m] where the tendon becomes taut.
        gears: [N] that is read while nothing pulls.
    """

    def __init__(self, excess=0.0, pauses_at=None, taut=TAUT, gears=GEARS):
        self._excess, self._pauses_at, self._taut, self._gears = excess, pauses_at, taut, gears
        self._paused = 0
        self._going_since = None
        self._asked = 0.0
        self.length = self.furthest_out = 0.0

    def view(self, now, asked):
        """What the drive shows after it has been asked for a length [m]."""
        letting_out, self._asked = asked < self._asked, asked
        if letting_out or asked == self.length:
            self._going_since = None
            return self._shown(now, min(0.0, (asked - self.length) / PERIOD), self._gears)
        self._going_since = self.length if self._going_since is None else self._going_since
        if self._pauses_at is not None and self.length >= self._pauses_at and self._paused < 10:
            self._paused += 1
            self._going_since = self.length
            return self._shown(now, 0.0, self._gears)
        gone = self.length - self._going_since - Homing.RUN_UP
        decay = np.exp(-max(0.0, gone) / 0.0015)
        braking = -2.0 * decay if self._excess and gone >= 0.0 else 0.0
        pull = STIFFNESS * max(0.0, self.length - self._taut) + self._gears + braking
        if pull >= LIMITS.homing_tension:
            self._going_since = None
            return self._shown(now, 0.0, LIMITS.homing_tension)
        return self._shown(now, LIMITS.homing_speed + self._excess * decay, pull)

    def _shown(self, now, speed, pull):
        view = View(now, PERIOD, self.length, speed, max(0.0, pull), pull, 45.0)
        self.length += speed * PERIOD
        self.furthest_out = min(self.furthest_out, self.length)
        return view


def home(finger):
    now, asked = 0.0, 0.0
    homing = Homing(finger.view(now, asked), LIMITS)
    while homing.zero is None:
        now += PERIOD
        assert now < LIMITS.homing_timeout
        asked = homing.step(finger.view(now, asked)).length
    return homing.zero


@pytest.mark.parametrize("excess", [0.0, 0.008])
def test_a_drive_that_turned_round_too_fast_is_not_taken_for_one_that_pulls(excess):
    assert home(Finger(excess)) == pytest.approx(TAUT, abs=3e-4)


@pytest.mark.parametrize("gears", [-0.6, -0.2, 0.3])
def test_what_is_read_while_nothing_pulls_does_not_move_the_zero(gears):
    """A current near nothing is read as a little pull, or as a little push: the knee is where it begins to change."""
    assert home(Finger(gears=gears)) == pytest.approx(TAUT, abs=3e-4)


@pytest.mark.parametrize("pauses_at", [-0.004, -0.0006, 0.0, 0.0009, 0.0012, 0.0030])
def test_a_bus_that_pauses_on_the_way_does_not_move_the_zero(pauses_at):
    """After the pause the drive catches up and is braked; where too little slack is left to see, it begins again."""
    assert home(Finger(0.008, pauses_at)) == pytest.approx(TAUT, abs=5e-4)


@pytest.mark.parametrize(("seen", "again"), [(0.0003, True), (0.0008, True), (0.0012, False), (0.0040, False)])
def test_it_looks_again_from_further_out_where_it_saw_less_than_a_millimetre_of_slack(seen, again):
    """A finger that stood wound in: letting out by the slack's travel leaves little to see behind the run-up.

    What it saw is where it was taut, less where it began to wind in and what it takes to get going.
    """
    began = -LIMITS.slack_travel
    taut = began + Homing.RUN_UP + LIMITS.homing_speed * PERIOD + seen
    finger = Finger(taut=taut)
    assert home(finger) == pytest.approx(taut, abs=3e-4)
    assert bool(finger.furthest_out < began - 1e-3) == again


@pytest.mark.parametrize(("release_speed", "speed"), [(0.020, 0.020), (0.028, 0.028), (0.100, 0.028)])
def test_letting_out_is_as_quick_as_a_release_but_not_quicker_than_twice_the_homing(release_speed, speed):
    """Only the winding in is measured; 8 mm at up to 28 mm/s and the time to get up to speed."""
    limits = dataclasses.replace(LIMITS, release_speed=release_speed)
    finger = Finger()
    homing = Homing(finger.view(0.0, 0.0), limits)
    asked, count = 0.0, 0
    while asked > -LIMITS.slack_travel:
        count += 1
        asked = homing.step(finger.view(count * PERIOD, asked)).length
    least = LIMITS.slack_travel / speed
    assert least < count * PERIOD < least + 2.0 * speed / LIMITS.acceleration
