# SPDX-License-Identifier: Apache-2.0
"""Feeds a node by the stamps of its inputs, which its outputs are a function of.

A node orders its inputs by itself (softgrip_nodekit/event_time.py). What it could not order, because it came too late
or the node was not there yet, it wrote down in its ``~/input_notes``; and which messages of a best-effort stream
reached it shows in its results, each of which has the stamp of the message that it was computed from.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from rclpy.serialization import deserialize_message

from softgrip_bag.nodes.messages import message_class, stamp_in, stamp_of
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replayed_node import Fed, Output, ReplayedNode
from softgrip_bag.reader import RawMessage, in_order
from softgrip_nodekit import input_stamp_ns, nanoseconds

#: Topic of a node's `InputNote`s, below its name.
NOTES = "input_notes"
#: Where in the order an input with the stamp of one of the driving stream is: before it, itself, after it.
_BEFORE, _AT, _AFTER = -1, 0, 1


def feed_by_stamp(bag: RecordedBag, make: Callable[[], ReplayedNode], driver: str, result: str) -> Fed:
    """Feed a node what it had worked on, by stamps.

    Args:
        bag: to read.
        make: returns a node as it is before it has heard anything.
        driver: topic of the driving stream.
        result: topic of what the node says to it.
    """
    node = make()
    noted = _noted(bag, node.name)
    answered = {stamp_in(raw.data, message_class(raw.type_name)) for raw in bag.read({result})}
    first_answer = min(answered, default=0)

    last: dict[str, tuple[int, int]] = {}

    def place(raw: RawMessage) -> tuple[int, int]:
        """Return where an input is in the order: a stamp of the driving stream [ns], and on which side of it."""
        kind = message_class(raw.type_name)
        latched = raw.topic in bag.latched
        stamp = input_stamp_ns(deserialize_message(raw.data, kind)) if latched else stamp_in(raw.data, kind)
        own = (stamp, _AT if raw.topic == driver else _BEFORE)
        if raw.topic != driver and noted.get((raw.topic, stamp)):
            own = noted[raw.topic, stamp].pop(0), _AFTER
        last[raw.topic] = max(own, last.get(raw.topic, own))  # each topic keeps its own order
        return last[raw.topic]

    first = next((stamp for topic, stamp in noted if topic == driver), first_answer)
    outputs: dict[str, list[Output]] = defaultdict(list)
    stamps = set()
    for raw in in_order(bag.read(node.inputs & set(bag.types)), place):
        stamp = stamp_in(raw.data, message_class(raw.type_name))
        # before its first recorded result a node answered all that it got; nobody listened yet
        if raw.topic == driver and not (stamp in answered or first <= stamp < first_answer):
            continue
        stamps.add(stamp)
        for output in node.feed(raw):
            outputs[output.topic].append(output)
    return Fed(outputs, first_answer, stamps)


def _noted(bag: RecordedBag, node: str) -> dict[tuple[str, int], list[int]]:
    """Return (topic, stamp [ns]) of what a node could not order -> stamps [ns] of the driving stream it came after."""
    notes = bag.read({f"{node}/{NOTES}"})
    found: dict[tuple[str, int], list[int]] = defaultdict(list)
    for note in (deserialize_message(raw.data, message_class(raw.type_name)) for raw in notes):
        found[note.topic, stamp_of(note)].append(nanoseconds(note.after))
    return found
