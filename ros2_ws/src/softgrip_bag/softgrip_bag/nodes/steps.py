# SPDX-License-Identifier: Apache-2.0
"""The steps of a traced node (softgrip_interfaces/NodeTrace) in a bag, and the messages that they name."""

from __future__ import annotations

import functools
import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.old_messages import read
from softgrip_bag.nodes.types import message_class
from softgrip_bag.reader import RawMessage, latched_topics

#: [ns] how much later, or earlier, than the node the recorder may have received a message.
_SLACK = 5_000_000_000


#: Bytes of CDR before the message; the second one says whether it is little endian.
_ENCAPSULATION = 4
_STAMP = (struct.Struct(">iI"), struct.Struct("<iI"))

#: Steps that are what the node said, not what it was told.
_SAID = ("answered ", "feedback ", "finished ", "succeeded ", "aborted ", "canceled ", "called ", "sent ", "withdrawn ")


class MissingMessageError(BagError):
    """The recorder did not get a message that the node worked on."""


@dataclass(frozen=True)
class TraceStep:
    """One entry of a trace: ``name`` is "<word> <what>", times in ns."""

    number: int
    name: str
    stamp: int
    wall: int
    monotonic: int
    data: bytes

    @property
    def is_output(self) -> bool:
        """Whether the node said it."""
        return self.name.startswith(_SAID)


def runs(bag: Path, topic: str) -> Iterator[list[TraceStep]]:
    """Yield the steps of each run of the node: it may have been restarted while the bag was recorded.

    Raises:
        BagError: when the beginning or a part is missing.
    """
    steps: list[TraceStep] = []
    for raw in read(bag, {topic}):
        batch = deserialize_message(raw.data, message_class(raw.type_name))
        if batch.first == 0 and steps:
            yield steps
            steps = []
        if batch.first < len(steps):
            continue  # a latched message that was recorded twice
        if batch.first > len(steps):
            raise BagError(
                f"{bag}: expected step {len(steps)} of {topic}, found {batch.first}: "
                + ("messages are missing" if steps else "the recording began too long after the node did")
            )
        steps += _steps(batch)
    if steps:
        yield steps


def _steps(batch: Any) -> Iterator[TraceStep]:
    data = bytes(batch.data)
    ends = [0, *itertools.accumulate(batch.size)]
    for index, name in enumerate(batch.name):
        yield TraceStep(
            int(batch.first) + index,
            str(batch.names[name]),
            int(batch.stamp[index]),
            int(batch.wall[index]),
            int(batch.monotonic[index]),
            data[ends[index] : ends[index + 1]],
        )


class Messages:
    """The messages of some topics by their stamp, read on the way."""

    def __init__(self, bag: Path, topics: set[str]) -> None:
        self._bag = bag
        self._source = read(bag, topics)
        self._kept = latched_topics(bag)
        self._found: dict[tuple[str, int], Any] = {}
        self._received: list[tuple[int, tuple[str, int]]] = []
        self._read_until = 0

    def get(self, step: TraceStep, topic: str) -> Any:
        """Return the message that a step worked on.

        Raises:
            MissingMessageError: when the recorder did not get it.
        """
        key = (topic, step.stamp)
        while key not in self._found and self._read_until < step.wall + _SLACK:
            raw = next(self._source, None)
            if raw is None:
                break
            self._take(raw)
        if key not in self._found:
            raise MissingMessageError(
                f"{self._bag}: step {step.number}: expected a message of {topic} with stamp {step.stamp * 1e-9:.9f} s, "
                "found none: the recorder did not get it (see `ros2 bag info`)"
            )
        self._forget(step.wall - _SLACK)
        return self._found[key]

    def _take(self, raw: RawMessage) -> None:
        message = deserialize_message(raw.data, message_class(raw.type_name))
        key = (raw.topic, stamp_of(message))
        self._found[key] = message
        self._read_until = raw.received
        if raw.topic not in self._kept:
            self._received.append((raw.received, key))

    def _forget(self, before: int) -> None:
        old = sum(1 for _ in itertools.takewhile(lambda item: item[0] < before, self._received))
        for _, key in self._received[:old]:
            self._found.pop(key, None)
        del self._received[:old]


def stamp_of(message: Any) -> int:
    """Return header.stamp [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp_in(data: bytes, kind: Any) -> int:
    """Return header.stamp [ns] of a message in the wire's form; where the header comes first nothing else is read."""
    if not _begins_with_header(kind):
        return stamp_of(deserialize_message(data, kind))
    seconds, nanoseconds = _STAMP[data[1] & 1].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


@functools.cache
def _begins_with_header(kind: Any) -> bool:
    return next(iter(kind.get_fields_and_field_types().items()), None) == ("header", "std_msgs/Header")
