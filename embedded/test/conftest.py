# SPDX-License-Identifier: Apache-2.0
"""A private router port for the whole run, contexts that are closed, and processes that are ended."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl import rcutils_logger
from rclpy.node import Node


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session", autouse=True)
def private_cell() -> None:
    os.environ["EMBEDDED_ROUTER_PORT"] = str(free_port())
    os.environ["ROS_DOMAIN_ID"] = "83"


@pytest.fixture(autouse=True)
def fresh_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever tests before have said or silenced in this process: all that a process may say is left."""
    monkeypatch.setattr(rcutils_logger, "_levels", {})
    monkeypatch.setattr(rcutils_logger, "_budget", rcutils_logger.Budget())


@pytest.fixture
def context() -> Iterator[Context]:
    made = Context()
    rclpy.init(args=[], context=made)
    yield made
    made.try_shutdown()


@pytest.fixture
def make_node(context: Context) -> Iterator[Callable[..., Node]]:
    nodes: list[Node] = []

    def make(name: str, **options: Any) -> Node:
        node = rclpy.create_node(name, context=context, **options)
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def spin_until(context: Context) -> Iterator[Callable[..., bool]]:
    """Spin nodes until a condition holds; False when it does not within the deadline."""
    executor = SingleThreadedExecutor(context=context)

    def spin(condition: Callable[[], bool], *nodes: Node, deadline_s: float = 10.0) -> bool:
        for node in nodes:
            executor.add_node(node)
        end = time.monotonic() + deadline_s
        while not condition() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        return condition()

    yield spin
    executor.shutdown()


class Process:
    """A process with its output collected line by line."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self.lines: list[str] = []
        self._arrived = threading.Condition()
        self.popen = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, process_group=0
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            with self._arrived:
                self.lines.append(line.rstrip("\n"))
                self._arrived.notify_all()

    def wait_for(self, text: str, deadline_s: float = 20.0, *, after: int = 0) -> int:
        """Wait for a line that contains a text; return the number of lines up to it."""
        end = time.monotonic() + deadline_s
        with self._arrived:
            while True:
                for index, line in enumerate(self.lines[after:], after):
                    if text in line:
                        return index + 1
                left = end - time.monotonic()
                if left <= 0 or not self._arrived.wait(left):
                    raise AssertionError(f"no line with {text!r} within {deadline_s} s in:\n" + "\n".join(self.lines))

    def stop(self, number: int = signal.SIGINT) -> int:
        self.popen.send_signal(number)
        code = self.popen.wait(20)
        self._reader.join(5)
        return code


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace with one package: a talker, a listener, an action, interfaces, launch files written by the tests."""
    package = tmp_path / "ws" / "talk_interfaces"
    (package / "talk_interfaces").mkdir(parents=True)
    (package / "msg").mkdir()
    (package / "action").mkdir()
    (package / "launch").mkdir()
    (package / "package.xml").write_text("<package><name>talk_interfaces</name></package>")
    (package / "setup.cfg").write_text(
        "[options.entry_points]\nconsole_scripts =\n    talker = talk_nodes:talk\n    listener = talk_nodes:listen\n"
        "    breaks = talk_nodes:breaks\n    waiter = talk_nodes:wait\n    asker = talk_nodes:ask\n"
    )
    (package / "msg" / "Count.msg").write_text("int32 value 7   # a default\nstring<=5 word\nuint8 LIMIT=3\n")
    (package / "action" / "Wait.action").write_text("string file\n---\nint32 value\n---\n")
    (package / "talk_nodes.py").write_text(TALK_NODES)
    return tmp_path / "ws"


TALK_NODES = """
import os
import sys
import time
import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from talk_interfaces.action import Wait
from talk_interfaces.msg import Count


def spin(node, executor=None):
    try:
        rclpy.spin(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def talk():
    rclpy.init()
    node = rclpy.create_node("talker")
    node.declare_parameter("period", 0.05)
    publisher = node.create_publisher(Count, "count", 10)
    message = Count(value=0)

    def tick():
        message.value += 1
        publisher.publish(message)

    node.create_timer(node.get_parameter("period").value, tick)
    node.get_logger().info("talking")
    spin(node)


def listen():
    rclpy.init()
    node = rclpy.create_node("listener")
    node.create_subscription(Count, "count", lambda m: print("heard", m.value, flush=True), 10)
    seen = set()

    def look():
        now = set(node.get_node_names())
        for name in now - seen:
            print("up", name, flush=True)
        for name in seen - now:
            print("down", name, flush=True)
        seen.clear()
        seen.update(now)

    node.create_timer(0.02, look)
    spin(node)


def wait():
    rclpy.init()
    node = rclpy.create_node("waiter")

    def execute(goal):
        while not os.path.exists(goal.request.file):
            time.sleep(0.02)
        goal.succeed()
        return Wait.Result(value=7)

    ActionServer(node, Wait, "wait", execute)
    spin(node, MultiThreadedExecutor())


def ask():
    rclpy.init()
    node = rclpy.create_node("asker")
    client = ActionClient(node, Wait, "wait")
    client.wait_for_server()
    sent = client.send_goal_async(Wait.Goal(file=sys.argv[1]))
    rclpy.spin_until_future_complete(node, sent)
    asked = sent.result().get_result_async()
    node.create_timer(0.05, lambda: print("asking", flush=True))
    rclpy.spin_until_future_complete(node, asked)
    print("found", asked.result().result.value, flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


def breaks():
    print("cannot go on: no device", file=sys.stderr)
    return 3
"""


@pytest.fixture
def start(workspace: Path) -> Iterator[Callable[..., Process]]:
    """Start ``ros2`` in a process of the private cell and the workspace."""
    processes: list[Process] = []

    def run(*arguments: str, **environment: str) -> Process:
        command = [sys.executable, "-m", "embedded_ros.commands.main", *arguments]
        where = {
            **os.environ,
            "EMBEDDED_WORKSPACE": str(workspace),
            "PYTHONPATH": str(workspace / "talk_interfaces"),
            "PYTHONUNBUFFERED": "1",
            "ROS_LOG_DIR": str(workspace / "log"),
            **environment,
        }
        process = Process(command, where)
        processes.append(process)
        return process

    yield run
    for process in processes:
        if process.popen.poll() is None:
            os.killpg(process.popen.pid, signal.SIGKILL)
        process.popen.wait()
        assert process.popen.stdout is not None
        process.popen.stdout.close()
