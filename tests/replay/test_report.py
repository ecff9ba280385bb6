# SPDX-License-Identifier: Apache-2.0
"""The report on recorded bags: a page that needs nothing else, and the same figures as JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import report
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.trace import runs
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
