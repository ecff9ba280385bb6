# SPDX-License-Identifier: Apache-2.0
"""The trace of a node (softgrip_interfaces/NodeTrace) in a bag: its steps, and the messages that they name."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import message_class, stamp_of
from softgrip_bag.nodes.present_form import renewed_step
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.reader import RawMessage
from softgrip_interfaces.msg import NodeTrace
from softgrip_time.units import to_s

#: [ns] how much later, or earlier, than the node the recorder may have received a message.
_SLACK_NS = 5_000_000_000
#: Steps that are what the node said, not what it was told.
_SAID = ("answered ", "feedback ", "finished ", "succeeded ", "aborted ", "canceled ", "called ", "sent ", "withdrawn ")


class MissingMessageError(BagError):
    """The recorder did not get a message that the node worked on."""


@dataclass(frozen=True)
class TraceStep:
    """One entry of a trace: ``name`` is "<word> <what>"."""

    number: int
    name: str
    stamp_ns: int
    time_ns: int
    monotonic_ns: int
    data: bytes

    @property
    def is_output(self) -> bool:
        """Whether the node said it."""
        return self.name.startswith(_SAID)


def runs(bag: RecordedBag, topic: str) -> Iterator[list[TraceStep]]:
    """Yield the steps of each run of the node: it may have been restarted while the bag was recorded.

    Raises:
        BagError: when the beginning or a part is missing.
    """
    before: list[TraceStep] = []
    for steps in stretches(bag, topic):
        if steps[0].number > 0:
            raise BagError(
                f"{bag.path}: expected step {len(before)} of {topic}, found {steps[0].number}: "
                + ("messages are missing" if before else "the recording began too long after the node did")
            )
        if before:
            yield before
        before = steps
    if before:
        yield before


def stretches(bag: RecordedBag, topic: str) -> Iterator[list[TraceStep]]:
    """Yield the steps that the bag has without a gap, for who does not replay them: a run of the node, or parts of it.

    A recording that began long after the node has the last part of its run.

    Raises:
        BagError: a step that cannot be read.
    """
    steps: list[TraceStep] = []
    for raw in bag.read({topic}):
        batch = deserialize_message(raw.data, message_class(raw.type_name))
        following = steps[-1].number + 1 if steps else batch.first
        if 0 < batch.first < following:
            continue  # a latched message that was recorded twice
        if steps and batch.first != following:
            yield steps
            steps = []
        steps += _steps(batch, bag, topic)
    if steps:
        yield steps


def _steps(batch: NodeTrace, bag: RecordedBag, topic: str) -> Iterator[TraceStep]:
    age = bag.age_of_trace(topic)
    for number, step in enumerate(batch.steps, start=int(batch.first)):
        yield TraceStep(
            number,
            step.name,
            int(step.stamp),
            int(step.time),
            int(step.monotonic),
            renewed_step(step.name, bytes(step.data), age),
        )


class TracedMessages:
    """The messages that the steps of a trace name by topic and stamp, read on the way.

    Args:
        bag: to read.
        steps: of one run.
    """

    def __init__(self, bag: RecordedBag, steps: list[TraceStep]) -> None:
        self._bag = bag
        self._source = bag.read({s.name.removeprefix("topic ") for s in steps if s.name.startswith("topic ")})
        self._found: dict[tuple[str, int], Any] = {}
        self._received: list[tuple[int, tuple[str, int]]] = []
        self._read_until = 0

    def get(self, step: TraceStep, topic: str) -> Any:
        """Return the message that a step worked on.

        Raises:
            MissingMessageError: when the recorder did not get it.
        """
        key = (topic, step.stamp_ns)
        while key not in self._found and self._read_until < step.time_ns + _SLACK_NS:
            raw = next(self._source, None)
            if raw is None:
                break
            self._add(raw)
        if key not in self._found:
            raise MissingMessageError(
                f"{self._bag.path}: step {step.number}: expected a message of {topic} with stamp "
                f"{to_s(step.stamp_ns):.9f} s, found none: the recorder did not get it (see `ros2 bag info`)"
            )
        self._forget(step.time_ns - _SLACK_NS)
        return self._found[key]

    def _add(self, raw: RawMessage) -> None:
        message = deserialize_message(raw.data, message_class(raw.type_name))
        key = (raw.topic, stamp_of(message))
        self._found[key] = message
        self._read_until = raw.received
        if raw.topic not in self._bag.latched:
            self._received.append((raw.received, key))

    def _forget(self, before: int) -> None:
        old = sum(1 for _ in itertools.takewhile(lambda item: item[0] < before, self._received))
        for _, key in self._received[:old]:
            self._found.pop(key, None)
        del self._received[:old]
