# SPDX-License-Identifier: Apache-2.0
"""A latched message reached a node earlier than the recorder: its results say so, and a replay follows them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import rclpy
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.context import restore
from softgrip_bag.nodes.messages import interface_text
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replay import NODES, check
from softgrip_bag.nodes.replayed_node import ReplayedNode
from softgrip_bag.reader import RawMessage
from softgrip_interfaces.msg import CellState, FingerMarkers, MountedFinger
from softgrip_testing.bag_excerpt import excerpt
from softgrip_testing.scripts import load_script

FRAMES = Path(__file__).resolve().parent / "bags" / "frames"
CLOSINGS = FRAMES.parent / "closings"
tolerance = load_script(Path(__file__).with_name("rounding.py")).tolerance
CAMERA, CELL = "/camera/image_raw/compressed", "/cell/state"
RESULTS = ("/finger/markers", "/finger/measured")
LATE = 20_000_000  # [ns] that the recorder got the news after the frame that was measured with it


@contextmanager
def tracker(folder: Path) -> Iterator[ReplayedNode]:
    rclpy.init(args=["--ros-args", "--log-level", "error", *restore(FRAMES, "/marker_tracker", folder).arguments])
    node = ReplayedNode(NODES["marker_tracker"].class_path)
    try:
        yield node
    finally:
        node.close()
        rclpy.try_shutdown()


#: Who sits in the index slot; nobody changes nothing, so what was told before goes on being so.
PINCH, POWER, NOBODY = "pinch", "power", ""


@pytest.mark.parametrize(
    ("reported", "lag"),
    [
        ([(7, PINCH, LATE)], 0),
        ([(2, PINCH, -LATE), (4, NOBODY, -LATE), (7, POWER, LATE)], 0),
        ([(2, PINCH, LATE), (3, POWER, LATE), (7, NOBODY, LATE), (8, PINCH, LATE)], 0),
        # frames come to the recorder a second after they were taken, news at once
        ([(2, PINCH, LATE), (5, POWER, LATE), (6, PINCH, LATE)], 1_000_000_000),
    ],
)
def test_frames_that_were_measured_with_news_that_the_recorder_got_later(
    reported: list[tuple[int, str, int]], lag: int, tmp_path: Path
) -> None:
    """The tracker hears before a frame what sits in the slot, the recorder some time after (or before) that frame."""
    frames = list(RecordedBag(FRAMES).read({CAMERA}))
    (like,) = RecordedBag(FRAMES).read({CELL})
    news = {number: cell_state(like, profile, frames[number].received + late) for number, profile, late in reported}
    results: dict[str, list[RawMessage]] = {topic: [] for topic in RESULTS}
    types = {raw.topic: raw.type_name for raw in RecordedBag(FRAMES).read(set(RESULTS))}
    with tracker(tmp_path) as node:
        for number, frame in enumerate(frames):
            if number in news:
                node.feed(news[number])
            for output in node.feed(frame):
                if (topic := output.topic) in RESULTS:
                    received = frame.received + 2 * LATE
                    results[topic].append(RawMessage(topic, types[topic], received, received, output.data))
    configurations = [deserialize_message(raw.data, FingerMarkers).configuration for raw in results["/finger/markers"]]
    for number, profile, _ in reported:
        assert (configurations[number] == configurations[number - 1]) is (profile is NOBODY)
    late = [replace(frame, received=frame.received + lag) for frame in frames]
    excerpt(FRAMES, tmp_path / "bag", instead={**results, CAMERA: late, CELL: list(news.values())}, find=interface_text)
    found = check(tmp_path / "bag", "marker_tracker")
    assert found.divergence is None, str(found.divergence)
    assert found.compared == sum(len(raws) for raws in results.values())


@pytest.mark.parametrize("unheard", [1, 4])
def test_a_node_that_answered_before_the_recorder_found_its_topic(unheard: int, tmp_path: Path) -> None:
    """The tracker remembers what it saw: that it had seen earlier frames shows in its first recorded answer."""
    results = {topic: list(RecordedBag(FRAMES).read({topic}))[unheard:] for topic in RESULTS}
    excerpt(FRAMES, tmp_path / "bag", instead=results, find=interface_text)
    found = check(tmp_path / "bag", "marker_tracker", tolerance=tolerance("frames"))
    assert found.divergence is None, str(found.divergence)
    assert found.compared == sum(len(raws) for raws in results.values())


def test_a_recorder_that_took_one_topic_seconds_after_the_others(tmp_path: Path) -> None:
    """The predictor keeps tendon samples for 2 s: fed as they were received, the frames would meet none."""
    late = [
        replace(raw, received=raw.received + 5_000_000_000) for raw in RecordedBag(CLOSINGS).read({"/finger/measured"})
    ]
    excerpt(CLOSINGS, tmp_path / "bag", instead={"/finger/measured": late}, find=interface_text)
    found, as_it_was = (
        check(bag, "kinematics_predictor", tolerance=tolerance("closings")) for bag in (tmp_path / "bag", CLOSINGS)
    )
    assert found.divergence is None, str(found.divergence)
    assert found.compared == as_it_was.compared


def cell_state(like: RawMessage, profile: str, received: int) -> RawMessage:
    state = MountedFinger.VERIFIED if profile else MountedFinger.UNKNOWN
    message = CellState(mounted=[MountedFinger(finger="index", profile=profile, state=state)])
    return replace(like, received=received, published=received, data=bytes(serialize_message(message)))
