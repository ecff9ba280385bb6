# SPDX-License-Identifier: Apache-2.0
"""Latency, loss, rate and start-up of embedded/, and of the real rclpy when a ROS 2 is sourced.

Two processes; the sender puts the monotonic clock, which processes of one machine share, into the message. The same
file is run as the processes: `python runtime_latency.py ROLE ...` with whatever rclpy its interpreter finds.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS = 3
JOINTS = 12
IMAGE_BYTES = 640 * 480 * 3
SERVICE_CALLS = 1000
SMALL_MESSAGES = 40_000
READY = "ready"
_DEADLINE_S = 60.0


@dataclass(frozen=True)
class Stream:
    """One row of the table: what is sent, how often, for how long."""

    name: str
    kind: str
    rate_hz: float
    count: int


STREAMS = (
    Stream("JointState 100 Hz", "joints", 100.0, 250),
    Stream("JointState 1 kHz", "joints", 1000.0, 3000),
    Stream("image 30 Hz", "image", 30.0, 90),
)


# -- roles: run as their own process, by either stack ----------------------------------------------------------


def _node(name: str) -> Any:
    import rclpy  # noqa: PLC0415  the controlling process needs no rclpy

    rclpy.init()
    return rclpy.create_node(name)


def _message(kind: str) -> Any:
    if kind == "joints":
        from sensor_msgs.msg import JointState  # noqa: PLC0415  as above

        values = [float(i) for i in range(JOINTS)]
        names = [f"joint_{i}" for i in range(JOINTS)]
        return JointState(name=names, position=values, velocity=values, effort=values)
    if kind == "image":
        from sensor_msgs.msg import Image  # noqa: PLC0415  as above

        return Image(height=480, width=640, step=1920, encoding="bgr8", data=bytes(IMAGE_BYTES))
    from builtin_interfaces.msg import Time  # noqa: PLC0415  as above

    return Time()


def _qos(kind: str) -> Any:
    from rclpy import qos  # noqa: PLC0415  as above

    if kind == "small":
        return qos.QoSProfile(history=qos.HistoryPolicy.KEEP_ALL)
    return qos.QoSProfile(depth=100)


def _set_stamp(message: Any, now_ns: int) -> None:
    stamp = message.header.stamp if hasattr(message, "header") else message
    stamp.sec, stamp.nanosec = divmod(now_ns, 10**9)


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp if hasattr(message, "header") else message
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def receive(kind: str, count: int) -> None:
    """Subscribe; print latencies [us] when all have come, or none for a second after the first."""
    import rclpy  # noqa: PLC0415  as above

    node = _node("receiver")
    latencies: list[float] = []
    last = [time.monotonic()]

    def arrived(message: Any) -> None:
        now = time.monotonic_ns()
        latencies.append((now - _stamp_ns(message)) / 1000.0)
        last[0] = now / 1e9

    node.create_subscription(type(_message(kind)), "stream", arrived, _qos(kind))
    print(READY, flush=True)
    while len(latencies) < count and (not latencies or time.monotonic() < last[0] + 1.0):
        rclpy.spin_once(node, timeout_sec=0.2)
    print(json.dumps({"latencies_us": latencies, "last_s": last[0]}), flush=True)
    node.destroy_node()
    rclpy.shutdown()


def send(kind: str, rate_hz: float, count: int) -> None:
    """Publish ``count`` messages at a rate (0 = as fast as it goes), once the receiver is there."""
    import rclpy  # noqa: PLC0415  as above

    node = _node("sender")
    publisher = node.create_publisher(type(_message(kind)), "stream", _qos(kind))
    end = time.monotonic() + _DEADLINE_S
    while publisher.get_subscription_count() < 1 and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.02)
    message = _message(kind)
    start = time.monotonic()
    for i in range(count):
        if rate_hz:
            time.sleep(max(0.0, start + i / rate_hz - time.monotonic()))
        _set_stamp(message, time.monotonic_ns())
        publisher.publish(message)
    print(json.dumps({"first_s": start}), flush=True)
    sys.stdin.readline()  # stays until the receiver has everything
    node.destroy_node()
    rclpy.shutdown()


def serve() -> None:
    """Answer std_srvs/Trigger until standard input closes."""
    import threading  # noqa: PLC0415  as above

    import rclpy  # noqa: PLC0415  as above
    from rclpy.executors import ExternalShutdownException  # noqa: PLC0415  as above
    from std_srvs.srv import Trigger  # noqa: PLC0415  as above

    node = _node("server")

    def answer(_: Any, response: Any) -> Any:
        response.success = True
        return response

    node.create_service(Trigger, "trigger", answer)
    print(READY, flush=True)

    def stop_with_input() -> None:
        sys.stdin.readline()
        rclpy.shutdown()

    threading.Thread(target=stop_with_input, daemon=True).start()
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        return


def call(count: int) -> None:
    """Call the service one after the other; print round trips [us]."""
    import rclpy  # noqa: PLC0415  as above
    from std_srvs.srv import Trigger  # noqa: PLC0415  as above

    node = _node("client")
    client = node.create_client(Trigger, "trigger")
    client.wait_for_service(_DEADLINE_S)
    times = []
    for _ in range(count):
        start = time.monotonic_ns()
        rclpy.spin_until_future_complete(node, client.call_async(Trigger.Request()))
        times.append((time.monotonic_ns() - start) / 1000.0)
    print(json.dumps({"latencies_us": times}), flush=True)
    node.destroy_node()
    rclpy.shutdown()


def start_up() -> None:
    """Print when a timer of a node is called for the first time."""
    import rclpy  # noqa: PLC0415  as above

    node = _node("starter")
    node.create_publisher(type(_message("joints")), "stream", 10)
    called: list[bool] = []
    node.create_timer(0.0, lambda: called.append(True))
    while not called:
        rclpy.spin_once(node)
    print(READY, flush=True)
    sys.stdin.readline()
    node.destroy_node()
    rclpy.shutdown()


# -- the controlling process -----------------------------------------------------------------------------------


class Stack:
    """How processes of one stack are started."""

    def __init__(self, name: str, python: str, environment: dict[str, str]) -> None:
        self.name = name
        self._python = python
        self._environment = environment

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        """Start a role."""
        command = [self._python, str(Path(__file__).resolve()), *map(str, arguments)]
        return subprocess.Popen(
            command,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def stacks(cache: str) -> list[Stack]:
    """Return embedded/ and, when a ROS 2 is sourced, the real rclpy.

    Args:
        cache: folder for compiled Python files: start-up is measured with them, as after a first start.
    """
    compiled = {"PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
    own = {key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "AMENT_PREFIX_PATH"}}
    own |= {"EMBEDDED_ROUTER_PORT": str(_free_port()), "ROS_DOMAIN_ID": "77", **compiled}
    found = [Stack("embedded", sys.executable, own)]
    if os.environ.get("AMENT_PREFIX_PATH") and (python := shutil.which("python3")):
        rmw = os.environ.get("RMW_IMPLEMENTATION", "default rmw")
        found.append(Stack(f"rclpy on {rmw}", python, {**os.environ, "ROS_DOMAIN_ID": "77", **compiled}))
    return found


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"{process.args!r} ended with {process.wait()} before it answered")
    return line


def _finish(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    process.wait(_DEADLINE_S)


def run_stream(stack: Stack, kind: str, rate_hz: float, count: int) -> dict[str, Any]:
    """Return latencies [us] and the seconds from the first message sent to the last received."""
    receiver = stack.start("receive", kind, count)
    _line(receiver)
    sender = stack.start("send", kind, rate_hz, count)
    sent = json.loads(_line(sender))
    received = json.loads(_line(receiver))
    _finish(sender)
    _finish(receiver)
    return {"latencies_us": received["latencies_us"], "seconds": received["last_s"] - sent["first_s"]}


def run_service(stack: Stack) -> list[float]:
    """Return round trips [us]."""
    server = stack.start("serve")
    _line(server)
    client = stack.start("call", SERVICE_CALLS)
    times: list[float] = json.loads(_line(client))["latencies_us"]
    _finish(client)
    _finish(server)
    return times


def run_start_up(stack: Stack) -> float:
    """Return seconds from starting the process to the first callback, while another process is up."""
    first = stack.start("start_up")
    _line(first)
    begin = time.monotonic()
    second = stack.start("start_up")
    _line(second)
    seconds = time.monotonic() - begin
    _finish(second)
    _finish(first)
    return seconds


def percentile(values: list[float], share: float) -> float:
    """Return a percentile by rank."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def measure(stack: Stack) -> dict[str, list[float]]:
    """Return the figures of all rounds by claim name."""
    figures: dict[str, list[float]] = {}
    sent = lost = 0
    run_start_up(stack)  # fills the cache
    for _ in range(ROUNDS):
        for stream in STREAMS:
            latencies = run_stream(stack, stream.kind, stream.rate_hz, stream.count)["latencies_us"]
            sent += stream.count
            lost += stream.count - len(latencies)
            figures.setdefault(f"{stream.name} p50", []).append(percentile(latencies, 0.50))
            figures.setdefault(f"{stream.name} p99", []).append(percentile(latencies, 0.99))
        figures.setdefault("service p50", []).append(percentile(run_service(stack), 0.50))
        figures.setdefault("start-up", []).append(run_start_up(stack))
        small = run_stream(stack, "small", 0.0, SMALL_MESSAGES)
        sent += SMALL_MESSAGES
        lost += SMALL_MESSAGES - len(small["latencies_us"])
        figures.setdefault("small messages rate", []).append(len(small["latencies_us"]) / small["seconds"])
    figures["loss"] = [100.0 * lost / sent]
    return figures


