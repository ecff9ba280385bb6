# SPDX-License-Identifier: Apache-2.0
"""A latched message reached a node earlier than the recorder: its results say so, and a replay follows them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import rclpy
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.context import restore
from softgrip_bag.excerpt import excerpt
from softgrip_bag.nodes.captured import ReplayedNode
from softgrip_bag.nodes.through import NODES, check
from softgrip_bag.reader import RawMessage, read
from softgrip_interfaces.msg import CellState, FingerMarkers, MountedFinger

FRAMES = Path(__file__).resolve().parent / "bags" / "frames"
CAMERA, CELL = "/camera/image_raw/compressed", "/cell/state"
RESULTS = ("/finger/markers", "/finger/measured")
LATE = 20_000_000  # [ns] that the recorder got the news after the frame that was measured with it


@contextmanager
def tracker(folder: Path) -> Iterator[ReplayedNode]:
    rclpy.init(args=["--ros-args", "--log-level", "error", *restore(FRAMES, "/marker_tracker", folder)])
    node = ReplayedNode(NODES["marker_tracker"].class_path)
    try:
        yield node
    finally:
        node.close()
        rclpy.try_shutdown()


def test_frames_that_were_measured_with_news_that_the_recorder_got_later(tmp_path: Path) -> None:
    """The tracker hears of the pinch fingers before the eighth frame, the recorder after it."""
    frames = list(read(FRAMES, {CAMERA}))
    (told,) = read(FRAMES, {CELL})
    mounted = CellState(mounted=[MountedFinger(finger="index", profile="pinch", state=MountedFinger.VERIFIED)])
    news = replace(told, received=frames[7].received + LATE, data=bytes(serialize_message(mounted)))
    results: dict[str, list[RawMessage]] = {topic: [] for topic in RESULTS}
    types = {raw.topic: raw.type_name for raw in read(FRAMES, set(RESULTS))}
    with tracker(tmp_path) as node:
        for number, frame in enumerate(frames):
            if number == 7:
                node.feed(news)
            for topic, output in node.feed(frame):
                if topic in RESULTS:
                    received = frame.received + 2 * LATE
                    results[topic].append(
                        RawMessage(topic, types[topic], received, received, bytes(serialize_message(output)))
                    )
    markers = [deserialize_message(raw.data, FingerMarkers) for raw in results["/finger/markers"]]
    configurations = [message.configuration for message in markers]
    assert len(set(configurations[:7])) == len(set(configurations[7:])) == 1
    assert configurations[6] != configurations[7]
    excerpt(FRAMES, tmp_path / "bag", instead={**results, CELL: [news]})
    found = check(tmp_path / "bag", "marker_tracker")
    assert found.divergence is None, str(found.divergence)
    assert found.compared == sum(len(raws) for raws in results.values())
