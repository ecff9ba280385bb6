# SPDX-License-Identifier: Apache-2.0
"""Hands a node the messages of a bag in the order in which it had worked on them, as its recorded answers tell."""

from __future__ import annotations

import itertools
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from softgrip_bag.nodes.captured import Output, ReplayedNode
from softgrip_bag.nodes.old_messages import read
from softgrip_bag.nodes.steps import stamp_in, stamp_of
from softgrip_bag.nodes.types import message_class
from softgrip_bag.reader import RawMessage, as_published, latched_topics

#: Fields that name the configuration a result was computed with.
CONFIGURATION_FIELDS = ("friction_model", "friction_digest", "configuration")
#: [ns] a node may be this much behind: what it works on was published so long before a latched message that it knows.
BEHIND = 2_000_000_000
#: So many messages before the first recorded answer the node may have answered before the recorder found its topic.
EARLY = 60


class InputFeed:
    """Feeds a node; the order of latched messages is tried out on others of its kind.

    Args:
        bag: to read.
        make: a node as it is before it has heard anything.
        driver: topic of the driving stream.
        result: topic of what the node says to it.
        results: stamp of each recorded result [ns] -> configuration it was computed with.
    """

    def __init__(
        self,
        bag: Path,
        make: Callable[[], ReplayedNode],
        driver: str,
        result: str,
        results: Mapping[int, tuple[str, ...]],
    ) -> None:
        self._bag = bag
        self._make = make
        self._node = make()
        self._driver = driver
        self._result = result
        self._results = results
        self._fed: list[RawMessage] = []  # latched; one that changes nothing leaves what an earlier did
        self._pending: dict[str, list[RawMessage]] = {}
        self._outputs: dict[str, list[Output]] = defaultdict(list)
        self._last: tuple[str, ...] | None = None
        self._probe: ReplayedNode | None = None  # has heard what the node has
        self.start = 0  # [ns] stamp of the first recorded result of the driving stream
        self.stamps: set[int] = set()  # [ns] of every message that was fed

    def run(self, types: Mapping[str, str]) -> dict[str, list[Output]]:
        """Feed everything; returns topic -> messages."""
        topics = self._node.inputs & set(types)
        latched = latched_topics(self._bag) & topics
        self._pending = {topic: [] for topic in sorted(latched)}
        for message in sorted(read(self._bag, latched), key=lambda message: message.published):
            self._pending[message.topic].append(message)
        early: deque[RawMessage] = deque(maxlen=EARLY)
        for message in as_published(read(self._bag, topics - latched)):
            if message.topic == self._driver:
                stamp = stamp_in(message.data, message_class(message.type_name))
                configuration = self._results.get(stamp)
                if configuration is None:
                    # this one never reached the node, the node had nothing to say about it, or nobody recorded that yet
                    if not self.start:
                        early.append(message)
                    continue
                self._configure(message, configuration)
                if not self.start:
                    self.start = stamp
                    self._catch_up(list(early), message)
            self._take(message)
        return self._outputs

    def _catch_up(self, early: Sequence[RawMessage], message: RawMessage) -> None:
        """Feed what the node had worked on before the recorder heard its first answer: as much as explains that one."""
        answers = read(self._bag, {self._result})
        recorded = next(raw for raw in answers if stamp_in(raw.data, message_class(raw.type_name)) == self.start)
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
        possible = self._waiting(message.published + BEHIND)
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
            self._take(latched)
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

    def _take(self, message: RawMessage) -> None:
        self.stamps.add(stamp_in(message.data, message_class(message.type_name)))
        for output in self._node.feed(message):
            self._outputs[output.topic].append(output)


def results_of(bag: Path, topic: str, types: Mapping[str, str]) -> dict[int, tuple[str, ...]]:
    """Return stamp [ns] -> configuration that it was computed with, of every recorded result."""
    if topic not in types:
        return {}
    results = {}
    for raw in read(bag, {topic}):
        message = deserialize_message(raw.data, message_class(raw.type_name))
        results[stamp_of(message)] = _configuration(message)
    return results


def _configuration(message: Any) -> tuple[str, ...]:
    return tuple(getattr(message, name) for name in CONFIGURATION_FIELDS if hasattr(message, name))
