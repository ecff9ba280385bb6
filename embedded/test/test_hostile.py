# SPDX-License-Identifier: Apache-2.0
"""A stranger who knows only the wire: nothing that it sends ends a node, and nobody else's request is lost over it."""

from __future__ import annotations

import os
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from rcl_interfaces.msg import Log, Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl import rcutils_logger
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from embedded_ros import limits, wire
from embedded_ros.errors import CdrError, RequestRefusedError, WireError
from embedded_ros.throttle import Throttle

GARBAGE = [
    pytest.param(b"\x00\x01\x00\x00\x00", None, id="no attachment"),
    pytest.param(b"\x00\x01\x00\x00\x00", b"short", id="short attachment"),
    pytest.param(b"\x00\x01\x00\x00\x00", struct.pack("<qqB16s", 1, 1, 200, bytes(16)), id="wrong gid"),
    pytest.param(b"", wire.encode_attachment(1, 1, bytes(16)), id="empty"),
    pytest.param(b"\x00\x00\x00\x00\x00", wire.encode_attachment(1, 1, bytes(16)), id="big-endian"),
    pytest.param(b"\x00\x01\x00\x00", wire.encode_attachment(1, 1, bytes(16)), id="too short"),
]
Spin = Callable[..., bool]


@pytest.fixture
def stranger(make_node: Callable[..., Node]) -> Iterator[zenoh.Session]:
    """A bare session at the port where the nodes meet."""
    make_node("host")
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["tcp/localhost:{os.environ["EMBEDDED_ROUTER_PORT"]}"]')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration) as session:
        yield session


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    said: list[str] = []
    monkeypatch.setattr(rcutils_logger, "_write", lambda _, __, ___, text, ____: said.append(text))
    return said


def ask(session: zenoh.Session, key: str, payload: bytes, attachment: bytes | None) -> list[zenoh.Reply]:
    querier = session.declare_querier(key, timeout=10.0)
    await_matching(querier, key)
    return list(querier.get(payload=payload, attachment=attachment))


def reach(session: zenoh.Session, key: str) -> Any:
    """Return a publisher that has found a subscription; it loses nothing."""
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    await_matching(publisher, key)
    return publisher


def await_matching(declared: Any, key: str) -> None:
    end = time.monotonic() + 10.0
    while not declared.matching_status.matching:
        assert time.monotonic() < end, f"nobody is there for {key}"
        time.sleep(0.01)


@pytest.mark.parametrize(("payload", "attachment"), GARBAGE)
def test_a_malformed_request_is_answered_with_an_error_and_takes_nobodys_place(
    stranger: zenoh.Session, make_node: Callable[..., Node], payload: bytes, attachment: bytes | None
) -> None:
    server = make_node("server").create_service(Trigger, "stop", lambda _, response: response)
    for _ in range(30):
        (reply,) = ask(stranger, server._key, payload, attachment)
        assert reply.err is not None
        assert b"malformed" in reply.err.payload.to_bytes()
    assert not server._is_ready()


def test_a_full_queue_refuses_the_newest_and_answers_it(make_node: Callable[..., Node], spin_until: Spin) -> None:
    served: list[int] = []

    def serve(_: Any, response: Any) -> Any:
        served.append(1)
        return response

    node, client_node = make_node("server"), make_node("client")
    server = node.create_service(Trigger, "stop", serve)
    client = client_node.create_client(Trigger, "stop")
    assert client.wait_for_service(10.0)
    # Nobody spins the server: its ten places are taken in turn.
    futures = [client.call_async(Trigger.Request()) for _ in range(12)]
    assert spin_until(lambda: sum(f.done() for f in futures) == 2, client_node)
    refused = [future for future in futures if future.done()]
    assert refused == futures[-2:]
    for future in refused:
        with pytest.raises(RequestRefusedError, match="busy: 10 requests are waiting"):
            future.result()
    assert spin_until(lambda: all(f.done() for f in futures), node, client_node)
    assert len(served) == 10
    assert not server._is_ready()


def test_a_callback_that_raises_is_told_to_whoever_asked(
    make_node: Callable[..., Node], context: Context, spin_until: Spin
) -> None:
    def fail(_: Any, __: Any) -> Any:
        raise OSError("the disk is full")

    node, client_node = make_node("server"), make_node("client")
    node.create_service(Trigger, "stop", fail)
    client = client_node.create_client(Trigger, "stop")
    assert client.wait_for_service(10.0)
    future = client.call_async(Trigger.Request())
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    with pytest.raises(OSError, match="the disk is full"):
        executor.spin_once(timeout_sec=10.0)
    assert spin_until(future.done, client_node)
    with pytest.raises(RequestRefusedError, match="the callback failed: OSError: the disk is full"):
        future.result()


