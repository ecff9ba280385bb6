# SPDX-License-Identifier: Apache-2.0
"""What a node asks of rclpy, in rclpy's names, so that it can be written down and, from a bag, be given again.

`NodeIo` is rclpy itself. `RecordingIo` has the same methods, and writes each step of the node into a `StepTrace` on
``~/trace`` (softgrip_interfaces/NodeTrace): topics alone do not say what a node was asked, in which order it worked on
what had arrived, or what its clocks showed. A replayer gives a `RecordingIo` another `NodeIo`, which calls the node
from the bag, and a log that compares instead of writing (softgrip_bag).

A step is the stretch from one entry into the node's code to its return or its next await; within a step the clocks
stand still. The node's executor must be single-threaded: steps do not overlap.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Coroutine, Iterable
from typing import TYPE_CHECKING, Any, Generic, Protocol, SupportsIndex, TypeVar

from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.task import Future

from softgrip_interfaces.msg import NodeTrace, TraceStep
from softgrip_nodekit.cell_time import duration_clock, duration_timer, steady_timer
from softgrip_nodekit.errors import SuccessResponseT
from softgrip_nodekit.stamps import nanoseconds, to_time_message
from softgrip_nodekit.standstill import OrderGuard
from softgrip_time.units import to_s

if TYPE_CHECKING:
    from softgrip_nodekit.event_time import StampedMessage

T = TypeVar("T")
Stamped = TypeVar("Stamped", bound="StampedMessage")
T_co = TypeVar("T_co", covariant=True)
Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Feedback = TypeVar("Feedback")
Result = TypeVar("Result")
Request_co = TypeVar("Request_co", covariant=True)
Feedback_co = TypeVar("Feedback_co", covariant=True)
Request_contra = TypeVar("Request_contra", contravariant=True)
Response_co = TypeVar("Response_co", covariant=True)
Goal_co = TypeVar("Goal_co", covariant=True)
Goal_contra = TypeVar("Goal_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)
Feedback_contra = TypeVar("Feedback_contra", contravariant=True)

#: [s] between two messages of a trace.
_PERIOD_S = 0.1
#: Late subscribers receive the last minute.
_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=600,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
#: Bytes of the number that a request or a sent goal has, to tell its answer by.
NUMBER_BYTES = 8


class ServiceType(Protocol[Request_co, Response_co]):
    """A class of a service; a call of one of its classes makes a message."""

    def Request(self) -> Request_co:  # noqa: N802  rosidl's name
        """What is asked."""

    def Response(self) -> Response_co:  # noqa: N802
        """What is answered."""


class ActionType(Protocol[Goal_co, Result_co, Feedback_co]):
    """A class of an action; a call of one of its classes makes a message."""

    def Goal(self) -> Goal_co:  # noqa: N802  rosidl's name
        """What is wanted."""

    def Result(self) -> Result_co:  # noqa: N802
        """How it ended."""

    def Feedback(self) -> Feedback_co:  # noqa: N802
        """How far it is."""


class GoalId(Protocol):
    """What unique_identifier_msgs/UUID has."""

    @property
    def uuid(self) -> Iterable[SupportsIndex]:
        """Sixteen bytes."""


class GoalHandle(Protocol[Goal_co, Feedback_contra]):
    """A goal that an action serves: rclpy's handle, a recorded one, or one of a replay."""

    @property
    def request(self) -> Goal_co:
        """What is asked for."""

    @property
    def goal_id(self) -> GoalId:
        """Its identity."""

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client wants it to end."""

    def publish_feedback(self, feedback: Feedback_contra) -> None:
        """Publish how far it is."""

    def succeed(self) -> None:
        """Report that it was reached."""

    def abort(self) -> None:
        """Report that it was not reached."""

    def canceled(self) -> None:
        """Report that it ended because the client wanted it to."""


class PendingResult(Protocol[T_co]):
    """What a call or a goal will come to: rclpy's Future or an `Answer`."""

    def result(self) -> T_co:
        """Return it; None where it never came."""

    def add_done_callback(self, callback: Callable[[PendingResult[T_co]], object]) -> None:
        """Call back when it is there."""


class ServiceClient(Protocol[Request_contra, Response_co]):
    """A client of a service: rclpy's, a recorded one, or one of a replay."""

    def service_is_ready(self) -> bool:
        """Whether somebody serves."""

    def call_async(self, request: Request_contra) -> PendingResult[Response_co | None]:
        """Ask; nothing comes from a server that went away."""


