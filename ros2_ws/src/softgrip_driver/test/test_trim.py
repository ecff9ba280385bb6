# SPDX-License-Identifier: Apache-2.0
"""What is added to a setpoint under load, and how it goes when the load has gone."""

import pytest

from softgrip_driver.tendon.motions import DriveObservation, MotionStep, MoveOutcome
from softgrip_driver.tendon.trim import Trim

DT = 0.01  # [s]


def seconds_until(trim, error_m, reached):
    """Let a drive stand beside its goal by so much until a condition holds; return how long that takes [s]."""
    for count in range(1000):
        if reached(trim.value):
            return count * DT
        view = DriveObservation(count * DT, DT, 0.010 - error_m, 0.0, tension=5.0, pull=5.0, tension_cap=45.0)
        trim.step(MotionStep(0.010, 35.0), view)
    raise AssertionError("never reached")


def test_what_pulled_at_a_load_that_is_gone_goes_faster_than_it_came():
    trim = Trim(max_following_error=0.006)
    came = seconds_until(trim, 1e-3, lambda value: value >= 1e-3)
    went = seconds_until(trim, -1e-3, lambda value: value <= 0.0)
    assert went < 0.4 * came


@pytest.mark.parametrize("error_m", [1e-4, -1e-4])
def test_next_to_its_goal_a_drive_is_corrected_as_slowly_in_as_out(error_m):
    """A hold's noise would else wear its trim away."""
    trim = Trim(max_following_error=0.006)
    trim.value = 1e-3
    view = DriveObservation(0.0, DT, 0.010 - error_m, 0.0, tension=5.0, pull=5.0, tension_cap=45.0)
    trim.step(MotionStep(0.010, 35.0), view)
    assert trim.value - 1e-3 == pytest.approx(Trim.RATE * error_m * DT)


def test_a_servo_half_as_stiff_as_its_manual_says_closes_quickly_all_the_same(bench):
    """Rhoban's bam project saw that of an XL330 (docs/emulator.md); the thumb's tendon needs some 28 N at 15 mm."""
    for servo in bench.plant.servos:
        servo.motion.stiffness = 0.5
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 30.0)
    assert outcome is MoveOutcome.REACHED, reason
    outcome, reason = bench.run(bench.move([0.015], 0.05))
    assert outcome is MoveOutcome.REACHED, reason
    assert bench.plant.bank.tension_n.max() > 25.0