@pytest.mark.parametrize("kind", [200, 255, 10])
@pytest.mark.parametrize("service", [SetParameters, SetParametersAtomically])
def test_a_parameter_of_no_type_is_refused_with_a_reason(
    make_node: Callable[..., Node], spin_until: Spin, kind: int, service: Any
) -> None:
    node, client_node = make_node("server"), make_node("client")
    name = "set_parameters" if service is SetParameters else "set_parameters_atomically"
    client = client_node.create_client(service, f"server/{name}")
    assert client.wait_for_service(10.0)
    future = client.call_async(
        service.Request(parameters=[Parameter(name="use_sim_time", value=ParameterValue(type=kind))])
    )
    assert spin_until(future.done, node, client_node)
    answer = future.result()
    result = answer.results[0] if service is SetParameters else answer.result
    assert not result.successful
    assert result.reason


@pytest.mark.parametrize(
    "token",
    [
        "@ros2_lv/{domain}/a/0/0/NN/%/%/bad-name!",
        "@ros2_lv/{domain}/a/0/0/NN/%/bad name/n",
        "@ros2_lv/{domain}/a/0/1/MP/%/%/n/%heard/std_msgs::msg::dds_::String_/RIHS01_0/9:9:9,9:,:,:9,,",
        "@ros2_lv/{domain}/a/0/1/MP/%/%/n/%heard/std_msgs::msg::dds_::String_/RIHS01_0/::,-5:,:,:,,",
        "@ros2_lv/{domain}/a/0/1/MP/%/%/n/%no topic!/std_msgs::msg::dds_::String_/RIHS01_0/::,7:,:,:,,",
        "@ros2_lv/{domain}/a/0/1/MP/%/%/n/%heard/String/RIHS01_0/::,7:,:,:,,",
    ],
)
def test_tokens_that_ros_would_not_make_are_passed_over(
    stranger: zenoh.Session, make_node: Callable[..., Node], context: Context, token: str
) -> None:
    node = make_node("listening")
    node.create_subscription(String, "heard", lambda _: None, 10)
    good = "@ros2_lv/{domain}/a/0/9/MP/%/%/stranger/%heard/std_msgs::msg::dds_::String_/RIHS01_0/::,7:,:,:,,"
    declare, domain = stranger.liveliness().declare_token, context.get_domain_id()
    with declare(token.format(domain=domain)), declare(good.format(domain=domain)):
        assert context._graph.wait(lambda: node.count_publishers("heard") == 1, 10.0)
        assert [info.node_name for info in node.get_publishers_info_by_topic("heard")] == ["stranger"]
        for name, namespace in node.get_node_names_and_namespaces():
            node.get_publisher_names_and_types_by_node(name, namespace)


def test_garbage_on_a_topic_says_one_line_and_what_follows_is_heard(
    stranger: zenoh.Session, make_node: Callable[..., Node], spin_until: Spin, lines: list[str]
) -> None:
    node, heard = make_node("listening"), []
    subscription = node.create_subscription(String, "heard", lambda message: heard.append(message.data), 1000)
    good = bytes(serialize_message(String(data="good")))
    publisher = reach(stranger, subscription._key)
    for number in range(300):
        attachment = wire.encode_attachment(number + 1, 1, number.to_bytes(16, "little"))
        publisher.put(b"\x00\x01\x00\x00\xff\xff\xff\xff", attachment=attachment)
    publisher.put(good, attachment=wire.encode_attachment(1, 1, b"g" * 16))
    assert spin_until(lambda: heard == ["good"], node)
    assert len([line for line in lines if "dropped a sample on '/heard'" in line]) == 1


def test_garbage_on_rosout_is_said_there_and_stops_nobody(
    stranger: zenoh.Session, make_node: Callable[..., Node], spin_until: Spin
) -> None:
    """What says that a sample was dropped goes back to the subscription that dropped it, in the same process."""
    node, heard = make_node("listening"), []
    latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscription = node.create_subscription(Log, "/rosout", lambda log: heard.append(log.msg), latched)
    reach(stranger, subscription._key).put(b"garbage", attachment=b"short")
    assert spin_until(lambda: any("dropped a sample on '/rosout'" in line for line in heard), node)
    node.get_logger().info("still here")
    assert spin_until(lambda: "still here" in heard, node)


def test_publishers_that_are_remembered_are_few(
    stranger: zenoh.Session, make_node: Callable[..., Node], spin_until: Spin
) -> None:
    node, heard = make_node("listening"), []
    subscription = node.create_subscription(String, "heard", lambda message: heard.append(message.data), 5000)
    good = bytes(serialize_message(String(data="good")))
    publisher = reach(stranger, subscription._key)
    for number in range(3000):
        attachment = wire.encode_attachment(1, 1, (number + 1).to_bytes(16, "little"))
        publisher.put(good, attachment=attachment)
    assert spin_until(lambda: len(heard) == 3000, node)
    assert len(subscription._last) <= 1024


