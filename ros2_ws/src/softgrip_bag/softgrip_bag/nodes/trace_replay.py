# SPDX-License-Identifier: Apache-2.0
"""The doors (softgrip_nodekit.Doors) of a node that takes recorded steps again.

It is asked what it was asked, in the same order, with the same clocks, and all it says is compared with what it said.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from softgrip_bag.comparison import Divergence, first_difference
from softgrip_bag.nodes.steps import Messages, TraceStep
from softgrip_bag.nodes.trees import tree
from softgrip_nodekit import Caller, Commander, Goal, SentGoal

_UUID = 16
_NUMBER = 8


class Diverged(Exception):  # noqa: N818  not an error: what the comparison found
    """The node said something else than it did."""

    def __init__(self, divergence: Divergence) -> None:
        super().__init__(str(divergence))
        self.divergence = divergence


class _Pause:
    """Gives control back once: rclpy lets nobody look at a future again that is not done yet."""

    def __await__(self) -> Generator[None, None, None]:
        yield


class ReplayIo:
    """Hands a node its recorded steps.

    Args:
        node: to take them.
        steps: of one run, from its start.
        messages: those that the steps name.
        tolerance: of the comparison, see `first_difference`.
    """

    def __init__(self, node: Node, steps: Sequence[TraceStep], messages: Messages, tolerance: float) -> None:
        self._node = node
        self._steps = steps
        self._messages = messages
        self._tolerance = tolerance
        self._at = 0
        self._now = steps[0]
        self._entries: dict[str, Callable[[TraceStep], None]] = {}
        self._answers: dict[tuple[str, int], Callable[[Any], None]] = {}
        self._later: list[Callable[[], Any]] = []
        self._waiting: dict[str, Any] = {}  # name -> coroutine
        self._awaited = ""
        self._sent = 0
        self.to_cancel: set[bytes] = set()
        self.compared = 0

    # -- what the node uses ------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """Return the recorded clock of the present step."""
        return self._now.wall

    def monotonic_s(self) -> float:
        """Return the recorded monotonic clock of the present step."""
        return self._now.monotonic * 1e-9

    def draw_token(self) -> str:
        """Return the secret that was drawn then."""
        return self.value("drew").decode()

    def state(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:  # noqa: ARG002  a running node's
        """Give back what the node remembered."""
        load(self._enter("start").data)

    def subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: Any) -> None:  # noqa: ARG002
        """Note who takes a topic's messages."""
        name = self._node.resolve_topic_name(topic)
        self._entries[f"topic {name}"] = lambda step: callback(self._messages.get(step, name))

    def service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Note who answers requests."""
        full = self._node.resolve_service_name(name)

        def requested(step: TraceStep) -> None:
            response = callback(deserialize_message(step.data, kind.Request), kind.Response())
            self.say(f"answered {full}", response)

        self._entries[f"request {full}"] = requested

    def timer(self, period: float, callback: Callable[[], None]) -> None:  # noqa: ARG002  the steps say when
        """Note who is called by time."""
        self._entries["timer"] = lambda _: callback()

    def action_server(
        self, kind: Any, name: str, execute: Callable[[Goal], Awaitable[Any]], cancel: Callable[[Goal], Any]
    ) -> None:
        """Note who takes goals."""
        full = self._node.resolve_service_name(name)
        goals: dict[bytes, ReplayedGoal] = {}

        async def run(key: bytes, goal: ReplayedGoal) -> None:
            result = await execute(goal)
            self.to_cancel.discard(key)
            self.say(f"finished {full}", result)

        def accepted(step: TraceStep) -> None:
            key = step.data[:_UUID]
            goals[key] = ReplayedGoal(self, full, key, deserialize_message(step.data[_UUID:], kind.Goal))
            self._advance(run(key, goals[key]))

        def cancelled(step: TraceStep) -> None:
            self.to_cancel.add(step.data)
            cancel(goals[step.data])

        self._entries[f"goal {full}"] = accepted
        self._entries[f"cancel {full}"] = cancelled

    def client(self, kind: Any, name: str) -> Caller:
        """Return what answers with the recorded responses."""
        return _ReplayedCaller(self, kind, self._node.resolve_service_name(name))

    def action_client(self, kind: Any, name: str) -> Commander:
        """Return what answers with the recorded results."""
        return _ReplayedCommander(self, kind, self._node.resolve_service_name(name))

    def later(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Note what is to be done in a step of its own."""
        self._later.append(lambda: work(*arguments))
        self._entries["later"] = lambda _: self._later.pop(0)()

    async def resumed(self, name: str, future: Future) -> Any:
        """Wait until the recorded step is there."""
        while not future.done():
            self._awaited = name
            await _Pause()
        self._enter(f"resumed {name}")
        return future.result()

    # -- taking the steps --------------------------------------------------------------------------------------

    def run(self) -> None:
        """Take every step after the first.

        Raises:
            Diverged: the node says something else than it did.
            MissingMessageError: a message is not in the bag: what follows cannot be replayed.
        """
        while self._at < len(self._steps):
            step = self._steps[self._at]
            word, _, what = step.name.partition(" ")
            if word == "resumed":
                if what not in self._waiting:
                    raise self._diverged("(step)", step.name, "not waiting")
                self._advance(self._waiting.pop(what))
                if self._at < len(self._steps) and self._steps[self._at] is step:
                    raise self._diverged("(step)", step.name, "still waiting")
            elif step.name in self._entries:
                self._enter(step.name)
                self._entries[step.name](step)
            else:
                raise self._diverged("(step)", step.name, "nothing")

    @property
    def pending(self) -> int:
        """How many outputs are in the steps not taken."""
        return sum(step.is_output for step in self._steps[self._at :])

    def say(self, name: str, message: Any) -> None:
        """Compare what leaves with what left then; the end of the trace cuts a step short."""
        if self._at >= len(self._steps):
            return
        step = self._take(name)
        if isinstance(message, bytes):
            difference = None if step.data == message else ("data", step.data.hex(), message.hex())
        else:
            data = serialize_message(message)
            recorded, replayed = (deserialize_message(item, type(message)) for item in (step.data, data))
            difference = first_difference(tree(recorded), tree(replayed), frozenset(), tolerance=self._tolerance)
        self.compared += 1
        if difference:
            raise self._diverged(*difference, name)

    def value(self, name: str) -> bytes:
        """Return what the node learned from its surroundings then."""
        return self._take(name).data if self._at < len(self._steps) else b"\0"

    def number(self) -> int:
        """Return the number of what is sent."""
        self._sent += 1
        return self._sent

    def when(self, name: str, number: int, answered: Callable[[bytes], None]) -> None:
        """Call back when the step ``name`` with this number comes."""
        self._answers[name, number] = answered

        def due(step: TraceStep) -> None:
            key = (name, int.from_bytes(step.data[:_NUMBER], "little"))
            if key not in self._answers:
                raise self._diverged("(step)", f"{name} to number {key[1]}", "never sent")
            self._answers.pop(key)(step.data[_NUMBER:])

        self._entries[name] = due

    def _enter(self, name: str) -> TraceStep:
        self._now = self._take(name)
        return self._now

    def _take(self, name: str) -> TraceStep:
        step = self._steps[self._at]
        if step.name != name:
            raise self._diverged("(step)", step.name, name)
        self._at += 1
        return step

    def _advance(self, coroutine: Any) -> None:
        try:
            coroutine.send(None)
        except StopIteration:
            return
        self._waiting[self._awaited] = coroutine

    def close(self) -> None:
        """Let go of what still waits at the end of the bag."""
        for coroutine in self._waiting.values():
            coroutine.close()

    def _diverged(self, field: str, recorded: Any, replayed: Any, name: str = "") -> Diverged:
        step = self._steps[min(self._at, len(self._steps) - 1)]
        where = f"{self._node.get_name()} step {step.number} ({name or self._now.name})"
        return Diverged(Divergence(where, self._now.wall, field, recorded, replayed))