class GoalResult(Protocol[Result_co]):
    """How a goal ended. rclpy's has a status, too; a trace has none."""

    @property
    def result(self) -> Result_co:
        """The action's result."""


class SentGoal(Protocol[Result_co]):
    """A goal that an action's server has accepted or refused."""

    @property
    def accepted(self) -> bool:
        """Whether it was accepted."""

    def cancel_goal_async(self) -> object:
        """Ask to end it."""

    def get_result_async(self) -> PendingResult[GoalResult[Result_co]]:
        """Ask how it ends."""


class GoalClient(Protocol[Goal_contra, Result_co]):
    """A client of an action: rclpy's, a recorded one, or one of a replay."""

    def server_is_ready(self) -> bool:
        """Whether somebody serves."""

    def send_goal_async(self, goal: Goal_contra) -> PendingResult[SentGoal[Result_co]]:
        """Send a goal."""


#: Callbacks of an action's server, by goal, feedback and result.
Execute = Callable[[GoalHandle[Goal, Feedback]], Coroutine[Any, Any, Result]]
Cancel = Callable[[GoalHandle[Goal, Feedback]], CancelResponse]


class NodeIo:
    """A node's clocks and its ways in and out, as rclpy gives them.

    Args:
        node: that owns what is created.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._servers: list[ActionServer] = []
        self._order_guard: OrderGuard | None = None

    def now_ns(self) -> int:
        """Return the node's clock [ns since the epoch]."""
        return int(self._node.get_clock().now().nanoseconds)

    def monotonic_ns(self) -> int:
        """Return the clock of durations [ns]: steady, or an emulated cell's."""
        return int(duration_clock(self._node).now().nanoseconds)

    def monotonic_s(self) -> float:
        """Return the clock of durations [s]."""
        return to_s(self.monotonic_ns())

    def draw_token(self) -> str:
        """Return 128 random bits as 32 hex digits: a secret that nobody can guess."""
        return secrets.token_hex(16)

    def create_subscription(
        self, kind: type[Stamped], topic: str, callback: Callable[[Stamped], None], qos: QoSProfile
    ) -> None:
        """Subscribe to messages with a header."""
        self._node.create_subscription(kind, topic, callback, qos)

    def create_service(
        self, kind: ServiceType[Request, Response], name: str, callback: Callable[[Request, Response], Response]
    ) -> None:
        """Serve requests."""
        self._node.create_service(kind, name, callback)

    def create_order_service(
        self,
        kind: ServiceType[Request, SuccessResponseT],
        name: str,
        callback: Callable[[Request, SuccessResponseT], SuccessResponseT],
    ) -> None:
        """Serve requests after which something may move: none that may be older than the process's standstill.

        The response has ``success`` and ``message``.
        """
        self._guard_orders()

        def obey(request: Request, response: SuccessResponseT) -> SuccessResponseT:
            if refusal := self._why_too_old(name):
                response.success, response.message = False, refusal
                return response
            return callback(request, response)

        self._node.create_service(kind, name, obey)

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Make a timer on the clock of durations."""
        duration_timer(self._node, period_s, callback)

    def create_action_server(
        self,
        kind: ActionType[Goal, Result, Feedback],
        name: str,
        execute: Execute[Goal, Feedback, Result],
        cancel: Cancel[Goal, Feedback],
    ) -> None:
        """Serve goals; both callbacks get rclpy's goal handle, or what has its names."""
        self._guard_orders()

        def judge(_goal: object) -> GoalResponse:
            return GoalResponse.REJECT if self._why_too_old(name) else GoalResponse.ACCEPT

        server = ActionServer(
            self._node, kind, name, execute_callback=execute, goal_callback=judge, cancel_callback=cancel
        )
        self._servers.append(server)

    def _guard_orders(self) -> None:
        if self._order_guard is None:
            self._order_guard = OrderGuard(self._node)

    def _why_too_old(self, name: str) -> str:
        """Return why an order may be too old to be obeyed, and log it; empty when it is not."""
        assert self._order_guard is not None
        refusal = self._order_guard.refusal
        if refusal:
            self._node.get_logger().warning(f"{name} refused: {refusal}")
        return refusal

    def create_client(self, kind: ServiceType[Request, Response], name: str) -> ServiceClient[Request, Response]:
        """Return a client of a service."""
        return self._node.create_client(kind, name)

    def create_action_client(self, kind: ActionType[Goal, Result, Feedback], name: str) -> GoalClient[Goal, Result]:
        """Return a client of an action."""
        return ActionClient(self._node, kind, name)

    def create_task(self, work: Callable[..., object], *arguments: object) -> None:
        """Run work through the executor, after the present callback; at once when there is no executor."""
        executor = self._node.executor
        if executor is None:
            work(*arguments)
        else:
            executor.create_task(work, *arguments)

    async def wait_for(self, name: str, future: Future[T]) -> T:  # noqa: ARG002  a trace tells the waits apart by name
        """Return the result of a future; what follows is a step of its own."""
        return await future


