# SPDX-License-Identifier: Apache-2.0
"""Who was there, has gone, and comes back: the publishers of a node's inputs, and the other nodes of the cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

#: DDS tells of a publisher before it knows its node (rmw_dds_common, graph_cache.cpp).
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


class Presence:
    """Tells of names that disappear, and of those that come back; a name's first appearance is no news.

    Args:
        on_change: called with the name and whether it is there.
    """

    def __init__(self, on_change: Callable[[str, bool], None]) -> None:
        self._on_change = on_change
        self._there: set[str] = set()
        self._gone: set[str] = set()

    def update(self, names: Iterable[str]) -> None:
        """Take what is there now."""
        there = set(names)
        gone, back = self._there - there, self._gone & there
        self._there, self._gone = there, (self._gone | gone) - back
        for name in sorted(gone):
            self._on_change(name, False)
        for name in sorted(back):
            self._on_change(name, True)


def published_inputs(node: Node) -> list[str]:
    """Return the streams and states a node listens to that have a publisher.

    Streams are best effort and states are latched (docs/conventions.md); whoever sends commands may come and go.
    """
    watched = [subscription for subscription in node.subscriptions if _is_stream_or_state(subscription)]
    return [subscription.topic_name for subscription in watched if subscription.get_publisher_count() > 0]


def diagnosed_nodes(node: Node) -> list[str]:
    """Return the names of the nodes that report on /diagnostics: those of this cell, not those of tools or others."""
    own = node.get_namespace().rstrip("/")
    publishers = node.get_publishers_info_by_topic("/diagnostics")
    names = [
        f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
        for publisher in publishers
        if publisher.node_name != _UNKNOWN
    ]
    return [name for name in names if name.startswith(f"{own}/")]


def _is_stream_or_state(subscription: Any) -> bool:
    qos = subscription.qos_profile
    is_stream = qos.reliability == ReliabilityPolicy.BEST_EFFORT
    return bool(is_stream or qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
