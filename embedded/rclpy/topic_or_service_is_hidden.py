# SPDX-License-Identifier: Apache-2.0
"""Names that tools do not show."""

from rclpy.validate_topic_name import TOPIC_SEPARATOR_STRING

HIDDEN_TOPIC_PREFIX = "_"


def topic_or_service_is_hidden(name: str) -> bool:
    """Whether a part of the name starts with an underscore."""
    return any(part.startswith(HIDDEN_TOPIC_PREFIX) for part in name.split(TOPIC_SEPARATOR_STRING) if part)
