# SPDX-License-Identifier: Apache-2.0
"""A node's ways in and out, each step written down: what makes a node with services and actions replayable.

Topics alone do not tell what a node was asked, in which order it worked on what had arrived, or what its clocks said.
A node that gets all of that through a `NodeIo` publishes it on ``~/trace`` (softgrip_interfaces/NodeTrace), and a
replayer that hands it another `NodeIo` makes it take the same steps again (softgrip_bag). A step is the stretch from
one entry into the node's code to its return or its next await; within a step the clocks stand still.

The node's executor must be single-threaded: steps do not overlap.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from rclpy.action import ActionClient, ActionServer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.task import Future

from softgrip_interfaces.msg import NodeTrace
from softgrip_nodekit.stamps import to_time_message
from softgrip_nodekit.timers import steady_timer

#: [s] between two messages of a trace.
_PERIOD = 0.1
#: Whoever comes late gets the last minute.
_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=600,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

Answered = Callable[[Any], None]


class Goal(Protocol):
    """A goal as the code of an action server sees it; the names are rclpy's."""

    request: Any

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client wants it to end."""

    def publish_feedback(self, feedback: Any) -> None:
        """Tell the client how it goes."""

    def succeed(self) -> None:
        """End as wanted."""

    def abort(self) -> None:
        """End otherwise."""

    def canceled(self) -> None:
        """End because the client wanted it."""


class Caller(Protocol):
    """A client of a service."""

    def ready(self) -> bool:
        """Whether somebody serves it."""

    def call(self, request: Any, answered: Answered) -> None:
        """Send a request; ``answered`` gets the response, or None when there will be none."""


class SentGoal(Protocol):
    """A goal sent to another node."""

    accepted: bool

    def cancel(self) -> None:
        """Have it end."""

    def when_done(self, ended: Answered) -> None:
        """Call back with the result."""


class Commander(Protocol):
    """A client of an action."""

    def ready(self) -> bool:
        """Whether somebody serves it."""

    def send(self, goal: Any, answered: Callable[[SentGoal], None]) -> None:
        """Send a goal; ``answered`` gets it once it was accepted or refused."""


class NodeIo(Protocol):
    """Everything through which a node's code is entered, asks others, and reads clocks."""

    def now_ns(self) -> int:
        """The node's clock at the beginning of the present step [ns since the epoch]."""

    def monotonic_s(self) -> float:
        """The monotonic clock at the beginning of the present step [s]."""

    def draw_token(self) -> str:
        """Draw a secret that nobody can guess; in a replay the one that was drawn then."""

    def state(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:
        """Begin the first step: write down what the node remembers (``save``); in a replay put it back (``load``)."""

    def subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe to messages with a header."""

    def service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Serve requests."""

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        """Call back periodically [s]."""

    def action_server(
        self, kind: Any, name: str, execute: Callable[[Goal], Awaitable[Any]], cancel: Callable[[Goal], Any]
    ) -> None:
        """Serve goals."""

    def client(self, kind: Any, name: str) -> Caller:
        """Return a client of a service."""

    def action_client(self, kind: Any, name: str) -> Commander:
        """Return a client of an action."""

    def later(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Run work in a step of its own, once the present one is over."""

    async def resumed(self, name: str, future: Future) -> Any:
        """Wait for a future; what follows is a step of its own."""


class _Log:
    """The steps since the last message."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._names: dict[str, int] = {}
        self._steps: list[tuple[int, int, int, int, bytes]] = []
        self._first = 0
        self._numbers = 0
        self.begun: tuple[int, int] | None = None  # clocks of the present step [ns]
        self.to_cancel: set[bytes] = set()
        self._publisher = node.create_publisher(NodeTrace, "~/trace", _QOS)
        steady_timer(node, _PERIOD, self.publish)

    def begin(self, name: str, data: bytes = b"", stamp: int = 0) -> None:
        """Begin a step."""
        self.begun = self.wall(), time.monotonic_ns()
        self.say(name, data, stamp)

    def say(self, name: str, data: bytes, stamp: int = 0) -> None:
        """Write down what leaves in the present step."""
        number = self._names.setdefault(name, len(self._names))
        wall, monotonic = self.begun or (0, 0)
        self._steps.append((number, stamp, wall, monotonic, data))

    def number(self) -> int:
        """Return a number for what is sent, to tell its answer by."""
        self._numbers += 1
        return self._numbers

    def wall(self) -> int:
        """Return the node's clock [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    def publish(self) -> None:
        """Publish the steps since the last time."""
        if not self._steps:
            return
        steps, self._steps = self._steps, []
        names, stamps, walls, monotonics, data = zip(*steps, strict=True)
        message = NodeTrace(
            first=self._first,
            names=list(self._names),
            name=names,
            stamp=stamps,
            wall=walls,
            monotonic=monotonics,
            size=[len(item) for item in data],
            data=b"".join(data),
        )
        message.header.stamp = to_time_message(self.wall())
        self._first += len(steps)
        self._publisher.publish(message)


class RecordingIo:
    """The doors of a running node: rclpy's, with every step written down and published."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._log = _Log(node)
        self._servers: list[ActionServer] = []

    def now_ns(self) -> int:
        """Return the clock of the present step."""
        return self._log.begun[0] if self._log.begun else self._log.wall()

    def monotonic_s(self) -> float:
        """Return the monotonic clock of the present step."""
        return (self._log.begun[1] if self._log.begun else time.monotonic_ns()) * 1e-9

    def draw_token(self) -> str:
        """Draw 128 random bits as 32 hex digits."""
        token = secrets.token_hex(16)
        self._log.say("drew", token.encode())
        return token

    def state(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:  # noqa: ARG002  a replay's part
        """Begin the first step with what the node remembers."""
        self._log.begin("start", save())

    def subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        """Subscribe."""
        name = f"topic {self._topic(topic)}"

        def received(message: Any) -> None:
            stamp = message.header.stamp
            self._log.begin(name, b"", stamp.sec * 1_000_000_000 + stamp.nanosec)
            callback(message)

        self._node.create_subscription(kind, topic, received, qos)

    def service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Serve a service."""
        full = self._service(name)

        def requested(request: Any, response: Any) -> Any:
            self._log.begin(f"request {full}", serialize_message(request))
            response = callback(request, response)
            self._log.say(f"answered {full}", serialize_message(response))
            return response

        self._node.create_service(kind, name, requested)

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        """Make a timer on the steady clock: what watches for silence must not stand still with a simulated time."""

        def due() -> None:
            self._log.begin("timer")
            callback()

        steady_timer(self._node, period, due)

    def action_server(
        self, kind: Any, name: str, execute: Callable[[Goal], Awaitable[Any]], cancel: Callable[[Goal], Any]
    ) -> None:
        """Serve an action."""
        full = self._service(name)

        async def accepted(handle: Any) -> Any:
            key = bytes(handle.goal_id.uuid)
            self._log.begin(f"goal {full}", key + serialize_message(handle.request))
            result = await execute(_TracedGoal(self._log, full, handle))
            self._log.to_cancel.discard(key)
            self._log.say(f"finished {full}", serialize_message(result))
            return result

        def cancelled(handle: Any) -> Any:
            key = bytes(handle.goal_id.uuid)
            self._log.begin(f"cancel {full}", key)
            self._log.to_cancel.add(key)
            return cancel(_TracedGoal(self._log, full, handle))

        server = ActionServer(self._node, kind, name, execute_callback=accepted, cancel_callback=cancelled)
        self._servers.append(server)

    def client(self, kind: Any, name: str) -> Caller:
        """Make a client."""
        return _TracedCaller(self._log, self._node.create_client(kind, name), self._service(name))

    def action_client(self, kind: Any, name: str) -> Commander:
        """Make an action client."""
        return _TracedCommander(self._log, ActionClient(self._node, kind, name), self._service(name))

    def later(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Run work through the executor; at once when there is none."""

        def due() -> None:
            self._log.begin("later")
            work(*arguments)

        executor = self._node.executor
        if executor is None:
            due()
        else:
            executor.create_task(due)

    async def resumed(self, name: str, future: Future) -> Any:
        """Wait, then begin a step."""
        result = await future
        self._log.begin(f"resumed {name}")
        return result

    def _topic(self, name: str) -> str:
        return str(self._node.resolve_topic_name(name))

    def _service(self, name: str) -> str:
        return str(self._node.resolve_service_name(name))


class _TracedGoal:
    def __init__(self, log: _Log, name: str, handle: Any) -> None:
        self._log = log
        self._name = name
        self._handle = handle
        self.request = handle.request

    @property
    def is_cancel_requested(self) -> bool:
        return bytes(self._handle.goal_id.uuid) in self._log.to_cancel

    def publish_feedback(self, feedback: Any) -> None:
        self._log.say(f"feedback {self._name}", serialize_message(feedback))
        self._handle.publish_feedback(feedback)

    def succeed(self) -> None:
        self._end("succeeded", self._handle.succeed)

    def abort(self) -> None:
        self._end("aborted", self._handle.abort)

    def canceled(self) -> None:
        self._end("canceled", self._handle.canceled)

    def _end(self, how: str, end: Callable[[], object]) -> None:
        self._log.say(f"{how} {self._name}", b"")
        end()


class _TracedCaller:
    def __init__(self, log: _Log, client: Any, name: str) -> None:
        self._log = log
        self._client = client
        self._name = name

    def ready(self) -> bool:
        found = bool(self._client.service_is_ready())
        self._log.say(f"ready {self._name}", bytes([found]))
        return found

    def call(self, request: Any, answered: Answered) -> None:
        number = self._log.number()
        self._log.say(f"called {self._name}", serialize_message(request))

        def responded(future: Any) -> None:
            response = future.result()
            data = b"" if response is None else serialize_message(response)
            self._log.begin(f"response {self._name}", number.to_bytes(8, "little") + data)
            answered(response)

        self._client.call_async(request).add_done_callback(responded)


class _TracedCommander:
    def __init__(self, log: _Log, client: Any, name: str) -> None:
        self._log = log
        self._client = client
        self._name = name

    def ready(self) -> bool:
        found = bool(self._client.server_is_ready())
        self._log.say(f"ready {self._name}", bytes([found]))
        return found

    def send(self, goal: Any, answered: Callable[[SentGoal], None]) -> None:
        number = self._log.number()
        self._log.say(f"sent {self._name}", serialize_message(goal))

        def taken(future: Any) -> None:
            handle = future.result()
            self._log.begin(f"taken {self._name}", number.to_bytes(8, "little") + bytes([handle.accepted]))
            answered(_TracedSentGoal(self._log, self._name, number, handle))

        self._client.send_goal_async(goal).add_done_callback(taken)


class _TracedSentGoal:
    def __init__(self, log: _Log, name: str, number: int, handle: Any) -> None:
        self._log = log
        self._name = name
        self._number = number
        self._handle = handle
        self.accepted = bool(handle.accepted)

    def cancel(self) -> None:
        self._log.say(f"withdrawn {self._name}", self._number.to_bytes(8, "little"))
        self._handle.cancel_goal_async()

    def when_done(self, ended: Answered) -> None:
        def done(future: Any) -> None:
            result = future.result().result
            self._log.begin(f"result {self._name}", self._number.to_bytes(8, "little") + serialize_message(result))
            ended(result)

        self._handle.get_result_async().add_done_callback(done)
