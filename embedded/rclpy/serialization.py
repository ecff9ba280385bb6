# SPDX-License-Identifier: Apache-2.0
"""Messages to CDR and back."""

from typing import Any

from embedded_ros import messages


def serialize_message(message: Any) -> bytes:
    """Return the CDR of a message."""
    return bytes(messages.serialize(message))


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    """Return the message that CDR holds."""
    return messages.deserialize(bytes(serialized_message), message_type)
