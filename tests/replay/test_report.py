# SPDX-License-Identifier: Apache-2.0
"""The report on recorded bags: a page that needs nothing else, and the same figures as JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from softgrip_bag.nodes.commands import report

BAGS = Path(__file__).resolve().parent / "bags"


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
