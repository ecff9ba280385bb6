# SPDX-License-Identifier: Apache-2.0
"""The report on recorded bags: a page that needs nothing else, and the same figures as JSON."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rclpy.serialization import deserialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import report
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.trace import runs
from softgrip_bag.plots import draw_joints
from softgrip_bag.reader import read
from softgrip_interfaces.msg import NodeTrace
from softgrip_testing.bag_excerpt import excerpt

BAGS = Path(__file__).resolve().parent / "bags"
TRACE = "/grasp_mix_manager/trace"


def figures(bag: str, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert report.main([str(BAGS / bag), "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_the_page_needs_nothing_else(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert report.main([str(BAGS / "closings"), "-o", str(page)]) == 0
    text = page.read_text()
    assert text.count("<svg") >= 1 + 3  # the timeline and a closing of each finger set
    assert not re.search(r"(?:src|href)=\"(?!#|data:)", text)
    for heading in ("Latency", "Friction", "Closings", "Grasps", "Faults", "Topics"):
        assert f"<h2>{heading}" in text


def test_latency_between_topics_is_in_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    links = {link["result"]: link for link in figures("closings", capsys)["latency"]}  # type: ignore[attr-defined]
    predicted = links["/finger/predicted"]
    assert predicted["source"] == "/tendon/state"
    assert predicted["matched"] > 1000
    p50, p95, p99 = predicted["from_publication_ms"]
    assert 0.0 < p50 <= p95 <= p99
    assert predicted["from_stamp_ms"][0] > p50
    frames = {link["result"]: link for link in figures("frames", capsys)["latency"]}  # type: ignore[attr-defined]
    assert frames["/finger/measured"]["source"] == "/camera/image_raw/compressed"


def test_grasps_faults_and_fits_are_in_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    grasps = figures("grasps", capsys)
    assert {grasp["outcome"] for grasp in grasps["grasps"]} >= {"GRIPPED", "SLIPPED", "TENDON_FAULT"}  # type: ignore[attr-defined]
    assert any(fault["source"] == "tendon/status" for fault in grasps["faults"])  # type: ignore[attr-defined]
    fit = figures("calibration", capsys)["friction"][-1]  # type: ignore[index]
    assert fit["points"] == 9
    assert 0.0 < fit["average_error_pct"] < 10.0


def test_a_bag_that_began_long_after_the_manager_has_the_grasps_that_it_saw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # as a recorder gives it that was started in the middle of a grasp
    batches = list(read(BAGS / "grasps", {TRACE}))
    traced = [deserialize_message(one.data, NodeTrace).steps for one in RecordedBag(BAGS / "grasps").read({TRACE})]
    ordered = [k for k, steps in enumerate(traced) if any(step.name == "goal /cell/grasp" for step in steps)]
    excerpt(BAGS / "grasps", tmp_path / "late", instead={TRACE: batches[ordered[2] + 1 :]})
    every = grasps_of(BAGS / "grasps", capsys)
    late = grasps_of(tmp_path / "late", capsys)
    assert len(late) == len(ordered) - 2
    assert late[0] == every[-len(late)] | {"product": ""}
    assert late[1:] == every[-len(late) + 1 :]
    with pytest.raises(BagError, match="too long after"):
        list(runs(RecordedBag(tmp_path / "late"), TRACE))
    # without the batch after the third order
    excerpt(BAGS / "grasps", tmp_path / "gap", instead={TRACE: batches[: ordered[2] + 1] + batches[ordered[2] + 2 :]})
    assert grasps_of(tmp_path / "gap", capsys) == [*every[: -len(late)], *late]
    with pytest.raises(BagError, match="messages are missing"):
        list(runs(RecordedBag(tmp_path / "gap"), TRACE))


def grasps_of(bag: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return figures(str(bag), capsys)["grasps"]  # type: ignore[return-value]


#: When the index finger was wound in from open, read off tendon/state by eye [s after the first cell/state].
#: Homings, openings, grasps and the tendon that is broken at the end lie outside.
CLOSINGS_S = {"hook": ((17.4, 20.3), (22.25, 23.97)), "power": ((41.2, 43.3), (44.7, 46.38))}
TOGETHER_S = 0.02  # nothing is read into a gap of the predictions
LENGTH_M = 0.095  # of the shipped index fingers, from the first joint to the tip


@pytest.mark.parametrize("finger_set", CLOSINGS_S)
def test_tip_errors_are_those_of_free_closings(finger_set: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As rosbags reads the bag: the distance of two tips over the finger's length."""
    said = {one["profile"]: one for one in figures("closings", capsys)["closings"]}[finger_set]  # type: ignore[attr-defined]
    seen, predicted = tips("/finger/measured", finger_set), tips("/finger/predicted", finger_set)
    times, (x, y) = [one[0] for one in predicted], zip(*(one[1] for one in predicted), strict=True)
    errors = [
        100.0 * math.dist(tip, (np.interp(time, times, x), np.interp(time, times, y))) / LENGTH_M
        for since, until in CLOSINGS_S[finger_set]
        for time, tip in seen
        if since <= time <= until and min(abs(time - other) for other in times) < TOGETHER_S
    ]
    assert said["runs"] == len(CLOSINGS_S[finger_set])
    assert said["frames"] == pytest.approx(len(errors), abs=3)  # those at rest
    assert said["tip_error_pct_mean"] == pytest.approx(sum(errors) / len(errors), abs=0.1)
    assert said["tip_error_pct_max"] == pytest.approx(max(errors), abs=0.2)


