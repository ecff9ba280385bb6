# SPDX-License-Identifier: Apache-2.0
"""A node that takes the steps of its trace again.

It is asked what it was asked, in the same order, with the same clocks (`ReplayIo`), and all it says is compared with
what it said (`TraceComparison`). The node's own `RecordingIo` stands between the two, as it stood between rclpy and the
trace when the bag was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from softgrip_bag.comparison import Divergence, first_difference
from softgrip_bag.nodes.messages import tree
from softgrip_bag.nodes.trace import TracedMessages, TraceStep
from softgrip_nodekit import GoalClient, NodeIo, ServiceClient
from softgrip_nodekit.errors import SuccessResponseT
from softgrip_nodekit.node_io import NUMBER_BYTES, Answer, Cancel, Execute, as_bytes

T = TypeVar("T")
Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")

_UUID_BYTES = 16


class Diverged(Exception):  # noqa: N818  not an error: what the comparison found
    """The node said something else than it did."""

    def __init__(self, divergence: Divergence) -> None:
        super().__init__(str(divergence))
        self.divergence = divergence


class TraceComparison:
    """The log of a node that takes recorded steps again; see softgrip_nodekit's StepLog.

    Args:
        name: of the node.
        steps: of one run, from its start.
        tolerance: of the comparison, see `first_difference`.

    Attributes:
        compared: outputs that were as recorded.
    """

    def __init__(self, name: str, steps: Sequence[TraceStep], tolerance: float) -> None:
        self._name = name
        self._steps = steps
        self._tolerance = tolerance
        self._at = 0
        self._now = steps[0]
        self.compared = 0

    @property
    def is_over(self) -> bool:
        """Whether every step was taken."""
        return self._at >= len(self._steps)

    @property
    def next_step(self) -> TraceStep:
        """The step that comes next."""
        return self._steps[self._at]

    @property
    def pending(self) -> int:
        """How many outputs are in the steps not taken."""
        return sum(step.is_output for step in self._steps[self._at :])

    @property
    def clocks_ns(self) -> tuple[int, int]:
        """Both recorded clocks of the present step."""
        return self._now.time_ns, self._now.monotonic_ns

    def start(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:  # noqa: ARG002  a running node's
        """Give back what the node remembered."""
        self.begin_step("start")
        load(self._now.data)

    def begin_step(self, name: str, data: bytes = b"", stamp: int = 0) -> None:  # noqa: ARG002  both are from the step
        """Begin the recorded step."""
        self._now = self._next_named(name)

    def record_output(self, name: str, message: object) -> None:
        """Compare what leaves with what left then; the end of the trace cuts a step short."""
        if self.is_over:
            return
        step, data = self._next_named(name), as_bytes(message)
        if isinstance(message, bytes):
            difference = None if step.data == data else ("data", step.data.hex(), data.hex())
        else:
            recorded, replayed = (deserialize_message(item, type(message)) for item in (step.data, data))
            difference = first_difference(tree(recorded), tree(replayed), frozenset(), tolerance=self._tolerance)
        self.compared += 1
        if difference:
            raise self.diverged(*difference, name)

    def observe(self, name: str, read: Callable[[], bytes]) -> bytes:  # noqa: ARG002  what is there now says nothing
        """Return what the node found then."""
        return b"\0" if self.is_over else self._next_named(name).data

    def diverged(self, field: str, recorded: object, replayed: object, name: str = "") -> Diverged:
        """Return what to raise where the node left the trace."""
        step = self._steps[min(self._at, len(self._steps) - 1)]
        where = f"{self._name} step {step.number} ({name or self._now.name})"
        return Diverged(Divergence(where, self._now.time_ns, field, recorded, replayed))

    def _next_named(self, name: str) -> TraceStep:
        step = self.next_step
        if step.name != name:
            raise self.diverged("(step)", step.name, name)
        self._at += 1
        return step


class ReplayIo(NodeIo):
    """Calls a node from its trace, and answers it from there.

    Args:
        node: to be called.
        log: of its steps.
        messages: those that the steps name.
    """

    def __init__(self, node: Node, log: TraceComparison, messages: TracedMessages) -> None:
        super().__init__(node)
        self._log = log
        self._messages = messages
        self._entries: dict[str, Callable[[TraceStep], object]] = {}
        self._tasks: list[Callable[[], object]] = []
        self._waiting: dict[str, Coroutine[Any, Any, object]] = {}
        self._answers: dict[str, Callable[[bytes], None]] = {}
        self._sent = 0

    def run(self) -> None:
        """Take every step after the first.

        Raises:
            Diverged: the node says something else than it did.
            MissingMessageError: a message is not in the bag: what follows cannot be replayed.
        """
        while not self._log.is_over:
            step = self._log.next_step
            if step.name not in self._entries:
                raise self._log.diverged("(step)", step.name, "nothing")
            self._entries[step.name](step)
            if not self._log.is_over and self._log.next_step is step:
                raise self._log.diverged("(step)", step.name, "not taken")

    def close(self) -> None:
        """Let go of what still waits at the end of the bag."""
        for coroutine in self._waiting.values():
            coroutine.close()

    def create_subscription(self, kind: type[T], topic: str, callback: Callable[[T], None], qos: QoSProfile) -> None:  # noqa: ARG002
        """Note who gets a topic's messages."""
        name = self._node.resolve_topic_name(topic)
        self._entries[f"topic {name}"] = lambda step: callback(self._messages.get(step, name))

    def create_service(self, kind: Any, name: str, callback: Callable[[Request, Response], Response]) -> None:
        """Note who answers requests."""

        def requested(step: TraceStep) -> None:
            callback(deserialize_message(step.data, kind.Request), kind.Response())

        self._entries[f"request {self._node.resolve_service_name(name)}"] = requested

    def create_order_service(
        self,
        kind: Any,
        name: str,
        callback: Callable[[Request, SuccessResponseT], SuccessResponseT],
    ) -> None:
        """Note who answers requests; those that were too old are in no trace."""
        self.create_service(kind, name, callback)

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:  # noqa: ARG002  the steps say when
        """Note who is called by time."""
        self._entries["timer"] = lambda _: callback()

    def create_action_server(
        self,
        kind: Any,
        name: str,
        execute: Execute[Goal, Feedback, Result],
        cancel: Cancel[Goal, Feedback],
    ) -> None:
        """Note who gets goals."""
        full = self._node.resolve_service_name(name)
        goals: dict[bytes, _ReplayedGoal[Goal]] = {}

        def accepted(step: TraceStep) -> None:
            key = step.data[:_UUID_BYTES]
            goals[key] = _ReplayedGoal(key, deserialize_message(step.data[_UUID_BYTES:], kind.Goal))
            self._advance(execute(goals[key]))

        def cancelled(step: TraceStep) -> None:
            cancel(goals[step.data])

        self._entries[f"goal {full}"] = accepted
        self._entries[f"cancel {full}"] = cancelled

    def create_client(self, kind: Any, name: str) -> ServiceClient[Any, Any]:
        """Return what answers with the recorded responses."""
        return _ReplayedClient(self, kind.Response, self._node.resolve_service_name(name))

    def create_action_client(self, kind: Any, name: str) -> GoalClient[Any, Any]:
        """Return what answers with the recorded results."""
        return _ReplayedActionClient(self, kind.Result, self._node.resolve_service_name(name))

    def create_task(self, work: Callable[..., object], *arguments: object) -> None:
        """Note what is to be done in a step of its own."""
        self._tasks.append(lambda: work(*arguments))
        self._entries["later"] = lambda _: self._tasks.pop(0)()

    async def wait_for(self, name: str, future: Future[T]) -> T:
        """Wait until the step that follows the wait comes."""
        while not future.done():
            await _Pause(name)
        return future.result()

    def _advance(self, coroutine: Coroutine[Any, Any, object]) -> None:
        """Run a coroutine to its end or its next wait."""
        try:
            name = coroutine.send(None)
        except StopIteration:
            return
        entry = f"resumed {name}"
        self._waiting[entry] = coroutine
        self._entries[entry] = lambda _: self._advance(self._resumed(entry))

    def _resumed(self, entry: str) -> Coroutine[Any, Any, object]:
        self._entries.pop(entry)
        return self._waiting.pop(entry)

    def next_number(self) -> int:
        """Return the number of what is sent, to tell its answer by."""
        self._sent += 1
        return self._sent

    def expect_answer(self, name: str, number: int, read: Callable[[bytes], T]) -> Answer[T]:
        """Return what is answered when the step ``name`` with this number comes."""
        answer: Answer[T] = Answer()

        def due(step: TraceStep) -> None:
            key = f"{name} {int.from_bytes(step.data[:NUMBER_BYTES], 'little')}"
            if key not in self._answers:
                raise self._log.diverged("(step)", key, "never sent")
            self._answers.pop(key)(step.data[NUMBER_BYTES:])

        self._answers[f"{name} {number}"] = lambda data: answer.set_result(read(data))
        self._entries[name] = due
        return answer


