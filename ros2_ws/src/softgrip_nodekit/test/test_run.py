# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import gc
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from control_msgs.action import GripperCommand
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor

from softgrip_nodekit import (
    CallbackErrors,
    CellNode,
    Diagnostics,
    FatalError,
    Health,
    StartupError,
    callback_errors,
    run,
)
from softgrip_nodekit.run import CANNOT_START
from softgrip_testing.waiting import wait_until


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """A node's process ignores signals once it leaves; this one has more to do, and its children inherit that."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


ERROR = "Unable to convert call argument '0' to Python object"


class Failing(CellNode):
    """Fails in each callback, until it has been asked often enough."""

    def __init__(self, calls: int = 3) -> None:
        super().__init__("failing")
        self._left = calls
        self.create_timer(0.01, self._fail)
        self.health: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        self.diagnostics = Diagnostics(self, period=0.05)
        self.closed = False

    def _fail(self) -> None:
        self._left -= 1
        if self._left >= 0:
            raise RuntimeError(ERROR)

    def _hear(self, message: DiagnosticArray) -> None:
        self.health += [status for status in message.status if status.name == "failing: executor"]
        if self._left < 0 and len(self.health) > 2:
            rclpy.shutdown()

    def close(self) -> None:
        self.closed = True


class Interrupted(Failing):
    """The same while the context ends: rclpy says this when the taking of a message is cut short."""

    def _fail(self) -> None:
        rclpy.try_shutdown()
        super()._fail()


class Fatal(Failing):
    """Says itself that it cannot go on."""

    def _fail(self) -> None:
        raise FatalError("the bus loop has ended")


class Refusing(Failing):
    """Finds only when it runs that it cannot."""

    def _fail(self) -> None:
        raise StartupError("no such device")


def keep(made: list[Failing], kind: type[Failing]) -> Callable[[], Failing]:
    def make() -> Failing:
        made.append(kind())
        return made[0]

    return make


@pytest.mark.parametrize("threads", [1, 2])
def test_a_callback_that_raises_is_counted_and_shown_and_the_node_goes_on(
    threads: int, capfd: pytest.CaptureFixture[str]
) -> None:
    made: list[Failing] = []
    assert run(keep(made, Failing), [], threads=threads) == 0
    assert made[0].closed
    health = made[0].health[-1]
    assert {value.key: value.value for value in health.values}["callback_errors"] == "3"
    assert health.level == bytes([Health.WARN])
    assert ERROR in health.message
    assert capfd.readouterr().err.count("a callback failed, the node goes on") <= 1


def test_an_error_that_the_executor_lets_out_twice_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """As rclpy's executor of several threads does it: a callback's task can be among the finished ones twice."""
    once, again = RuntimeError(ERROR), RuntimeError(ERROR)
    raised = iter([once, once, again, ExternalShutdownException()])

    def spin(_: object) -> None:
        raise next(raised)

    monkeypatch.setattr(MultiThreadedExecutor, "spin", spin)
    made: list[Failing] = []
    assert run(keep(made, Failing), [], threads=2) == 0
    assert callback_errors(made[0]).count == 2


def test_what_a_callback_raises_while_the_node_is_being_stopped_is_no_error(capfd: pytest.CaptureFixture[str]) -> None:
    made: list[Failing] = []
    assert run(keep(made, Interrupted), []) == 0
    assert made[0].closed
    assert callback_errors(made[0]).count == 0
    assert ERROR not in capfd.readouterr().err


def test_a_node_whose_context_a_signal_ends_at_the_same_moment_leaves_without_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shut_down = rclpy.try_shutdown

    def too_late() -> None:
        shut_down()
        raise RuntimeError("failed to shutdown: rcl_shutdown already called on the given context")

    monkeypatch.setattr(rclpy, "try_shutdown", too_late)
    made: list[Failing] = []
    assert run(keep(made, Failing), []) == 0
    assert made[0].closed


@pytest.mark.parametrize(("kind", "code", "text"), [(Fatal, 1, "the bus loop has ended"), (Refusing, 2, "no such")])
def test_only_a_node_that_says_so_ends_over_a_callback(
    kind: type[Failing], code: int, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    made: list[Failing] = []
    assert run(keep(made, kind), []) == code
    assert made[0].closed
    assert text in capfd.readouterr().err


def test_whatever_keeps_a_node_from_starting_is_a_refusal_however_long_it_took(
    capfd: pytest.CaptureFixture[str],
) -> None:
    def unopened() -> CellNode:
        raise RuntimeError("key.pem: expected mode 0600, found 0644")

    assert run(unopened, []) == CANNOT_START
    errors = capfd.readouterr().err
    assert "[unopened] cannot start: key.pem: expected mode 0600, found 0644" in errors
    assert "Traceback" in errors


def test_errors_of_one_place_say_one_line_and_old_places_are_forgotten() -> None:
    now, said = [0.0], []
    errors = CallbackErrors(said.append, clock=lambda: now[0])

    def fail(kind: type[Exception]) -> None:
        try:
            raise kind("x")
        except kind as error:
            errors.report(error)

    for _ in range(100):
        fail(ValueError)
    fail(KeyError)
    wait_until(lambda: len(said) >= 2, said)
    assert len(said) == 2
    assert errors.count == 101
    now[0] = 5.0
    fail(ValueError)
    wait_until(lambda: len(said) >= 3, said)
    assert len(said) == 3
    assert "102 such errors so far" in said[2]
    assert errors.is_recent()
    now[0] = 100.0
    assert not errors.is_recent()
    for number in range(1000):
        fail(type(f"Error{number}", (Exception,), {}))
    assert len(errors._said) == 64


class Acting(CellNode):
    """Has actions, which rclpy's destroy_node leaves to whoever made them."""

    def __init__(self) -> None:
        super().__init__("acting")
        ActionServer(self, GripperCommand, "act", execute_callback=lambda _: GripperCommand.Result())
        ActionClient(self, GripperCommand, "act")
        self.create_timer(0.01, rclpy.shutdown)
        self.left: list[object] | None = None

    def destroy_node(self) -> None:
        self.left = [one for one in self.waitables if isinstance(one, ActionServer | ActionClient)]
        super().destroy_node()