class StepLog(Protocol):
    """Where the steps of a node go: into a `StepTrace`, or against a recorded one."""

    @property
    def clocks_ns(self) -> tuple[int, int]:
        """Node's clock and monotonic clock at the beginning of the present step [ns]."""

    def start(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:
        """Begin the first step: write down what the node remembers, or give it back."""

    def begin_step(self, name: str, data: bytes = b"", stamp: int = 0) -> None:
        """Begin a step."""

    def record_output(self, name: str, message: object) -> None:
        """Take what leaves the node in the present step: a message, or bytes."""

    def observe(self, name: str, read: Callable[[], bytes]) -> bytes:
        """Return what the node learns of its surroundings in the present step."""


class StepTrace:
    """Writes the steps of a node down and publishes them in batches."""

    def __init__(self, node: Node) -> None:
        self._io = NodeIo(node)
        self._steps: list[TraceStep] = []
        self._first = 0
        self._begun_ns: tuple[int, int] | None = None
        self._publisher = node.create_publisher(NodeTrace, "~/trace", _QOS)
        steady_timer(node, _PERIOD_S, self.publish)

    @property
    def clocks_ns(self) -> tuple[int, int]:
        """Both clocks at the beginning of the present step; before the first one as they are."""
        return self._begun_ns or (self._io.now_ns(), self._io.monotonic_ns())

    def start(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:  # noqa: ARG002  a replay's part
        """Begin the first step with what the node remembers."""
        self.begin_step("start", save())

    def begin_step(self, name: str, data: bytes = b"", stamp: int = 0) -> None:
        """Begin a step."""
        self._begun_ns = self._io.now_ns(), self._io.monotonic_ns()
        self._append(name, data, stamp)

    def record_output(self, name: str, message: object) -> None:
        """Write down what leaves."""
        self._append(name, as_bytes(message))

    def observe(self, name: str, read: Callable[[], bytes]) -> bytes:
        """Write down what is found."""
        found = read()
        self._append(name, found)
        return found

    def _append(self, name: str, data: bytes, stamp: int = 0) -> None:
        time, monotonic = self._begun_ns or (0, 0)
        self._steps.append(TraceStep(name=name, stamp=stamp, time=time, monotonic=monotonic, data=data))

    def publish(self) -> None:
        """Publish the steps since the last time."""
        if not self._steps:
            return
        message = NodeTrace(first=self._first, steps=self._steps)
        message.header.stamp = to_time_message(self._io.now_ns())
        self._first += len(self._steps)
        self._steps = []
        self._publisher.publish(message)


class RecordingIo(NodeIo):
    """A `NodeIo` whose every use goes into a log.

    Args:
        node: that uses it.
        io: what is used; None = rclpy.
        log: where the steps go; None = a `StepTrace` that the node publishes.
    """

    def __init__(self, node: Node, io: NodeIo | None = None, log: StepLog | None = None) -> None:
        super().__init__(node)
        self._io = io or NodeIo(node)
        self._log: StepLog = log or StepTrace(node)
        self._sent = 0

    def now_ns(self) -> int:
        """Return the clock of the present step."""
        return self._log.clocks_ns[0]

    def monotonic_ns(self) -> int:
        """Return the monotonic clock of the present step."""
        return self._log.clocks_ns[1]

    def draw_token(self) -> str:
        """Return a secret; in a replay the one that was drawn then."""
        return self._log.observe("drew", lambda: self._io.draw_token().encode()).decode()

    def start(self, save: Callable[[], bytes], load: Callable[[bytes], None]) -> None:
        """Begin the first step: write down what the node remembers (``save``); in a replay put it back (``load``)."""
        self._log.start(save, load)

    def create_subscription(
        self, kind: type[Stamped], topic: str, callback: Callable[[Stamped], None], qos: QoSProfile
    ) -> None:
        """Subscribe to messages with a header: the log names them by their stamp."""
        name = f"topic {self._node.resolve_topic_name(topic)}"

        def received(message: Stamped) -> None:
            self._log.begin_step(name, stamp=nanoseconds(message.header.stamp))
            callback(message)

        self._io.create_subscription(kind, topic, received, qos)

    def create_service(
        self, kind: ServiceType[Request, Response], name: str, callback: Callable[[Request, Response], Response]
    ) -> None:
        """Serve requests."""
        self._io.create_service(kind, name, self._recorded(name, callback))

    def create_order_service(
        self,
        kind: ServiceType[Request, SuccessResponseT],
        name: str,
        callback: Callable[[Request, SuccessResponseT], SuccessResponseT],
    ) -> None:
        """Serve requests after which something may move; one that is too old is no step of the node."""
        self._io.create_order_service(kind, name, self._recorded(name, callback))

    def _recorded(
        self, name: str, callback: Callable[[Request, Response], Response]
    ) -> Callable[[Request, Response], Response]:
        full = self._resolve(name)

        def requested(request: Request, response: Response) -> Response:
            self._log.begin_step(f"request {full}", as_bytes(request))
            response = callback(request, response)
            self._log.record_output(f"answered {full}", response)
            return response

        return requested

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Make a timer; the log does not tell several apart."""

        def due() -> None:
            self._log.begin_step("timer")
            callback()

        self._io.create_timer(period_s, due)

    def create_action_server(
        self,
        kind: ActionType[Goal, Result, Feedback],
        name: str,
        execute: Execute[Goal, Feedback, Result],
        cancel: Cancel[Goal, Feedback],
    ) -> None:
        """Serve goals."""
        full = self._resolve(name)
        to_cancel: set[bytes] = set()

        async def accepted(handle: GoalHandle[Goal, Feedback]) -> Result:
            key = bytes(handle.goal_id.uuid)
            self._log.begin_step(f"goal {full}", key + as_bytes(handle.request))
            result = await execute(_RecordedGoal(self._log, full, handle, to_cancel))
            to_cancel.discard(key)
            self._log.record_output(f"finished {full}", result)
            return result

        def cancelled(handle: GoalHandle[Goal, Feedback]) -> CancelResponse:
            key = bytes(handle.goal_id.uuid)
            self._log.begin_step(f"cancel {full}", key)
            to_cancel.add(key)
            return cancel(_RecordedGoal(self._log, full, handle, to_cancel))

        self._io.create_action_server(kind, name, accepted, cancelled)

    def create_client(self, kind: ServiceType[Request, Response], name: str) -> ServiceClient[Request, Response]:
        """Return a client of a service."""
        return _RecordedClient(self, self._log, self._io.create_client(kind, name), self._resolve(name))

    def create_action_client(self, kind: ActionType[Goal, Result, Feedback], name: str) -> GoalClient[Goal, Result]:
        """Return a client of an action."""
        return _RecordedActionClient(self, self._log, self._io.create_action_client(kind, name), self._resolve(name))

    def create_task(self, work: Callable[..., object], *arguments: object) -> None:
        """Run work in a step of its own, once the present one is over."""

        def due() -> None:
            self._log.begin_step("later")
            work(*arguments)

        self._io.create_task(due)

    async def wait_for(self, name: str, future: Future[T]) -> T:
        """Wait, then begin a step."""
        result = await self._io.wait_for(name, future)
        self._log.begin_step(f"resumed {name}")
        return result

    def next_number(self) -> bytes:
        """Return the number of what is sent, to tell its answer by."""
        self._sent += 1
        return self._sent.to_bytes(NUMBER_BYTES, "little")

    def _resolve(self, name: str) -> str:
        return str(self._node.resolve_service_name(name))


class Answer(Generic[T]):
    """An answer that is waited for: rclpy's Future, as far as callbacks go.

    The callbacks run in the step that brings the answer, and their errors are the step's: rclpy's Future only warns.
    """

    def __init__(self) -> None:
        self._result: T | None = None
        self._is_done = False
        self._callbacks: list[Callable[[Answer[T]], object]] = []

    def result(self) -> T:
        """Return the answer; None before it came."""
        return self._result  # type: ignore[return-value]  # as rclpy's

    def add_done_callback(self, callback: Callable[[Answer[T]], object]) -> None:
        """Call back with this object; at once when the answer is there."""
        if self._is_done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def set_result(self, result: T) -> None:
        """Give the answer."""
        self._result, self._is_done = result, True
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)


class _RecordedGoal(Generic[Goal, Feedback]):
    """A goal that is served, in rclpy's names."""

    def __init__(self, log: StepLog, name: str, handle: GoalHandle[Goal, Feedback], to_cancel: set[bytes]) -> None:
        self._log = log
        self._name = name
        self._handle = handle
        self._to_cancel = to_cancel
        self.request = handle.request
        self.goal_id = handle.goal_id

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client wants it to end, as far as a step has said so."""
        return bytes(self._handle.goal_id.uuid) in self._to_cancel

    def publish_feedback(self, feedback: Feedback) -> None:
        self._log.record_output(f"feedback {self._name}", feedback)
        self._handle.publish_feedback(feedback)

    def succeed(self) -> None:
        self._log.record_output(f"succeeded {self._name}", b"")
        self._handle.succeed()

    def abort(self) -> None:
        self._log.record_output(f"aborted {self._name}", b"")
        self._handle.abort()

    def canceled(self) -> None:
        self._log.record_output(f"canceled {self._name}", b"")
        self._handle.canceled()


class _RecordedClient(Generic[Request, Response]):
    """A client of a service, in rclpy's names."""

    def __init__(self, io: RecordingIo, log: StepLog, client: ServiceClient[Request, Response], name: str) -> None:
        self._io = io
        self._log = log
        self._client = client
        self._name = name

    def service_is_ready(self) -> bool:
        return self._log.observe(f"ready {self._name}", lambda: bytes([self._client.service_is_ready()])) == b"\1"

    def call_async(self, request: Request) -> Answer[Response | None]:
        number, answer = self._io.next_number(), Answer[Response | None]()
        self._log.record_output(f"called {self._name}", request)

        def responded(future: PendingResult[Response | None]) -> None:
            response = future.result()
            self._log.begin_step(f"response {self._name}", number + (b"" if response is None else as_bytes(response)))
            answer.set_result(response)

        self._client.call_async(request).add_done_callback(responded)
        return answer


class _RecordedActionClient(Generic[Goal, Result]):
    """A client of an action, in rclpy's names."""

    def __init__(self, io: RecordingIo, log: StepLog, client: GoalClient[Goal, Result], name: str) -> None:
        self._io = io
        self._log = log
        self._client = client
        self._name = name

    def server_is_ready(self) -> bool:
        return self._log.observe(f"ready {self._name}", lambda: bytes([self._client.server_is_ready()])) == b"\1"

    def send_goal_async(self, goal: Goal) -> Answer[SentGoal[Result]]:
        number, answer = self._io.next_number(), Answer[SentGoal[Result]]()
        self._log.record_output(f"sent {self._name}", goal)

        def taken(future: PendingResult[SentGoal[Result]]) -> None:
            handle = future.result()
            self._log.begin_step(f"taken {self._name}", number + bytes([handle.accepted]))
            answer.set_result(_RecordedSentGoal(self._log, self._name, number, handle))

        self._client.send_goal_async(goal).add_done_callback(taken)
        return answer


class _RecordedSentGoal(Generic[Result]):
    """A goal sent to another node, in rclpy's names."""

    def __init__(self, log: StepLog, name: str, number: bytes, handle: SentGoal[Result]) -> None:
        self._log = log
        self._name = name
        self._number = number
        self._handle = handle
        self.accepted = bool(handle.accepted)

    def cancel_goal_async(self) -> None:
        self._log.record_output(f"withdrawn {self._name}", self._number)
        self._handle.cancel_goal_async()

    def get_result_async(self) -> Answer[GoalResult[Result]]:
        answer: Answer[GoalResult[Result]] = Answer()

        def done(future: PendingResult[GoalResult[Result]]) -> None:
            response = future.result()
            self._log.begin_step(f"result {self._name}", self._number + as_bytes(response.result))
            answer.set_result(response)

        self._handle.get_result_async().add_done_callback(done)
        return answer


def as_bytes(message: object) -> bytes:
    """Return a message in the wire's form; bytes as they are."""
    return message if isinstance(message, bytes) else bytes(serialize_message(message))
