# SPDX-License-Identifier: Apache-2.0
"""The verbs of ``ros2 topic`` that send and receive: echo, hz, bw, pub."""

from __future__ import annotations

import argparse
import math
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from embedded_ros.commands import common

if TYPE_CHECKING:
    from rclpy.subscription import MessageInfo

_WAIT_STEP_S = 0.1


def _add_qos(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--qos-profile", default=default, help=f"preset to start from (default: {default})")
    parser.add_argument("--qos-depth", type=int, metavar="N", help="queue size")
    parser.add_argument("--qos-history", choices=["keep_last", "keep_all", "system_default"], help="history")
    parser.add_argument(
        "--qos-reliability", choices=["reliable", "best_effort", "best_available", "system_default"], help="reliability"
    )
    parser.add_argument(
        "--qos-durability",
        choices=["transient_local", "volatile", "best_available", "system_default"],
        help="durability",
    )


def _qos(arguments: argparse.Namespace) -> tuple[Any, bool]:
    """Return the profile and whether any of its policies was asked for."""
    from rclpy import qos  # noqa: PLC0415  verbs on the graph start without it

    profile = qos.QoSPresetProfiles.get_from_short_key(arguments.qos_profile)._copy()
    asked = False
    for policy, kind in (
        ("history", qos.HistoryPolicy),
        ("reliability", qos.ReliabilityPolicy),
        ("durability", qos.DurabilityPolicy),
    ):
        word = getattr(arguments, f"qos_{policy}")
        if word:
            setattr(profile, policy, kind.get_from_short_key(word))
            asked = True
    if arguments.qos_depth is not None:
        profile.depth = arguments.qos_depth
        asked = True
    return profile, asked


def _adapted(node: Any, topic: str, profile: Any) -> Any:
    """Return a profile that all publishers there match, as ros2cli picks it."""
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # noqa: PLC0415  as above

    infos = node.get_publishers_info_by_topic(topic)
    if infos and all(info.qos_profile.reliability is ReliabilityPolicy.RELIABLE for info in infos):
        profile.reliability = ReliabilityPolicy.RELIABLE
    else:
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if infos and all(info.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for info in infos):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return profile


def _message_class(node: Any, topic: str, given: str | None, *, wait: bool) -> Any:
    from embedded_ros.registry import registry  # noqa: PLC0415  as above

    if given:
        return registry().interface(given)
    while True:
        for name, types in node.get_topic_names_and_types():
            if name == topic:
                return registry().interface(types[0])
        if not wait:
            return None
        node.context._graph.wait(lambda: any(name == topic for name, _ in node.get_topic_names_and_types()), 1.0)


def add_echo(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``ros2 topic echo``."""
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument("message_type", nargs="?", help="type, such as std_msgs/msg/String (found out when not given)")
    _add_qos(parser, "sensor_data")
    parser.add_argument("--csv", action="store_true", help="all fields in one line, separated by commas")
    parser.add_argument("--field", help="show only this field, such as header.stamp")
    parser.add_argument("-f", "--full-length", action="store_true", help="do not cut long arrays and text")
    parser.add_argument("-l", "--truncate-length", type=int, default=128, help="length at which to cut (default: 128)")
    parser.add_argument("--no-arr", action="store_true", help="do not print array fields")
    parser.add_argument("--no-str", action="store_true", help="do not print string fields")
    parser.add_argument("--flow-style", action="store_true", help="collections in one line")
    parser.add_argument("--no-lost-messages", action="store_true", help="do not report when a message is lost")
    parser.add_argument("--raw", action="store_true", help="echo the raw binary representation")
    parser.add_argument(
        "--filter", dest="filter_expr", help="Python expression on m, the message, that says what to print"
    )
    parser.add_argument("-i", "--include-message-info", action="store_true", help="show the message's info as well")
    parser.add_argument("--once", action="store_true", help="print the first message received and then exit")
    parser.add_argument("--timeout", type=float, metavar="N", help="stop after so many seconds without a first message")
    parser.set_defaults(function=_echo)


def _echo(arguments: argparse.Namespace) -> str | None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it

    with common.node("echo", host=True) as node:
        topic = node.resolve_topic_name(arguments.topic_name)
        kind = _message_class(node, topic, arguments.message_type, wait=False)
        if kind is None:
            print(f"WARNING: topic [{topic}] does not appear to be published yet")
            return "Could not determine the type for the passed topic"
        profile, asked = _qos(arguments)
        if not asked:
            profile = _adapted(node, topic, profile)
        future: rclpy.Future[None] = rclpy.Future()

        def show(message: Any, info: MessageInfo) -> None:
            text = _shown(message, arguments)
            if text is not None and not future.done():
                if arguments.include_message_info:
                    print(_info_text(info, arguments), end="")
                print(text, end="", flush=True)
                if arguments.once:
                    future.set_result(None)

        events = None
        if not arguments.no_lost_messages:
            from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: PLC0415  as above

            events = SubscriptionEventCallbacks(
                message_lost=lambda lost: print(
                    f"A message was lost!!!\n\ttotal count change:{lost.total_count_change}\n\t"
                    f"total count: {lost.total_count}---"
                )
            )
        node.create_subscription(kind, topic, show, profile, raw=arguments.raw, event_callbacks=events)
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.timeout)
    return None


def _shown(message: Any, arguments: argparse.Namespace) -> str | None:
    from embedded_ros.text_form import FieldError, to_plain, to_yaml  # noqa: PLC0415  verbs on the graph start without it

    for part in (arguments.field or "").split("."):
        try:
            message = getattr(message, part) if part else message
        except AttributeError as error:
            raise FieldError(f"Invalid field '{arguments.field}': {error}") from error
    if arguments.filter_expr and not eval(arguments.filter_expr, {"m": message}):  # noqa: S307  what --filter is for
        return None
    if arguments.raw:
        return f"{message!r}\n---\n"
    limit = None if arguments.full_length else arguments.truncate_length
    if arguments.csv:
        if not hasattr(type(message), "DEFINITION"):
            return f"{message}\n---\n"
        return _csv(to_plain(message, limit, arrays=not arguments.no_arr, strings=not arguments.no_str)) + "\n"
    text = to_yaml(message, limit, arrays=not arguments.no_arr, strings=not arguments.no_str, flow=arguments.flow_style)
    return text + "---\n"


def _info_text(info: MessageInfo, arguments: argparse.Namespace) -> str:
    import yaml  # noqa: PLC0415  as above

    if arguments.csv:
        return ",".join(str(value) for value in info.values()) + ","
    if arguments.raw:
        return f"---Got new message, message info:---\n{info}\n---Message data:---\n"
    return f"{yaml.dump(info)}---\n"


def _csv(value: Any) -> str:
    """Return all values separated by commas, as ros2cli does it: nothing stands for an empty list."""
    if not isinstance(value, dict | list):
        return str(value)
    text = ""
    for item in value.values() if isinstance(value, dict) else value:
        text += "," if text else ""
        text += _csv(item)
    return text


def add_hz(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``ros2 topic hz``."""
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument(
        "-w", "--window", type=int, default=10000, help="number of messages to average over (default: 10000)"
    )
    parser.add_argument(
        "--filter", dest="filter_expr", help="only messages for which this Python expression on m is true"
    )
    parser.set_defaults(function=_hz)


def _hz(arguments: argparse.Namespace) -> None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it
    from rclpy.qos import qos_profile_sensor_data  # noqa: PLC0415  as above

    with common.node("hz", host=True) as node:
        topic = node.resolve_topic_name(arguments.topic_name)
        kind = _message_class(node, topic, None, wait=True)
        intervals: deque[float] = deque(maxlen=arguments.window)
        last: list[float] = []

        def arrived(message: Any) -> None:
            if arguments.filter_expr and not eval(arguments.filter_expr, {"m": message}):  # noqa: S307  see --filter
                return
            now = time.monotonic()
            if last:
                intervals.append(now - last[0])
            last[:] = [now]

        node.create_subscription(kind, topic, arrived, qos_profile_sensor_data, raw=not arguments.filter_expr)
        shown = time.monotonic()
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=1.0)
            if intervals and last[0] >= shown + 1.0:
                shown = last[0]
                print(_rate(intervals), flush=True)


def _rate(intervals: deque[float]) -> str:
    count = len(intervals)
    mean = sum(intervals) / count
    deviation = math.sqrt(sum((item - mean) ** 2 for item in intervals) / count)
    return (
        f"average rate: {1.0 / mean if mean > 0 else 0.0:.3f}\n\tmin: {min(intervals):.3f}s max: {max(intervals):.3f}s "
        f"std dev: {deviation:.5f}s window: {count}"
    )


def add_bw(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``ros2 topic bw``."""
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument(
        "-w", "--window", type=int, default=100, help="number of messages to average over (default: 100)"
    )
    parser.set_defaults(function=_bw)


def _bw(arguments: argparse.Namespace) -> None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it
    from rclpy.qos import qos_profile_sensor_data  # noqa: PLC0415  as above

    with common.node("bw", host=True) as node:
        topic = node.resolve_topic_name(arguments.topic_name)
        kind = _message_class(node, topic, None, wait=True)
        sizes: deque[tuple[float, int]] = deque(maxlen=arguments.window)
        node.create_subscription(
            kind, topic, lambda data: sizes.append((time.monotonic(), len(data))), qos_profile_sensor_data, raw=True
        )
        print(f"Subscribed to [{topic}]")
        shown = time.monotonic()
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=1.0)
            now = time.monotonic()
            if len(sizes) > 1 and now >= shown + 1.0:
                shown = now
                total = sum(size for _, size in sizes)
                rate = total / (now - sizes[0][0])
                low, high = min(size for _, size in sizes), max(size for _, size in sizes)
                print(f"{_bytes(rate)}/s from {len(sizes)} messages\n\tMessage size mean: {_bytes(total / len(sizes))} "
                      f"min: {_bytes(low)} max: {_bytes(high)}", flush=True)  # fmt: skip


def _bytes(value: float) -> str:
    for unit, size in (("MB", 1e6), ("KB", 1e3)):
        if value >= size:
            return f"{value / size:.2f} {unit}"
    return f"{value:.0f} B"


def add_pub(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``ros2 topic pub``."""
    parser.add_argument("topic_name", help="name of the topic")
    parser.add_argument("message_type", help="type, such as std_msgs/msg/String")
    parser.add_argument("values", nargs="?", default="{}", help="fields as a YAML dictionary, such as '{data: hello}'")
    parser.add_argument("-r", "--rate", type=float, default=1.0, metavar="N", help="publishing rate in Hz (default: 1)")
    parser.add_argument(
        "-p", "--print", type=int, default=1, metavar="N", help="only print every N-th message (0: none)"
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument("-1", "--once", action="store_true", help="publish one message and exit")
    group.add_argument(
        "-t", "--times", type=int, default=0, metavar="N", help="publish this number of times and then exit"
    )
    parser.add_argument(
        "-w", "--wait-matching-subscriptions", type=int, metavar="N", help="wait for this many subscriptions"
    )
    parser.add_argument("--max-wait-time-secs", type=float, metavar="N", help="how long to wait for them")
    parser.add_argument(
        "--keep-alive", type=float, default=0.1, metavar="N", help="seconds to stay after the last message"
    )
    parser.add_argument("-n", "--node-name", help="name of the publishing node")
    _add_qos(parser, "default")
    parser.set_defaults(function=_pub)


def _pub(arguments: argparse.Namespace) -> str | None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it

    from embedded_ros.registry import registry  # noqa: PLC0415  as above
    from embedded_ros.text_form import fill, parse_values  # noqa: PLC0415  as above

    times = 1 if arguments.once else arguments.times
    kind = registry().interface(arguments.message_type)
    message = kind()
    stamps = fill(message, parse_values(arguments.values))
    with common.node("pub", host=True) as node:
        profile, _ = _qos(arguments)
        publisher = node.create_publisher(kind, arguments.topic_name, profile)
        requested = arguments.wait_matching_subscriptions
        problem = _wait_for_subscriptions(
            publisher, int(times != 0) if requested is None else requested, arguments.max_wait_time_secs
        )
        if problem:
            return problem
        print("publisher: beginning loop", flush=True)
        count = 0

        def publish() -> None:
            nonlocal count
            now = node.get_clock().now().to_msg()
            for stamp in stamps:
                stamp(now)
            count += 1
            if arguments.print and count % arguments.print == 0:
                print(f"publishing #{count}: {message!r}\n", flush=True)
            publisher.publish(message)

        publish()
        if times != 1:
            node.create_timer(1.0 / arguments.rate, publish)
            while rclpy.ok() and (times == 0 or count < times):
                rclpy.spin_once(node, timeout_sec=1.0)
        time.sleep(arguments.keep_alive)
    return None


def _wait_for_subscriptions(publisher: Any, requested: int, limit_s: float | None) -> str | None:
    waited_s = 0.0
    step = 0
    while publisher.get_subscription_count() < requested:
        if step % 10 == 0:
            print(f"Waiting for at least {requested} matching subscription(s)...", flush=True)
        if limit_s is not None and waited_s >= limit_s:
            return (
                f"Timed out waiting for subscribers: Expected {requested} subcribers but only got "
                f"{publisher.get_subscription_count()} subscribers"
            )
        step += 1
        publisher._node.context._graph.wait(lambda: publisher.get_subscription_count() >= requested, _WAIT_STEP_S)
        waited_s += _WAIT_STEP_S
    return None
