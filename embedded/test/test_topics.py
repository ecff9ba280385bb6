# SPDX-License-Identifier: Apache-2.0
"""Topics between nodes of one process: what is delivered, what is refused, and the QoS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, String

from embedded_ros import wire

Make = Callable[..., Node]
Spin = Callable[..., bool]


def test_topic_with_message_info_and_raw(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    plain: list[str] = []
    infos: list[dict[str, Any]] = []
    raw: list[bytes] = []
    node.create_subscription(String, "t", lambda m: plain.append(m.data), 10)
    node.create_subscription(String, "t", lambda _, info: infos.append(info), 10)
    node.create_subscription(String, "t", raw.append, 10, raw=True)
    publisher = node.create_publisher(String, "t", 10)
    assert publisher.get_subscription_count() == 3
    before = time.time_ns()
    publisher.publish(String(data="a"))
    publisher.publish(String(data="b"))
    assert spin_until(lambda: len(plain) == 2 and len(infos) == 2 and len(raw) == 2, node)
    assert plain == ["a", "b"]
    assert raw[0] == bytes.fromhex("00010000" + "02000000" + "6100")
    assert before <= infos[0]["source_timestamp"] <= infos[0]["received_timestamp"] <= time.time_ns()
    assert [info["publication_sequence_number"] for info in infos] == [1, 2]


def test_threads_that_publish_at_once_number_every_message_once(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    count, threads = 300, 4
    numbers: list[int] = []
    node.create_subscription(
        String, "t", lambda _, info: numbers.append(info["publication_sequence_number"]), count * threads
    )
    publisher = node.create_publisher(String, "t", count * threads)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        workers = [threading.Thread(target=_publish, args=(publisher, count)) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        sys.setswitchinterval(interval)
    assert spin_until(lambda: len(numbers) == count * threads, node)
    assert sorted(numbers) == list(range(1, count * threads + 1))


def test_a_flood_arrives_whole_and_in_order(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    count = 5000
    numbers: list[float] = []
    everything = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    node.create_subscription(Float64, "t", lambda m: numbers.append(m.data), everything)
    publisher = node.create_publisher(Float64, "t", everything)

    def flood() -> None:
        for number in range(count):
            publisher.publish(Float64(data=float(number)))

    worker = threading.Thread(target=flood)
    worker.start()
    assert spin_until(lambda: len(numbers) >= count, node)
    worker.join()
    assert numbers == [float(number) for number in range(count)]
    publisher.publish(Float64(data=-1.0))
    assert spin_until(lambda: len(numbers) > count, node)


def _publish(publisher: Any, count: int) -> None:
    for _ in range(count):
        publisher.publish(String())


def test_a_second_argument_with_a_default_is_no_message_info(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    got: list[object] = []
    node.create_subscription(String, "t", lambda _, extra="default": got.append(extra), 10)
    node.create_publisher(String, "t", 10).publish(String())
    assert spin_until(lambda: got == ["default"], node)


def test_a_wrong_field_is_refused_where_it_is_published(make_node: Make) -> None:
    publisher = make_node("n").create_publisher(Float64, "t", 10)
    with pytest.raises(TypeError, match=r"Float64.data: expected float, found builtins.int 1"):
        publisher.publish(Float64(data=1))
    with pytest.raises(TypeError, match="Expected"):
        publisher.publish(String())


def test_a_full_queue_drops_the_oldest_and_says_so(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    heard: list[str] = []
    lost: list[int] = []
    events = SubscriptionEventCallbacks(message_lost=lambda event: lost.append(event.total_count))
    node.create_subscription(String, "t", lambda m: heard.append(m.data), 2, event_callbacks=events)
    publisher = node.create_publisher(String, "t", 10)
    for i in range(5):
        publisher.publish(String(data=str(i)))
    assert spin_until(lambda: len(heard) == 2 and bool(lost), node)
    assert heard == ["3", "4"]
    assert spin_until(lambda: lost[-1] == 3, node)


def test_a_latched_value_reaches_who_comes_late(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "t", latched).publish(String(data="kept"))
    heard: list[str] = []
    node.create_subscription(String, "t", lambda m: heard.append(m.data), latched)
    assert spin_until(lambda: heard == ["kept"], node)


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT), QoSProfile(depth=5), "RELIABILITY"),
        (QoSProfile(depth=5), QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL), "DURABILITY"),
    ],
)
def test_incompatible_qos_delivers_nothing_and_names_the_policy(
    make_node: Make,
    spin_until: Spin,
    capfd: pytest.CaptureFixture[str],
    offered: QoSProfile,
    requested: QoSProfile,
    policy: str,
) -> None:
    node = make_node("n", namespace="/cell")
    heard: list[str] = []
    fine: list[str] = []
    node.create_subscription(String, "t", lambda m: heard.append(m.data), requested)
    node.create_subscription(String, "t", lambda m: fine.append(m.data), offered)
    publisher = node.create_publisher(String, "t", offered)
    assert publisher.get_subscription_count() == 1
    publisher.publish(String(data="x"))
    assert spin_until(lambda: fine == ["x"], node)
    spin_until(lambda: False, node, deadline_s=0.2)
    assert heard == []
    text = capfd.readouterr().err
    said = f"offering incompatible QoS. No messages will be received from it. Last incompatible policy: {policy}"
    assert text.count(f"New publisher discovered on topic 't', {said}") == 1


def test_threads_that_publish_at_once_do_so_in_the_order_of_their_numbers(
    make_node: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message that overtakes another makes a receiver count that other as lost."""
    publisher = make_node("n").create_publisher(String, "t", 10)
    put: list[int] = []
    begun = threading.Event()

    class Wire:
        def put(self, _payload: bytes, attachment: bytes) -> None:
            if not begun.is_set():
                begun.set()
                time.sleep(0.1)
            put.append(wire.decode_attachment(attachment)[0])

    monkeypatch.setattr(publisher, "_publisher", Wire())
    first = threading.Thread(target=publisher.publish, args=[String()])
    first.start()
    assert begun.wait(5.0)
    publisher.publish(String())
    first.join()
    assert put == [1, 2]
