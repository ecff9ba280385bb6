# SPDX-License-Identifier: Apache-2.0
"""Waits for one message."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

_LOOK_PERIOD_S = 0.001


def wait_for_message(
    msg_type: Any,
    node: Node,
    topic: str,
    *,
    qos_profile: QoSProfile | int = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Any]:
    """Return (True, message) or (False, None) when time is up; the node need not be spun.

    Args:
        msg_type: message type.
        node: any node.
        topic: topic name.
        qos_profile: QoS of the subscription.
        time_to_wait: seconds, for ever when negative.
    """
    end = None if time_to_wait < 0 else time.monotonic() + time_to_wait
    subscription = node.create_subscription(msg_type, topic, lambda _: None, qos_profile)
    # Taken here and not by an executor, which may be spinning the node.
    node._subscriptions.remove(subscription)
    node._rcl_changed()
    try:
        while node.context.ok() and (end is None or time.monotonic() < end):
            taken = subscription._take()
            if taken is not None:
                return True, taken[1][0]
            time.sleep(_LOOK_PERIOD_S)
    finally:
        subscription.destroy()
    return False, None
