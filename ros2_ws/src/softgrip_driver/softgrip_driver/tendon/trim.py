# SPDX-License-Identifier: Apache-2.0
"""What a setpoint needs beyond the length it stands for, so that a servo under proportional control gets there."""

from __future__ import annotations

from softgrip_driver.tendon.motions import NATURAL_LAG, DriveObservation, MotionStep, MoveToLength


class Trim:
    """Integral correction of the steady-state position error of a drive that holds.

    What the drive is behind by its motion goes by itself and must not be corrected: it would overshoot.

    Args:
        max_following_error: [m] beyond which an error is not the load's.
    """

    #: [1/s] and [m] of the integral
    RATE = 6.0
    MAX_TRIM_M = 3e-3
    #: [m/N] more under tension: a servo half as stiff as its e-manual says needs 5 mm at 28 N (docs/emulator.md)
    MORE_PER_N = 1e-4
    #: [1/s] at which it goes where its load is gone: the drive stands beyond its goal by more than [m]
    RATE_BACK = 25.0
    BEYOND = 2e-4
    #: natural lags that an error may be worth without being the load's
    MAX_LAGS = 2.0

    def __init__(self, max_following_error: float) -> None:
        self._max_following_error = max_following_error
        #: [m] to add to the setpoint
        self.value = 0.0

    def clear(self) -> None:
        """Start again: nothing is pulled, or from somewhere else."""
        self.value = 0.0

    def step(self, step: MotionStep, view: DriveObservation) -> None:
        """Correct a motion's error; frozen at the tension limit."""
        error = step.pulled_length_m - view.pulled_length_m
        lag = self.MAX_LAGS * NATURAL_LAG * view.speed
        error -= max(min(0.0, lag), min(max(0.0, lag), error))
        if view.tension < MoveToLength.MET * step.tension_limit and abs(error) < self._max_following_error:
            loadless = error * self.value < 0.0 and abs(error) > self.BEYOND
            rate = self.RATE_BACK if loadless else self.RATE
            limit = self._limit(view.tension)
            self.value = max(-limit, min(limit, self.value + rate * error * view.dt))

    def _limit(self, tension: float) -> float:
        """Return the largest correction [m] under a tension [N]."""
        return self.MAX_TRIM_M + self.MORE_PER_N * tension

    def keep_pulling(self, ahead: float, speed: float, tension: float, maximum: float) -> None:
        """Become what goes on pulling a drive that shall stand where it is from now on.

        Proportional control pulls by how far the goal is ahead of the drive, so that share of it gives the tension.

        Args:
            ahead: [m] the setpoint beyond the drive.
            speed: [m/s] of the drive, whose part of ``ahead`` goes with the motion.
            tension: [N] now.
            maximum: [N] to go on with.
        """
        pulling = max(0.0, min(self._limit(tension), ahead + self.value - NATURAL_LAG * speed))
        self.value = pulling * min(1.0, maximum / max(tension, 1e-9))