class _ReplayedClient(Generic[Response]):
    """A client of a service that the trace serves."""

    def __init__(self, io: ReplayIo, kind: type[Response], name: str) -> None:
        self._io = io
        self._kind = kind
        self._name = name

    def service_is_ready(self) -> bool:
        """Say yes; the log says what was found then."""
        return True

    def call_async(self, _request: object) -> Answer[Response | None]:
        return self._io.expect_answer(f"response {self._name}", self._io.next_number(), self._read)

    def _read(self, data: bytes) -> Response | None:
        return deserialize_message(data, self._kind) if data else None


class _ReplayedActionClient(Generic[Result]):
    """A client of an action that the trace serves."""

    def __init__(self, io: ReplayIo, kind: type[Result], name: str) -> None:
        self._io = io
        self._kind = kind
        self._name = name

    def server_is_ready(self) -> bool:
        """Say yes; the log says what was found then."""
        return True

    def send_goal_async(self, _goal: object) -> Answer[_ReplayedSentGoal[Result]]:
        number = self._io.next_number()

        def taken(data: bytes) -> _ReplayedSentGoal[Result]:
            return _ReplayedSentGoal(self._io, self._kind, self._name, number, accepted=data == b"\1")

        return self._io.expect_answer(f"taken {self._name}", number, taken)


