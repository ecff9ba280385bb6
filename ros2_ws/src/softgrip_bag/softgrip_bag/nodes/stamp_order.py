# SPDX-License-Identifier: Apache-2.0
"""Feeds a node by the stamps of its inputs, which its outputs are a function of.

A node orders its inputs by itself (softgrip_nodekit/event_time.py). What it could not order, because it came too late
or the node was not there yet, it wrote down in its ``~/input_notes``; and which messages of a best-effort stream
reached it shows in its results, each of which has the stamp of the message that it was computed from.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

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
    """Feed a node what it had worked on, by stamps; a node that was started again, run by run.

    Args:
        bag: to read.
        make: returns a node as it is before it has heard anything.
        driver: topic of the driving stream.
        result: topic of what the node says to it.
    """
    answered = {stamp_in(raw.data, message_class(raw.type_name)) for raw in bag.read({result})}
    first_answer = min(answered, default=0)
    node = make()
    outputs: dict[str, list[Output]] = defaultdict(list)
    stamps = set()
    for number, run in enumerate(_runs(bag, node.name, driver) or [_Run(first_answer)]):
        node = make() if number else node
        for raw in run.inputs(bag, node.inputs & set(bag.types), driver, is_again=number > 0):
            stamp = stamp_in(raw.data, message_class(raw.type_name))
            # before its first recorded result a node answered all that it got; nobody listened yet
            if raw.topic == driver and stamp not in answered and stamp >= first_answer:
                continue
            stamps.add(stamp)
            for output in node.feed(raw):
                outputs[output.topic].append(output)
    return Fed(outputs, first_answer, stamps, node.topics)


@dataclass
class _Run:
    """One run of a node.

    Attributes:
        first: stamp of the first driving message that it got [ns].
        end: that of the next run; None = there is none [ns].
        late: (topic, stamp [ns]) of what it could not order -> stamps [ns] of the driving messages it came after.
    """

    first: int
    end: int | None = None
    late: dict[tuple[str, int], list[int]] = field(default_factory=lambda: defaultdict(list))

    def inputs(self, bag: RecordedBag, topics: set[str], driver: str, *, is_again: bool) -> Iterator[RawMessage]:
        """Yield what the node got, in the order of stamps."""
        unheard = _unheard(bag, topics & bag.latched, self.first) if is_again else ()
        heard = (raw for raw in bag.read(topics) if raw not in unheard)
        for raw in in_order(heard, _Places(bag, driver, self.late)):
            stamp = stamp_in(raw.data, message_class(raw.type_name))
            if raw.topic in bag.latched or (self.first <= stamp and (self.end is None or stamp < self.end)):
                yield raw


def _runs(bag: RecordedBag, node: str, driver: str) -> list[_Run]:
    runs: list[_Run] = []
    for note in (deserialize_message(raw.data, message_class(raw.type_name)) for raw in bag.read({f"{node}/{NOTES}"})):
        if note.topic == driver:
            runs.append(_Run(stamp_of(note)))
            if len(runs) > 1:
                runs[-2].end = runs[-1].first
        elif runs:
            runs[-1].late[note.topic, stamp_of(note)].append(nanoseconds(note.after))
    return runs


def _unheard(bag: RecordedBag, latched: set[str], since: int) -> list[RawMessage]:
    """Return the latched messages that a node does not get that is started later [ns]: all but the last of a topic."""
    last: dict[str, RawMessage] = {}
    unheard = []
    for raw in bag.read(latched):
        if _input_stamp(raw) < since:
            unheard += [last[raw.topic]] if raw.topic in last else []
            last[raw.topic] = raw
    return unheard


class _Places:
    """Says where an input of a run is in the order: a stamp of the driving stream [ns], and on which side of it."""

    def __init__(self, bag: RecordedBag, driver: str, late: dict[tuple[str, int], list[int]]) -> None:
        self._latched = bag.latched
        self._driver = driver
        self._late = {key: list(after) for key, after in late.items()}
        self._last: dict[str, tuple[int, int]] = {}

    def __call__(self, raw: RawMessage) -> tuple[int, int]:
        topic = raw.topic
        is_latched = topic in self._latched
        stamp = _input_stamp(raw) if is_latched else stamp_in(raw.data, message_class(raw.type_name))
        own = (stamp, _AT if topic == self._driver else _BEFORE)
        if self._late.get((topic, stamp)):
            own = self._late[topic, stamp].pop(0), _AFTER
        self._last[topic] = max(own, self._last.get(topic, own))  # each topic keeps its own order
        return self._last[topic]


def _input_stamp(raw: RawMessage) -> int:
    """Return from when on a recorded input holds [ns]."""
    return input_stamp_ns(deserialize_message(raw.data, message_class(raw.type_name)))