def test_samples_longer_than_their_type_may_be_are_dropped_before_they_are_read(
    stranger: zenoh.Session, make_node: Callable[..., Node], spin_until: Spin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(limits.MAX_BYTES_VARIABLE, "std_msgs/msg/String=100")
    node, heard = make_node("listening"), []
    subscription = node.create_subscription(String, "heard", lambda message: heard.append(message.data), 10)
    publisher = reach(stranger, subscription._key)
    for text in ("x" * 100, "short"):
        attachment = wire.encode_attachment(1, 1, bytes(16))
        publisher.put(bytes(serialize_message(String(data=text))), attachment=attachment)
    assert spin_until(lambda: bool(heard), node)
    assert heard == ["short"]


def test_large_samples_that_wait_are_no_longer_together_than_one_may_be(
    stranger: zenoh.Session, make_node: Callable[..., Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(limits.MAX_BYTES_VARIABLE, "std_msgs/msg/String=100000")
    node = make_node("listening")
    subscription = node.create_subscription(String, "heard", lambda _: None, 1000)
    publisher = reach(stranger, subscription._key)
    one = bytes(serialize_message(String(data="x" * 20_000)))
    for number in range(50):
        publisher.put(one, attachment=wire.encode_attachment(number + 1, 1, bytes(16)))
    last = wire.encode_attachment(50, 1, bytes(16))
    end = time.monotonic() + 10.0
    while not (subscription._queue and subscription._queue[-1][1] == last):
        assert time.monotonic() < end, "the last sample has not come"
        time.sleep(0.01)
    assert len(subscription._queue) == 4
    assert subscription._waiting_bytes == 4 * len(one)


def test_small_samples_that_wait_take_no_more_memory_than_they_are_long(
    make_node: Callable[..., Node], stranger: zenoh.Session
) -> None:
    node = make_node("mailbox")
    subscription = node.create_subscription(String, "letters", lambda _: None, 10_000)
    publisher = reach(stranger, subscription._key)
    attachment = wire.encode_attachment(1, 1, bytes(16))
    sizes = []
    for letter in range(1, 1601):
        publisher.put(serialize_message(String(data="x")), attachment=attachment)
        time.sleep(0.0005)  # each in a packet of its own
        if letter % 800 == 0:
            end = time.monotonic() + 10.0
            while len(subscription._queue) < letter:
                assert time.monotonic() < end
                time.sleep(0.01)
            sizes.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE"))
    assert sizes[1] - sizes[0] < 800 * 2_000, sizes


def test_requests_longer_than_they_may_be_are_refused_before_they_are_read(
    stranger: zenoh.Session, make_node: Callable[..., Node]
) -> None:
    server = make_node("server").create_service(Trigger, "stop", lambda _, response: response)
    (reply,) = ask(stranger, server._key, bytes((1 << 20) + 1), wire.encode_attachment(1, 1, bytes(16)))
    assert reply.err is not None
    assert b"expected 1048576 bytes at most" in reply.err.payload.to_bytes()


def test_a_message_of_very_many_parts_is_refused_before_they_are_made() -> None:
    points = 100_000 // 3  # of a point, its duration and four lists, five are made whatever they hold
    for count, fits in ((points // 2, True), (400_000, False)):
        data = bytes(serialize_message(JointTrajectory(points=[JointTrajectoryPoint()] * count)))
        if fits:
            assert len(cdr_read(data).points) == count
            continue
        tracemalloc.start()
        with pytest.raises(CdrError, match="more than 100000 parts"):
            cdr_read(data)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20  # nothing was made
        tracemalloc.stop()


def cdr_read(data: bytes) -> Any:
    return JointTrajectory.DEFINITION.deserialize(data)


def test_limits_that_are_none_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(limits.MAX_BYTES_VARIABLE, "std_msgs/msg/String:100")
    with pytest.raises(WireError, match="expected type=bytes"):
        limits.max_bytes("std_msgs/msg/String", "message")
    monkeypatch.setenv(limits.MAX_PARTS_VARIABLE, "many")
    with pytest.raises(WireError, match="expected a number"):
        limits.max_parts()


def test_a_flood_of_log_lines_is_cut_and_what_was_left_out_is_counted(
    monkeypatch: pytest.MonkeyPatch, lines: list[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(rcutils_logger, "_budget", rcutils_logger.Budget(lambda: now[0]))
    logger = rcutils_logger.RcutilsLogger("flooded")
    for number in range(5000):
        logger.info(f"line {number}")
    assert lines == [f"line {number}" for number in range(1000)]
    logger.fatal("the bus is gone")  # whatever happens
    assert lines[-1] == "the bus is gone (4000 other lines were left out before this one: too many at once)"
    now[0] += 1.0
    for _ in range(100):
        logger.info("later")
    assert lines[1001:] == ["later"] * 49  # fifty a second; the fatal line took one of them


def test_a_throttle_counts_what_it_holds_back_and_forgets_old_keys() -> None:
    now = [0.0]
    throttle = Throttle(5.0, lambda: now[0])
    assert throttle.admit("a") == 0
    assert [throttle.admit("a") for _ in range(3)] == [None] * 3
    assert throttle.admit("b") == 0
    now[0] = 5.0
    assert throttle.admit("a") == 3
    for number in range(1000):
        throttle.admit(number)
    assert len(throttle._keys) == 256
