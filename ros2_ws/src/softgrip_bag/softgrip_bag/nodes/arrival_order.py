# SPDX-License-Identifier: Apache-2.0
"""Only for bags of before nodes ordered their inputs by stamp: finds the order in which a node had worked on them.

Such a node used a latched message from its arrival on, and a bag does not say when that was; but each result names the
configuration that it was computed with. Orders are tried out on other nodes of its kind until one explains the results.
Which messages of a best-effort stream the node got is read off its results, too: each carries the stamp of the message
it was computed from. Today's nodes use a latched message without a stamp from its arrival on, so those that are fed
here lose theirs.
"""

from __future__ import annotations

import itertools
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.nodes.messages import message_class, stamp_in, stamp_of
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replayed_node import Fed, Output, ReplayedNode
from softgrip_bag.reader import RawMessage, in_order
from softgrip_nodekit import to_time_message

#: Fields that name the configuration a result was computed with.
CONFIGURATION_FIELDS = ("friction_model", "friction_digest", "configuration")
#: [ns] a node may be this much behind: what it works on was published so long before a latched message that it knows.
BEHIND_NS = 2_000_000_000
#: So many messages before the first recorded answer the node may have answered before the recorder found its topic.
MAX_EARLY = 60


def feed_by_arrival(bag: RecordedBag, make: Callable[[], ReplayedNode], driver: str, result: str) -> Fed:
    """Feed a node what it had worked on, in the order in which it had.

    Args:
        bag: to read.
        make: returns a node as it is before it has heard anything.
        driver: topic of the driving stream.
        result: topic of what the node says to it.
    """
    return _ArrivalSearch(bag, make, driver, result).run()


class _ArrivalSearch:
    def __init__(self, bag: RecordedBag, make: Callable[[], ReplayedNode], driver: str, result: str) -> None:
        self._bag = bag
        self._make = make
        self._node = make()
        self._driver = driver
        self._result = result
        self._results = _configurations(bag, result)
        self._fed: list[RawMessage] = []  # latched; one that changes nothing leaves what an earlier did
        self._pending: dict[str, list[RawMessage]] = {}
        self._outputs: dict[str, list[Output]] = defaultdict(list)
        self._last: tuple[str, ...] | None = None
        self._probe: ReplayedNode | None = None  # has heard what the node has
        self._stamps: set[int] = set()

    def run(self) -> Fed:
        topics = self._node.inputs & set(self._bag.types)
        latched = self._bag.latched & topics
        self._pending = {topic: [] for topic in sorted(latched)}
        for message in sorted(self._bag.read(latched), key=lambda message: message.published):
            self._pending[message.topic].append(_without_stamp(message))
        early: deque[RawMessage] = deque(maxlen=MAX_EARLY)
        start = 0
        for message in in_order(self._bag.read(topics - latched)):
            if message.topic == self._driver:
                stamp = stamp_in(message.data, message_class(message.type_name))
                configuration = self._results.get(stamp)
                if configuration is None:
                    # this one never reached the node, the node had nothing to say about it, or nobody recorded that yet
                    if not start:
                        early.append(message)
                    continue
                self._configure(message, configuration)
                if not start:
                    start = stamp
                    self._catch_up(list(early), message, start)
            self._feed(message)
        return Fed(self._outputs, start, self._stamps, self._node.topics)

    def _catch_up(self, early: Sequence[RawMessage], message: RawMessage, start: int) -> None:
        """Feed what the node had worked on before the recorder heard its first answer: as much as explains that one."""
        answers = self._bag.read({self._result})
        recorded = next(raw for raw in answers if stamp_in(raw.data, message_class(raw.type_name)) == start)
        for count in range(len(early) + 1):
            begun = early[len(early) - count :]
            probe = self._make()
            for one in [*self._fed, *begun]:
                probe.feed(one)
            if any(output.topic == self._result and output.data == recorded.data for output in probe.feed(message)):
                for one in begun:
                    self._node.feed(one)
                return

    def _configure(self, message: RawMessage, configuration: tuple[str, ...]) -> None:
        """Feed the latched messages that had reached the node before it worked on ``message``.

        What was published before it most likely had. When the recorder received either says little: it may lag, too.
        """
        arrived = self._waiting(message.published)
        if configuration == self._last and not any(arrived.values()):
            return
        possible = self._waiting(message.published + BEHIND_NS)
        choices = [
            dict(zip(possible, counts, strict=True))
            for counts in itertools.product(*(range(maximum + 1) for maximum in possible.values()))
        ]
        choices.sort(key=lambda counts: sum(abs(counts[topic] - arrived[topic]) for topic in counts))
        if len(choices) == 1:  # nothing new is near
            chosen = arrived
        else:
            chosen = next((c for c in choices if self._explains(self._first(c), message, configuration)), arrived)
        for latched in self._first(chosen):
            self._fed.append(latched)
            self._feed(latched)
            self._pending[latched.topic].remove(latched)
        self._last = configuration

    def _waiting(self, until: int) -> dict[str, int]:
        return {topic: sum(1 for m in waiting if m.published <= until) for topic, waiting in self._pending.items()}

    def _first(self, counts: Mapping[str, int]) -> list[RawMessage]:
        first = [message for topic, count in counts.items() for message in self._pending[topic][:count]]
        return sorted(first, key=lambda message: message.published)

    def _explains(self, candidates: Sequence[RawMessage], message: RawMessage, configuration: tuple[str, ...]) -> bool:
        # The one that was tried last goes on from there. What it has heard it cannot forget: its no says nothing.
        if self._probe is not None and self._answers(self._probe, candidates, message, configuration):
            return True
        fresh = self._make()
        self._probe = fresh if self._answers(fresh, [*self._fed, *candidates], message, configuration) else None
        return self._probe is not None

    @staticmethod
    def _answers(
        probe: ReplayedNode, latched: Sequence[RawMessage], message: RawMessage, configuration: tuple[str, ...]
    ) -> bool:
        for one in latched:
            probe.feed(one)
        return any(_configuration(output.message) == configuration for output in probe.feed(message))

    def _feed(self, message: RawMessage) -> None:
        self._stamps.add(stamp_in(message.data, message_class(message.type_name)))
        for output in self._node.feed(message):
            self._outputs[output.topic].append(output)


def _configurations(bag: RecordedBag, topic: str) -> dict[int, tuple[str, ...]]:
    """Return stamp [ns] -> configuration that it was computed with, of every recorded result."""
    messages = (deserialize_message(raw.data, message_class(raw.type_name)) for raw in bag.read({topic}))
    return {stamp_of(message): _configuration(message) for message in messages}


def _configuration(message: object) -> tuple[str, ...]:
    return tuple(getattr(message, name) for name in CONFIGURATION_FIELDS if hasattr(message, name))


def _without_stamp(raw: RawMessage) -> RawMessage:
    message = deserialize_message(raw.data, message_class(raw.type_name))
    message.header.stamp = to_time_message(0)
    return replace(raw, data=bytes(serialize_message(message)))