class _ReplayedSentGoal(Generic[Result]):
    """A goal that a server of the trace has accepted or refused."""

    def __init__(self, io: ReplayIo, kind: type[Result], name: str, number: int, *, accepted: bool) -> None:
        self._io = io
        self._kind = kind
        self._name = name
        self._number = number
        self.accepted = accepted

    def cancel_goal_async(self) -> None:
        """Nobody listens; the log compares."""

    def get_result_async(self) -> Answer[_ReplayedResult[Result]]:
        return self._io.expect_answer(f"result {self._name}", self._number, self._read)

    def _read(self, data: bytes) -> _ReplayedResult[Result]:
        return _ReplayedResult(deserialize_message(data, self._kind))


@dataclass(frozen=True)
class _ReplayedResult(Generic[Result]):
    """How a goal ended, as the trace has it."""

    result: Result


class _Pause:
    """Gives control back once, with the name of the wait: rclpy's Future may be awaited once only."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __await__(self) -> Generator[str, None, None]:
        yield self._name


@dataclass(frozen=True)
class _ReplayedGoalId:
    """The identity of a goal, as the trace has it."""

    uuid: bytes


class _ReplayedGoal(Generic[Goal]):
    """rclpy's handle of a goal whose client is the trace."""

    def __init__(self, key: bytes, request: Goal) -> None:
        self.goal_id = _ReplayedGoalId(key)
        self.request = request
        self.is_cancel_requested = False  # the log's handle says what a step has said

    def publish_feedback(self, feedback: object) -> None:
        """Nobody listens; the log compares."""

    def succeed(self) -> None:
        """Nobody listens; the log compares."""

    abort = canceled = succeed
