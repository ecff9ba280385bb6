# SPDX-License-Identifier: Apache-2.0
"""Limits of a tendon drive, in layers: request <= soft limit < hard limit < what the device enforces < what breaks."""

from __future__ import annotations

from dataclasses import dataclass

from softgrip_driver.errors import ConfigurationError


@dataclass(frozen=True)
class TendonLimits:
    """What one drive may do and when its guards speak.

    Attributes:
        travel: [m] longest pulled length.
        speed, acceleration: [m/s], [m/s^2] fastest motion; release_speed [m/s] of a slow release.
        tension_soft: [N] largest tension a request may ask for, and the default limit.
        tension_hard: [N] above it the drive stops and the fault stays.
        tension_slack: [N] below it the tendon counts as slack.
        tension_hold: [N] while holding after a fault or a command time-out.
        slack_travel: [m] of pulling without tension before the tendon counts as slack.
        break_drop_from: [N] a tension at least this high that vanishes means a broken tendon.
        break_confirm: [s] that the tension must stay away.
        stall_time: [s] without motion before a move counts as stalled.
        max_following_error: [m] by which the set-point may run ahead of the drive.
        position_tolerance: [m] within which a target counts as reached.
        tension_tolerance: relative, for moves to a tension.
        max_load: share of a servo's stall torque that it bears for long before its own overload shutdown; 1 = any.
        temperature_limit: [degC] of the device; derating starts 15 below it, the stop is 5 below it.
        no_reply: [s] without an answer before the drive counts as lost.
        homing_tension: [N] at which the tendon counts as taut; homing_speed [m/s]; homing_travel [m] cap;
        homing_timeout: [s].
    """

    travel: float = 0.035
    speed: float = 0.05
    acceleration: float = 0.5
    release_speed: float = 0.01
    tension_soft: float = 35.0
    tension_hard: float = 45.0
    tension_slack: float = 0.5
    tension_hold: float = 10.0
    slack_travel: float = 0.008
    break_drop_from: float = 3.0
    break_confirm: float = 0.04
    stall_time: float = 0.4
    max_following_error: float = 0.006
    position_tolerance: float = 3e-4
    tension_tolerance: float = 0.1
    max_load: float = 1.0
    temperature_limit: float = 70.0
    no_reply: float = 0.05
    homing_tension: float = 1.5
    homing_speed: float = 0.01
    homing_travel: float = 0.05
    homing_timeout: float = 15.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ConfigurationError(f"limit '{name}': expected a number above 0, found {value}")
        order = ("tension_slack", "homing_tension", "tension_soft", "tension_hard")
        values = [getattr(self, name) for name in order]
        if values != sorted(values):
            raise ConfigurationError(
                f"tension limits: expected {' <= '.join(order)}, found {dict(zip(order, values, strict=True))}"
            )

    @property
    def derate_from(self) -> float:
        """[degC] above which the tension limit shrinks."""
        return self.temperature_limit - 15.0

    @property
    def stop_at(self) -> float:
        """[degC] at which motion stops."""
        return self.temperature_limit - 5.0


#: parameter name of each limit: its quantity and unit
LIMIT_PARAMETERS: dict[str, str] = {
    "travel": "travel_m",
    "speed": "speed_m_s",
    "acceleration": "acceleration_m_s2",
    "release_speed": "release_speed_m_s",
    "tension_soft": "tension_soft_n",
    "tension_hard": "tension_hard_n",
    "tension_slack": "tension_slack_n",
    "tension_hold": "tension_hold_n",
    "slack_travel": "slack_travel_m",
    "break_drop_from": "break_drop_from_n",
    "break_confirm": "break_confirm_s",
    "stall_time": "stall_time_s",
    "max_following_error": "max_following_error_m",
    "position_tolerance": "position_tolerance_m",
    "tension_tolerance": "tension_tolerance",
    "max_load": "max_load_share",
    "temperature_limit": "temperature_limit_degc",
    "no_reply": "no_reply_s",
    "homing_tension": "homing_tension_n",
    "homing_speed": "homing_speed_m_s",
    "homing_travel": "homing_travel_m",
    "homing_timeout": "homing_timeout_s",
}
