# SPDX-License-Identifier: Apache-2.0
"""Demonstrations of a bag become episodes, as they were commanded and judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softgrip_bag.nodes.commands import export
from softgrip_bag.nodes.messages import interface_text
from softgrip_bag.nodes.recorded_episodes import recorded_episodes
from softgrip_bag.offers import OfferedQos
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.msg import NodeTrace, TeleoperationState, TraceStep
from softgrip_nodekit import to_time_message

pytest.importorskip("pyarrow")
from pyarrow import parquet

TENDONS = ["index", "thumb"]
START_NS = 1_000_000_000
#: 30 Hz, and the driver's 100 Hz.
FRAME_NS, STATE_NS = 33_333_333, 10_000_000
IDLE, RUNNING = TeleoperationState.IDLE, TeleoperationState.RUNNING


def shown(number: int, episode: int, phase: int, target_m: float, duration_s: float) -> TeleoperationState:
    """A frame; the thumb goes half as far as the index."""
    return TeleoperationState(
        header=Header(stamp=to_time_message(START_NS + number * FRAME_NS)),
        episode=episode,
        phase=phase,
        task="close slowly",
        is_held=phase == RUNNING,
        has_hand=True,
        tendons=TENDONS,
        deflections=[0.0, 0.0],
        targets=[target_m, target_m / 2],
        duration=duration_s,
        tension_limit=15.0,
    )


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two frames of nothing, ten of a demonstration and its verdict, two more of one that the bag's end cuts off."""
    made = BagWriter(tmp_path / "demonstration")
    kinds = {
        "/tendon/state": "sensor_msgs/msg/JointState",
        "/teleoperation/state": "softgrip_interfaces/msg/TeleoperationState",
        "/grasp_mix_manager/trace": "softgrip_interfaces/msg/NodeTrace",
    }
    for topic, kind in kinds.items():
        made.add_topic(Topic(topic, kind, "", schema_text(kind, interface_text), (OfferedQos(),)))
    frames = [shown(0, 0, IDLE, 0.0, 0.0), shown(1, 0, IDLE, 0.0, 0.0)]
    frames += [shown(2 + k, 1, RUNNING, 0.001 * (k + 1), 0.05) for k in range(10)]
    frames += [shown(12, 1, TeleoperationState.SUCCEEDED, 0.010, 0.0)]
    frames += [shown(13 + k, 2, RUNNING, 0.010, 0.05) for k in range(2)]
    for number, frame in enumerate(frames):
        stamp = START_NS + number * FRAME_NS
        made.write("/teleoperation/state", stamp, stamp, serialize_message(frame))
    for number in range(50):
        stamp = START_NS + number * STATE_NS
        state = JointState(
            header=Header(stamp=to_time_message(stamp)), name=TENDONS, position=[0.002, 0.001], effort=[3.0, 1.0]
        )
        made.write("/tendon/state", stamp, stamp, serialize_message(state))
    # `--record` begins a bag when the manager has been at work for long
    late = NodeTrace(first=469, steps=[TraceStep(name="topic /tendon/status")])
    made.write("/grasp_mix_manager/trace", START_NS, START_NS, serialize_message(late))
    return made.close()


def test_each_demonstration_is_an_episode(bag: Path) -> None:
    judged, cut_off = recorded_episodes(bag, 30)
    assert (judged.task, judged.outcome, judged.is_success) == ("close slowly", "SUCCEEDED", True)
    assert (cut_off.outcome, cut_off.is_success) == ("ABORTED", False)
    assert "the bag ends" in cut_off.reason
    assert judged.tendons == tuple(TENDONS)
    # from the first state at or after its first frame to the frame of the verdict
    assert judged.times_ns[0] == START_NS + 7 * STATE_NS
    assert judged.times_ns[-1] <= START_NS + 12 * FRAME_NS
    assert np.all(np.diff(judged.times_ns) == round(1e9 / 30))


def test_the_action_is_what_was_ordered(bag: Path) -> None:
    episode = recorded_episodes(bag, 30)[0]
    # by hand: 0.1 s after the first order (to 1 mm) the fourth, to 4 mm, is on its way: from the measured 2 mm, 1 mm in
    # 50 ms, so 20 mm/s; it came at frame 5
    time_ns = int(episode.times_ns[3])
    order_ns = START_NS + 5 * FRAME_NS
    assert 0 < time_ns - order_ns < FRAME_NS
    expected = 0.002 + 0.020 * 1e-9 * (time_ns - order_ns)
    assert episode.commanded_lengths_m[3, 0] == pytest.approx(expected, abs=1e-9)
    assert episode.commanded_tensions_n[3].tolist() == [15.0, 15.0]


def test_export_writes_both(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export.main(["--lerobot", str(tmp_path / "out"), "--fps", "30", str(bag)]) == 0
    assert "2 episodes, 1 of them a success" in capsys.readouterr().out
    rows = parquet.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["tasks"], row["softgrip/outcome"]) for row in rows] == [
        (["close slowly"], "SUCCEEDED"), (["close slowly"], "ABORTED"),
    ]  # fmt: skip
    frames = parquet.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pylist()
    assert sum(frame["next.reward"] for frame in frames) == 1.0