class ReplayedGoal:
    """A goal whose client is the trace."""

    def __init__(self, node_io: ReplayIo, name: str, key: bytes, request: Any) -> None:
        self._node_io = node_io
        self._name = name
        self._key = key
        self.request = request

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client wanted it to end."""
        return self._key in self._node_io.to_cancel

    def publish_feedback(self, feedback: Any) -> None:
        """Compare."""
        self._node_io.say(f"feedback {self._name}", feedback)

    def succeed(self) -> None:
        """Compare."""
        self._node_io.say(f"succeeded {self._name}", b"")

    def abort(self) -> None:
        """Compare."""
        self._node_io.say(f"aborted {self._name}", b"")

    def canceled(self) -> None:
        """Compare."""
        self._node_io.say(f"canceled {self._name}", b"")


class _Replayed:
    """What a node may ask of a service or an action that the trace speaks for."""

    def __init__(self, node_io: ReplayIo, kind: Any, name: str) -> None:
        self._node_io = node_io
        self._kind = kind
        self._name = name

    def ready(self) -> bool:
        return self._node_io.value(f"ready {self._name}") == b"\1"


class _ReplayedCaller(_Replayed):
    def call(self, request: Any, answered: Callable[[Any], None]) -> None:
        number = self._node_io.number()
        self._node_io.say(f"called {self._name}", request)

        def responded(data: bytes) -> None:
            answered(deserialize_message(data, self._kind.Response) if data else None)

        self._node_io.when(f"response {self._name}", number, responded)


class _ReplayedCommander(_Replayed):
    def send(self, goal: Any, answered: Callable[[SentGoal], None]) -> None:
        number = self._node_io.number()
        self._node_io.say(f"sent {self._name}", goal)

        def taken(data: bytes) -> None:
            answered(_ReplayedSentGoal(self._node_io, self._kind, self._name, number, accepted=data == b"\1"))

        self._node_io.when(f"taken {self._name}", number, taken)


class _ReplayedSentGoal:
    def __init__(self, node_io: ReplayIo, kind: Any, name: str, number: int, *, accepted: bool) -> None:
        self._node_io = node_io
        self._kind = kind
        self._name = name
        self._number = number
        self.accepted = accepted

    def cancel(self) -> None:
        self._node_io.say(f"withdrawn {self._name}", self._number.to_bytes(_NUMBER, "little"))

    def when_done(self, ended: Callable[[Any], None]) -> None:
        def done(data: bytes) -> None:
            ended(deserialize_message(data, self._kind.Result))

        self._node_io.when(f"result {self._name}", self._number, done)