def test_the_tutorial_says_what_the_report_says(capsys: pytest.CaptureFixture[str]) -> None:
    tutorial = (BAGS.parents[2] / "docs/tutorials/close-a-finger.md").read_text()
    for one in figures("closings", capsys)["closings"]:  # type: ignore[attr-defined]
        row = f"| {one['profile']} | {one['tip_error_pct_mean']:.1f} % | {one['tip_error_pct_max']:.1f} % |"
        assert row in tutorial


def tips(topic: str, profile: str) -> list[tuple[float, tuple[float, float]]]:
    """Return time [s after the first cell/state] and tip [m] of the index finger, message by message."""
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader  # noqa: PLC0415  as above

    found = []
    with AnyReader([BAGS / "closings"]) as reader:
        connections = {one.topic: one for one in reader.connections}
        states = reader.messages([connections["/cell/state"]])
        first = seconds(next(reader.deserialize(data, kind.msgtype) for kind, _, data in states))
        for kind, _, data in reader.messages([connections[topic]]):
            message = reader.deserialize(data, kind.msgtype)
            found += [
                (seconds(message) - first, (finger.tip.x, finger.tip.y))
                for finger in message.fingers
                if (finger.profile, finger.finger) == (profile, "index")
            ]
    return found


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def test_joint_angles_are_drawn_beside_the_path_of_the_tip(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert report.main([str(BAGS / "closings"), "-o", str(page)]) == 0
    text = page.read_text()
    figures_of_closings = text[text.index("<h2>Closings") : text.index("<h2>Grasps")].count("<svg")
    assert figures_of_closings == 3
    for words in ("percent of the finger's length", "Free closings alone"):
        assert words in " ".join(text.split())


def test_a_figure_has_every_joint_as_dots_and_as_a_line() -> None:
    for closing in digest(BAGS / "closings").closings:
        assert closing.measured_angles.shape == closing.predicted_angles.shape == (len(closing.pulled), 3)
        axes = Figure().subplots()
        draw_joints(axes, closing.pulled, closing.measured_angles, closing.predicted_angles)
        dots, lines = axes.lines[::2], axes.lines[1::2]
        assert [line.get_label() for line in lines] == ["J0", "J1", "J2"]
        for joint, (dot, line) in enumerate(zip(dots, lines, strict=True)):
            assert (dot.get_marker(), line.get_linestyle()) == (".", "-")
            assert dot.get_ydata() == pytest.approx([math.degrees(row[joint]) for row in closing.measured_angles])
            assert line.get_xdata() == pytest.approx([1e3 * pulled for pulled in closing.pulled])