def report() -> None:
    """Measure and print the claims."""
    from softgrip_testing.benchmark_claim import claim, spread  # noqa: PLC0415  the roles run without it

    with tempfile.TemporaryDirectory() as cache:
        measured = [(stack.name, measure(stack)) for stack in stacks(cache)]
    _, ours = measured[0]
    peer, theirs = measured[1] if len(measured) > 1 else ("", {})
    units = {"start-up": "s", "small messages rate": "1/s", "loss": "%"}
    goals = {"small messages rate": 20_000.0, "loss": 0.0}
    for name, values in ours.items():
        unit = units.get(name, "us")
        other = statistics.median(theirs[name]) if name in theirs else None
        claim(
            name,
            statistics.median(values),
            unit,
            better="higher" if unit == "1/s" else "lower",
            goal=goals.get(name, other if name.endswith("p50") else None),
            peer=peer,
            peer_value=other,
            runs=len(values),
            note=spread(values, unit) + (f"; peer {spread(theirs[name], unit)}" if name in theirs else ""),
        )


def main() -> None:
    """Control, or play a role."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    roles = parser.add_subparsers(dest="role", metavar="role (none: measure everything)")
    receiver = roles.add_parser("receive")
    receiver.add_argument("kind")
    receiver.add_argument("count", type=int)
    sender = roles.add_parser("send")
    sender.add_argument("kind")
    sender.add_argument("rate_hz", type=float)
    sender.add_argument("count", type=int)
    roles.add_parser("serve")
    caller = roles.add_parser("call")
    caller.add_argument("count", type=int)
    roles.add_parser("start_up")
    arguments = vars(parser.parse_args())
    role = arguments.pop("role")
    if role is None:
        report()
    else:
        roles_by_name: dict[str, Callable[..., None]] = {
            "receive": receive,
            "send": send,
            "serve": serve,
            "call": call,
            "start_up": start_up,
        }
        roles_by_name[role](**arguments)


if __name__ == "__main__":
    main()