def test_nothing_of_a_node_is_left_in_the_middleware_when_its_process_ends() -> None:
    made: list[Acting] = []

    def make() -> Acting:
        made.append(Acting())
        return made[0]

    assert run(make, []) == 0
    assert made[0].left == []
    assert gc.get_freeze_count() == 0, "what is frozen is never collected, and keeps its part of the middleware"


def test_a_node_that_a_key_does_not_permit_says_how_to_compare_the_keys(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refused() -> CellNode:
        raise RuntimeError("Failed to create publisher: failed to create topic for unknown reasons")

    assert run(refused, []) == CANNOT_START
    assert "--check" not in capfd.readouterr().err
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    assert run(refused, []) == CANNOT_START
    assert "softgrip_security keys FOLDER --check" in capfd.readouterr().err


CLINGING = """
import ctypes, sys
import rclpy
from softgrip_nodekit import CellNode
from softgrip_nodekit import run

class Clinging(CellNode):
    def __init__(self):
        super().__init__("clinging")
        self.create_timer(0.01, rclpy.shutdown)

    def close(self):
        print("safe", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(20)  # with Python's lock: no thread of Python's could end this

sys.exit(run(Clinging, []))
"""


def test_a_middleware_that_does_not_let_go_holds_nobody_up() -> None:
    started = time.monotonic()
    done = subprocess.run([sys.executable, "-c", CLINGING], capture_output=True, text=True, check=False, timeout=40)
    assert 3.0 < time.monotonic() - started < 18.0
    assert done.returncode == 1
    assert done.stdout == "safe\n"  # the hardware first
    assert "in destroy_node" in done.stderr


WAITING = """
import sys
from softgrip_nodekit import HardwareNode, run

class Waiting(HardwareNode):
    device_paths = sys.argv[1:2]

    def __init__(self):
        super().__init__("waiting")
        self.declare_parameter("autostart", True)

    def on_configure(self, state):
        print("configured", flush=True)
        return super().on_configure(state)

    def disconnect(self):
        pass

    def close(self):
        print("safe", flush=True)

def make():
    node = Waiting()
    print("made", flush=True)
    return node

sys.exit(run(make, sys.argv[2:]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("awaited", ["cell", "device"])
def test_a_node_that_waits_at_its_start_ends_when_told_to(tmp_path: Path, awaited: str, number: signal.Signals) -> None:
    """A cell that is interrupted while it starts must leave no process that waits for one that has ended."""
    lockstep = ("use_sim_time:=true", f"lockstep:={tmp_path}/none") if awaited == "cell" else ()
    command = [sys.executable, "-c", WAITING, str(tmp_path / "no-device" if awaited == "device" else tmp_path)]
    command += ["--ros-args", *(word for value in lockstep for word in ("-p", value))]
    node = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert node.stdout is not None
    assert node.stdout.readline() == "made\n"
    time.sleep(0.5)  # it waits
    node.send_signal(number)
    said, _ = node.communicate(timeout=30)  # it would wait for a minute
    assert said == "safe\n"
    assert node.returncode == 0


BUSY = """
import sys, time
import rclpy
from std_msgs.msg import Empty
from softgrip_nodekit import CellNode, run

class Busy(CellNode):
    def __init__(self):
        super().__init__("busy")
        self.heard = self.create_subscription(Empty, "last_word", lambda _: None, 1)
        self.last_word = self.create_publisher(Empty, "last_word", 1)
        self.once = self.create_timer(0.01, self.work)

    def work(self):
        self.once.cancel()
        print("begins", flush=True)
        time.sleep(float(sys.argv[2]))
        print("ends", flush=True)

    def close(self):
        print("closes", flush=True)
        time.sleep(float(sys.argv[3]))
        self.last_word.publish(Empty())
        print("safe, middleware alive:", rclpy.ok(), flush=True)

sys.exit(run(Busy, [], threads=int(sys.argv[1])))
"""


def busy_node(work_s: float, threads: int = 1, close_s: float = 0.0) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", BUSY, str(threads), str(work_s), str(close_s)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


CLOSED = ["closes", "safe, middleware alive: True"]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_lets_a_callback_finish_and_the_node_say_its_last_word(number: signal.Signals, threads: int) -> None:
    """What a node must say at its end, such as that its tendons are free, needs a middleware that is still there."""
    node = busy_node(1.0, threads)
    assert node.stdout is not None
    assert node.stdout.readline() == "begins\n"
    node.send_signal(number)
    said, errors = node.communicate(timeout=30)
    lines = said.splitlines()
    if threads > 1:  # it closes beside a callback that another thread runs, and tells it to end
        lines.sort(key=["ends", *CLOSED].index)
    assert lines == ["ends", *CLOSED]
    assert (node.returncode, errors) == (0, "")


def test_a_waiting_node_leaves_at_a_signal() -> None:
    node = busy_node(0.0)
    assert node.stdout is not None
    assert [node.stdout.readline() for _ in range(2)] == ["begins\n", "ends\n"]
    time.sleep(0.5)  # in the middleware, where Python runs no handler
    node.terminate()
    said, errors = node.communicate(timeout=30)
    assert (said.splitlines(), errors, node.returncode) == (CLOSED, "", 0)


def test_a_second_signal_cuts_a_callback_short() -> None:
    node = busy_node(300.0)
    assert node.stdout is not None
    assert node.stdout.readline() == "begins\n"
    node.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert node.poll() is None, "it waits for the callback"
    node.send_signal(signal.SIGTERM)
    said, errors = node.communicate(timeout=30)
    assert (said.splitlines(), errors, node.returncode) == (CLOSED, "", 0)


def test_no_signal_cuts_the_way_to_safe_short() -> None:
    node = busy_node(0.0, close_s=1.0)
    assert node.stdout is not None
    assert [node.stdout.readline() for _ in range(2)] == ["begins\n", "ends\n"]
    node.send_signal(signal.SIGINT)
    assert node.stdout.readline() == "closes\n"
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        node.send_signal(number)
        time.sleep(0.1)
    said, errors = node.communicate(timeout=30)
    assert (said.splitlines(), errors, node.returncode) == (CLOSED[1:], "", 0)
