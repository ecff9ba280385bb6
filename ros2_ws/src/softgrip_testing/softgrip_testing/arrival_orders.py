# SPDX-License-Identifier: Apache-2.0
"""Orders in which messages of several topics may arrive: each topic keeps its own, and each has its largest delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random
from typing import TypeVar

Item = TypeVar("Item")


def arrive(
    streams: Mapping[str, Sequence[tuple[int, Item]]], max_delay_ns: Mapping[str, int], random: Random
) -> list[tuple[str, Item]]:
    """Draw an order of arrival.

    Args:
        streams: topic -> (stamp [ns], item), in the order that the topic keeps.
        max_delay_ns: topic -> how much later than its stamp an item may arrive, at most [ns]; exclusive.
        random: decides.

    Returns:
        (topic, item) in order of arrival.
    """
    arrivals: list[tuple[int, float, str, Item]] = []
    for topic, items in streams.items():
        # a quiet network, a busy one, and one that hands everything over at the last moment
        low, high = random.choice([(0.0, 0.1), (0.0, 1.0), (0.9, 1.0)])
        arrival, tie = 0, 0.0
        for stamp, item in items:
            delay = min(round(random.uniform(low, high) * max_delay_ns[topic]), max(max_delay_ns[topic] - 1, 0))
            due = stamp + delay
            tie = random.random() if due > arrival else tie  # what arrives together keeps the topic's order
            arrival = max(due, arrival)
            arrivals.append((arrival, tie, topic, item))
    arrivals.sort(key=lambda each: each[:3])
    return [(topic, item) for _, _, topic, item in arrivals]
