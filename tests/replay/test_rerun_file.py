# SPDX-License-Identifier: Apache-2.0
"""A bag as a Rerun recording: the scene against the bag, the file against Rerun's own tool."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from softgrip_bag.nodes.commands import export
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.recorded_scene import recorded_scene
from softgrip_bag.scene import FingerBase, SceneEvent, finger_points

pytest.importorskip("mcap_ros2")
from mcap_ros2.decoder import DecoderFactory

BAGS = Path(__file__).resolve().parent / "bags"


def decoded(bag: str, topic: str) -> list:
    """Messages by a reader that is not ours."""
    with next((BAGS / bag).glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages(topics=[topic])]


def stamp(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_curves_are_the_bags_own_values() -> None:
    scene = recorded_scene(BAGS / "closings")
    states = decoded("closings", "/tendon/state")
    index = list(states[0].name).index("index")
    (tension,) = [curve for curve in scene.curves if curve.path == "tension/index"]
    assert tension.times_ns.tolist() == [stamp(state) for state in states]
    assert tension.values.tolist() == [state.effort[index] for state in states]
    (error,) = [curve for curve in scene.curves if curve.path == "tip_error/index"]
    residuals = [one for one in decoded("closings", "/finger/residual") if one.finger == "index"]
    assert error.values.tolist() == [one.tip_error_percent for one in residuals]


def test_poses_end_at_the_bags_tips_and_images_are_its_bytes() -> None:
    scene = recorded_scene(BAGS / "closings")
    tips = {
        stamp(message): (finger.tip.x, finger.tip.y)
        for message in decoded("closings", "/finger/measured")
        for finger in message.fingers
        if finger.finger == "index"
    }
    poses = scene.poses["measured", "index"]
    assert len(poses) > 100
    for pose in poses:
        assert tuple(pose.points_m[-1, :2]) == pytest.approx(tips[pose.time_ns], abs=1e-12)
    images = [bytes(one.data) for one in decoded("frames", "/camera/image_raw/compressed")]
    assert [data for _, data in recorded_scene(BAGS / "frames").images] == images


def test_a_finger_closes_towards_minus_y_of_its_base() -> None:
    # by hand: links of 2 and 1, a right angle at the second joint; the base stands upright, its x is the palm's z
    base = FingerBase(np.array([1.0, 2.0, 3.0]), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
    points = finger_points(base, [2.0, 1.0], [0.0, np.pi / 2], (2.0, -1.0))
    assert points == pytest.approx(np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 5.0], [0.0, 2.0, 5.0]]))


def test_events_are_the_storys() -> None:
    events = recorded_scene(BAGS / "grasps").events
    assert [event.time_ns for event in events] == sorted(event.time_ns for event in events)
    for grasp in digest(BAGS / "grasps").grasps:
        level = "INFO" if grasp.outcome == "GRIPPED" else "WARN"
        assert SceneEvent(grasp.time, level, f"{grasp.product}: {grasp.outcome}: {grasp.reason}") in events


def test_rerun_reads_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="make rerun-setup")
    out = tmp_path / "frames.rrd"
    assert export.main(["--rerun", str(out), str(BAGS / "frames")]) == 0
    assert "19 images" in capsys.readouterr().out
    tool = shutil.which("rerun", path=str(Path(sys.executable).parent))
    assert tool is not None
    answer = subprocess.run(
        [tool, "rrd", "print", "-v", str(out)], capture_output=True, text=True, timeout=60, check=True
    )
    for entity in ("/camera", "/hand/index/measured", "/verdicts"):
        assert entity in answer.stdout
    assert "EncodedImage" in answer.stdout
    assert export.main(["--rerun", str(out), str(BAGS / "frames")]) == 2
    assert "name another" in capsys.readouterr().err


def test_without_rerun_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert export.main(["--rerun", str(tmp_path / "x.rrd"), str(BAGS / "frames")]) == 2
    assert "make rerun-setup" in capsys.readouterr().err
