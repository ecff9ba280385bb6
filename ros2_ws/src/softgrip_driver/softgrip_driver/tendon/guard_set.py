# SPDX-License-Identifier: Apache-2.0
"""All guards of one drive together: what they see, what they allow, and what they find wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.guards import (
    BreakGuard,
    CollapseGuard,
    JumpGuard,
    MedianFilter,
    OverloadGuard,
    ShutdownGuard,
    SlackGuard,
    TensionGuard,
    ThermalGuard,
)
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, Motion

#: what a fault of a tension that a gauge reads adds: its cut cable shows the same as a broken tendon
GAUGE_HINT = " (look at the tendon: if it is whole and taut, the load cell's cable is cut, and that is to be repaired)"


@dataclass(frozen=True)
class Allowance:
    """What heat and load allow now.

    Attributes:
        tension: [N] the most.
        too_hot: why it must stop, empty when it need not.
        warnings: why less than the limit is allowed, in words.
    """

    tension: float
    too_hot: str
    warnings: tuple[str, ...] = ()


class GuardSet:
    """Guards of one drive.

    Args:
        limits: of the drive.
        continuous_tension: [N] that it may hold for ever.
        period: [s] between steps.
    """

    def __init__(self, limits: TendonLimits, continuous_tension: float, period: float) -> None:
        self._limits = limits
        self._continuous = continuous_tension
        self._filter = MedianFilter()
        self._jump = JumpGuard(limits)
        self._break = BreakGuard(limits, period)
        self._collapse = CollapseGuard(limits)
        self._slack = SlackGuard(limits)
        self._too_much = TensionGuard(limits)
        self._thermal = ThermalGuard(limits)
        self._overload = OverloadGuard(continuous_tension)
        self._shutdown = ShutdownGuard(limits.max_load, limits.tension_hold)

    def forget_jump(self) -> None:
        """Believe the next position, wherever it is."""
        self._jump.reset()

    def forget_break(self) -> None:
        """Forget the tension before: a person has dealt with it."""
        self._break.reset()
        self._collapse.reset()

    @property
    def suspects_break(self) -> bool:
        """Whether the tendon may just have broken."""
        return self._break.suspects or self._collapse.suspects

    @property
    def suspects_collapse(self) -> bool:
        """Whether a gauge has just ceased to show a tendon: nothing may be wound in until it is known why."""
        return self._collapse.suspects

    def believes(self, reading: DriveReading) -> bool:
        """Return whether the drive can have got to where a reading says it is."""
        return self._jump.step(reading.time, reading.position)

    @property
    def lost(self) -> bool:
        """Whether the position has stayed where it cannot be."""
        return self._jump.lost

    def tension(self, reading: DriveReading) -> float:
        """Return the tension [N] without single wild samples."""
        return self._filter.step(reading.tension)

    def allows(self, temperature: float, tension: float, dt: float, load: float = math.nan) -> Allowance:
        """Return what is allowed at a temperature [degC] after holding a tension [N] for ``dt`` [s].

        ``load`` is the share of its stall torque that this takes of the motor, NaN where nobody knows.
        """
        share = self._thermal.step(temperature)
        maximum = min(self._overload.step(tension, dt), self._shutdown.step(load, tension, dt))
        warnings: tuple[str, ...] = ()
        if share < 1.0:
            warnings += (f"{temperature:.0f} degC: tension limited to {share:.0%}",)
        if self._overload.backed_off:
            text = f"held more than {self._continuous:.0f} N for long: tension backed off before the winding is too hot"
            warnings += (text,)
        if self._shutdown.backed_off:
            text = f"held more than {self._limits.max_load:.0%} of the motor's stall for long"
            warnings += (f"{text}: tension backed off before the servo lets go",)
        too_hot = f"{temperature:.0f} degC, limit {self._limits.stop_at:.0f} degC" if self._thermal.tripped else ""
        return Allowance(min(share * self._limits.tension_soft, maximum), too_hot, warnings)

    def finds(self, view: DriveObservation, motion: Motion, allowed: float, *, homed: bool) -> tuple[str, str] | None:
        """Return the fault that a motion shows (name, reason), None when all is well.

        Args:
            view: what is measured.
            motion: what is going on.
            allowed: [N] the most that the device may pull.
            homed: the pulled length is known.
        """
        limits, hint = self._limits, GAUGE_HINT if view.is_gauged else ""
        if self._too_much.step(view.now, view.tension, view.acceleration):
            return "tension_exceeded", f"{view.tension:.1f} N, hard limit {limits.tension_hard:.1f} N"
        if motion.paying_out:
            self.forget_break()
        elif found := self._finds_lost_tension(view, motion, allowed):
            return found
        if homed and self._slack.step(
            view.now, view.pulled_length_m, view.tension, pulling=motion.winding_in, acceleration=view.acceleration
        ):
            return "tendon_slack", f"{view.tension:.1f} N at {view.pulled_length_m * 1e3:.1f} mm of pulled length{hint}"
        return None

    def _finds_lost_tension(self, view: DriveObservation, motion: Motion, allowed: float) -> tuple[str, str] | None:
        """Return the fault of a tension that vanished although the tendon was not let out; a little of it is slack."""
        where = f"at {view.pulled_length_m * 1e3:.1f} mm"
        if not view.is_gauged:
            is_broken = self._break.step(
                view.now, view.tension, view.pulled_length_m, stddev=view.stddev, acceleration=view.acceleration,
                allowed=allowed,
            )  # fmt: skip
            return ("tendon_broken", f"tension fell to {view.tension:.1f} N {where}") if is_broken else None
        if not self._collapse.step(view.now, view.pull, view.pulled_length_m, is_wound_in=motion.winding_in):
            return None
        before = self._collapse.before
        name = "tendon_broken" if before >= self._limits.break_drop_from else "tendon_slack"
        return name, f"tension fell from {before:.1f} N to {view.pull:.1f} N {where}{GAUGE_HINT}"
