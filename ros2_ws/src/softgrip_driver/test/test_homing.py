# SPDX-License-Identifier: Apache-2.0
"""Homing as the one motion it is, with what the drive reports written by hand."""

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


@pytest.mark.parametrize("excess", [0.0, 0.008])
def test_a_drive_that_turned_round_too_fast_is_not_taken_for_one_that_pulls(excess):
    """A servo that lags behind its goal at the turn winds in too fast at first; braking it takes a negative current."""
    now, length, speed = 0.0, 0.0, 0.0
    homing = Homing(View(now, PERIOD, length, speed, 0.0, 0.0, 45.0), LIMITS)
    lowest = -LIMITS.slack_travel
    letting_out = True
    while homing.zero is None:
        stretch = max(0.0, length - TAUT)
        letting_out = letting_out and length > lowest + 1e-4
        # 8 mm of slack: an excess of speed dies away over 1.5 mm from the end of the run-up on
        decay = np.exp(-max(0.0, length - lowest - Homing.RUN_UP) / 0.0015)
        speed = -LIMITS.release_speed if letting_out else LIMITS.homing_speed + excess * decay
        braking = 0.0 if letting_out or length < lowest + Homing.RUN_UP else -2.0 * decay * (excess > 0.0)
        pull = STIFFNESS * stretch + GEARS + braking
        if pull >= LIMITS.homing_tension:
            speed, pull = 0.0, LIMITS.homing_tension
        homing.step(View(now, PERIOD, length, speed, max(0.0, pull), pull, 45.0))
        now, length = now + PERIOD, max(lowest, length + speed * PERIOD)
        assert now < LIMITS.homing_timeout
    assert homing.zero == pytest.approx(TAUT, abs=3e-4)
