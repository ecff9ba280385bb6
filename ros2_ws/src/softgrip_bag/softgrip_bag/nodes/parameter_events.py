# SPDX-License-Identifier: Apache-2.0
"""/parameter_events without secrets: every node publishes there what its parameters are set to."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.redaction import redact_value

PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"


def without_secrets(data: bytes) -> bytes:
    """Return the event with secrets taken out; the same bytes when there are none.

    Bytes that are not such a message go into the bag as they are: nobody can read a secret from them as a parameter.
    """
    try:
        event = deserialize_message(data, ParameterEvent)
    except Exception:  # noqa: BLE001  each middleware has its own for bytes that are no such message
        return data
    parameters = (*event.new_parameters, *event.changed_parameters)
    hidden = [_redact(parameter) for parameter in parameters]
    return bytes(serialize_message(event)) if any(hidden) else data


def _redact(parameter: Any) -> bool:
    value = parameter.value
    text = redact_value(parameter.name, value.string_value)
    texts = redact_value(parameter.name, list(value.string_array_value))
    is_secret = text != value.string_value or texts != list(value.string_array_value)
    value.string_value, value.string_array_value = text, texts
    return bool(is_secret)
