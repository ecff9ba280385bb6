# SPDX-License-Identifier: Apache-2.0
"""Play a bag: publish its messages again, in recorded order and pace, with the QoS they were offered with."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import message_class
from softgrip_bag.nodes.qos import recorded
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.reader import RawMessage, TopicSummary, topic_summaries
from softgrip_time.units import to_ns, to_s

#: Topics that every node publishes by itself.
_NOT_PLAYED = {"/rosout", "/parameter_events"}
_CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
#: [Hz] looks at the time when nobody asked for /clock.
_POLL_RATE_HZ = 50.0
#: [s] no sleep is shorter.
_ARRIVED_S = 1e-6


class Pace:
    """The time of a bag that is played: faster or slower than the wall's, and standing while it is paused.

    Args:
        rate: bag seconds per wall second; 0 = as fast as possible.
        tick: told the position [s] at least every ``period`` while time passes, and at every position waited for.
        period: [s] of the wall.
        paused: stand until `toggle`.
    """

    def __init__(self, rate: float, tick: Callable[[float], None], period: float, *, paused: bool = False) -> None:
        self._rate = rate
        self._tick = tick
        self._period = period
        self._lock = threading.Lock()
        self._going = threading.Event()
        self._anchor = 0.0
        self._since = time.monotonic()
        if not paused:
            self._going.set()

    @property
    def paused(self) -> bool:
        """Whether the bag's time stands."""
        return not self._going.is_set()

    def toggle(self) -> None:
        """Pause, or go on."""
        with self._lock:
            if self._going.is_set():
                self._anchor = self._position()
                self._going.clear()
            else:
                self._since = time.monotonic()
                self._going.set()

    def wait_for(self, position: float) -> None:
        """Return when the bag's time has come to a position [s]; the first one starts it."""
        while True:
            while not self._going.wait(self._period):
                self._tick(self._anchor)
            with self._lock:
                rest = 0.0 if self._rate == 0.0 else (position - self._position()) / self._rate
            if rest <= _ARRIVED_S and not self.paused:
                self._tick(position)
                return
            self._tick(position - max(0.0, rest) * self._rate)
            time.sleep(max(0.0, min(rest, self._period)))

    def _position(self) -> float:
        return self._anchor + (time.monotonic() - self._since) * self._rate if self._going.is_set() else self._anchor


class Player(Node):
    """Publishes recorded bytes, unchanged, and the bag's time where that is asked for."""

    def __init__(self, topics: Sequence[TopicSummary], *, clock: bool = False) -> None:
        super().__init__("player")
        self._time_publisher = self.create_publisher(Clock, "/clock", _CLOCK_QOS) if clock else None
        self.not_played: dict[str, str] = {}
        self._outputs: dict[str, Any] = {}
        for topic in topics:
            try:
                cls = message_class(topic.type_name)
            except BagError as error:
                self.not_played[topic.name] = str(error)
                continue
            self._outputs[topic.name] = self.create_publisher(cls, topic.name, recorded(topic.qos))

    @property
    def topics(self) -> set[str]:
        """Topics that can be played."""
        return set(self._outputs)

    def wait_for_subscribers(self, seconds: float) -> None:
        """Wait until somebody listens to one of the topics, at most so long [s]."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not any(p.get_subscription_count() for p in self._outputs.values()):
            rclpy.spin_once(self, timeout_sec=0.02)

    def tell_time(self, nanoseconds: int) -> None:
        """Publish the bag's time, for nodes with use_sim_time."""
        if self._time_publisher is not None:
            self._time_publisher.publish(Clock(clock=Time(nanoseconds=nanoseconds).to_msg()))

    def play(self, message: RawMessage) -> None:
        """Publish one message."""
        self._outputs[message.topic].publish(bytes(message.data))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0 played, 2 the bag cannot be read."""
    parser = argparse.ArgumentParser(
        prog="ros2 bag play", description=__doc__, epilog="Remap topics with --ros-args -r /from:=/to."
    )
    parser.add_argument("bag", type=Path, help="folder of the bag, or one .mcap file")
    parser.add_argument("-r", "--rate", type=float, default=1.0, help="times real time; 0 = as fast as possible")
    parser.add_argument("--topics", nargs="+", help="only these")
    parser.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="leave out the first seconds")
    parser.add_argument("--wait", type=float, default=2.0, metavar="S", help="longest wait for a first listener")
    parser.add_argument("-p", "--start-paused", action="store_true", help="wait for Enter, which pauses and goes on")
    parser.add_argument(
        "--clock", type=float, nargs="?", const=40.0, default=0.0, metavar="HZ", help="publish the bag's time on /clock"
    )
    parser.add_argument("--step", action="store_true", help="one message per press of Enter")
    given = list(sys.argv[1:] if args is None else args)
    at = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser.parse_args(given[:at])
    if options.rate < 0:
        parser.error(f"--rate: expected 0 or more, found {options.rate}")
    if not 0 <= options.clock <= 1000:
        parser.error(f"--clock: expected 0 to 1000 Hz, found {options.clock}")
    try:
        topics = [t for t in topic_summaries(options.bag) if options.topics is None or t.name in options.topics]
        if not topics:
            raise BagError(f"{options.bag}: expected topics to play, found none of {options.topics or 'any'}")
        rclpy.init(args=given[at:])
        try:
            return _play(options, [topic for topic in topics if topic.name not in _NOT_PLAYED])
        finally:
            rclpy.try_shutdown()
    except BagError as error:
        print(error, file=sys.stderr)
        return 2


def _play(options: argparse.Namespace, topics: Sequence[TopicSummary]) -> int:
    player = Player(topics, clock=options.clock > 0)
    for name, why in player.not_played.items():
        print(f"{name} is not played: {why}", file=sys.stderr)
    player.wait_for_subscribers(options.wait)
    pace: Pace | None = None
    count = 0
    try:
        for message in RecordedBag(options.bag).read(player.topics - {"/clock"} if options.clock else player.topics):
            if pace is None:
                start = message.received + to_ns(options.start_offset)
                pace = _pace(options, player, start)
            position = to_s(message.received - start)
            if position < 0:
                continue
            if options.step:
                input(f"{position:10.3f} s  {message.topic}  [Enter] ")
                player.tell_time(message.received)
            else:
                pace.wait_for(position)
            player.play(message)
            count += 1
    except (KeyboardInterrupt, EOFError, ExternalShutdownException):
        pass
    player.destroy_node()
    print(f"{count} messages played")
    return 0


def _pace(options: argparse.Namespace, player: Player, start: int) -> Pace:
    """Return the bag's time from ``start`` [ns] on; at a terminal, Enter pauses it and lets it go on."""
    period = 1.0 / (options.clock or _POLL_RATE_HZ)
    pace = Pace(options.rate, lambda s: player.tell_time(start + to_ns(s)), period, paused=options.start_paused)
    if options.start_paused or (sys.stdin.isatty() and not options.step):
        print("Enter pauses and goes on", file=sys.stderr)
        threading.Thread(target=_listen, args=(pace,), name="keys", daemon=True).start()
    return pace


def _listen(pace: Pace) -> None:
    for _ in sys.stdin:
        pace.toggle()
        print("paused" if pace.paused else "playing", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
