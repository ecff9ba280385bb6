# SPDX-License-Identifier: Apache-2.0
"""Limits of a tendon by the names of the node's parameters."""

from __future__ import annotations

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
    "temperature_limit": "temperature_limit_degc",
    "no_reply": "no_reply_s",
    "homing_tension": "homing_tension_n",
    "homing_speed": "homing_speed_m_s",
    "homing_travel": "homing_travel_m",
    "homing_timeout": "homing_timeout_s",
}
