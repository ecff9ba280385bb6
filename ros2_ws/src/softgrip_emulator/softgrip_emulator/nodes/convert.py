# SPDX-License-Identifier: Apache-2.0
"""Between the cell's values and messages: the only place of this package where one becomes the other."""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.parameter import parameter_value_to_python
from std_msgs.msg import Header

from softgrip_emulator.cell import EmulatedFingerReading, Truth
from softgrip_emulator.errors import EmulatorError
from softgrip_interfaces.msg import EmulatorTruth, FingerState


def to_truth_message(truth: Truth, stamp: Time) -> EmulatorTruth:
    """The truth as a message."""
    message = EmulatorTruth()
    message.header = Header(stamp=stamp, frame_id="")
    message.fingers = [_to_finger_state(finger) for finger in truth.fingers]
    message.product = truth.grasp.product
    message.touching = bool(truth.grasp.touching)
    message.held = bool(truth.grasp.held)
    message.slipped = bool(truth.grasp.slipped)
    message.crushed = bool(truth.grasp.crushed)
    message.contact_forces = [float(force) for force in truth.grasp.contact_forces_n]
    message.active_faults = list(truth.active_faults)
    return message


def _to_finger_state(finger: EmulatedFingerReading) -> FingerState:
    message = FingerState()
    message.finger = finger.slot
    message.profile = finger.profile
    message.pulled_length = float(finger.pulled_length_m)
    message.tension = float(finger.tension_n)
    message.joint_angles = [float(angle) for angle in finger.joint_angles_rad]
    message.tip = Point(x=float(finger.tip_m[0]), y=float(finger.tip_m[1]), z=0.0)
    message.tip_stddev = [math.nan, math.nan]
    message.contact_tensions = [float(tension) for tension in finger.span_tensions_n]
    message.validity = FingerState.OK
    return message


def to_fault_arguments(arguments: Sequence[ParameterMessage]) -> dict[str, object]:
    """Return the arguments of a fault: name -> number or text.

    Raises:
        EmulatorError: an argument without a name or a value, or a name that comes twice.
    """
    found: dict[str, object] = {}
    for argument in arguments:
        value = parameter_value_to_python(argument.value)
        if not argument.name or argument.name in found or value is None:
            raise EmulatorError(
                f"arguments: expected names that differ, each with a value, found {argument.name!r} with {value!r}; "
                "e.g. {name: share, value: {type: 3, double_value: 0.05}} (rcl_interfaces/ParameterType)"
            )
        found[argument.name] = value
    return found
