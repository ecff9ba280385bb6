# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_demo.alignment import Instant, MeasuredTip, at_stamp, pair
from softgrip_demo.film import chain
from softgrip_demo.record import (
    FrictionPoint,
    FrictionResult,
    GraspResult,
    PairedSample,
    RecordError,
    ShapeView,
    ShiftClosing,
    ShiftFrame,
    ShiftRecord,
    ShiftStage,
)
from softgrip_demo.report import figures, render
from softgrip_demo.summary import ReplayCheck, interval_held_percent, summarise, tip_errors_percent


def sample(pulled: float, off: float) -> PairedSample:
    angles, sure = (0.1, 0.2, 0.3), (0.0, 0.0)
    return PairedSample(pulled, angles, angles, (0.09, 0.0), (0.09, off), 1.0, 1.1, (0.001, 0.001), sure)


@pytest.fixture
def record() -> ShiftRecord:
    points = tuple(FrictionPoint(a, 2.0 * math.exp(0.3 * a), 2.0) for a in (0.2, 0.9, 1.5))
    shape = ShapeView(1, 30.0, True, 0.02, ((0.0, 0.0, 0.0),) * 4, ((0, 1, 2, 3),))
    return ShiftRecord(
        seed=3,
        friction=FrictionResult("id", "capstan", "printed", {"mu": 0.3}, 3.1, 0.01, 0.02, 0.99, "usable", points),
        closings=(ShiftClosing("power", 0.1, (sample(0.0, 0.001), sample(0.01, 0.003)), shape),),
        grasps=(
            GraspResult("egg", "power", "GRIPPED", "success", "held", 0.012),
            GraspResult("grape", "power", "GRIPPED", "failure", "held", math.nan),
        ),
        swaps=1,
        film_product="egg",
        film=(ShiftFrame("film/000.jpg", 0.0, ((1.0, 2.0), (3.0, 4.0)), 1.0, 0.9),),
        bag_path="bag",
        bag_messages=10,
        bag_topics=2,
        bag_dropped=0,
        stages=(ShiftStage("start", 1.5),),
    )


def test_a_record_comes_back_from_disk_as_it_was(record: ShiftRecord, tmp_path: Path) -> None:
    whole = replace(record, grasps=record.grasps[:1])
    whole.save(tmp_path / "shift.json")
    assert ShiftRecord.load(tmp_path / "shift.json") == whole


@pytest.mark.parametrize(("text", "found"), [("{", "expected JSON"), ('{"schema": 99}', "found 99")])
def test_a_record_of_another_kind_is_refused(text: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "shift.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=found):
        ShiftRecord.load(path)
    with pytest.raises(RecordError, match="found none"):
        ShiftRecord.load(tmp_path / "missing.json")


def test_tip_errors_are_percent_of_the_finger(record: ShiftRecord) -> None:
    assert tip_errors_percent(record.closings[0]).tolist() == pytest.approx([1.0, 3.0])


def test_the_interval_holds_a_share_of_the_coordinates(record: ShiftRecord) -> None:
    """Of x, y off by 0, 1 mm and by 0, 3 mm, the deviation of each 1 mm, three are within 1.96 mm."""
    assert interval_held_percent(record.closings[0]) == pytest.approx(75.0)
    camera = [
        replace(one, measured_tip_stddev=(0.0, 2e-3)) for one in record.closings[0].samples
    ]  # 1.96 sqrt(1 + 4) mm
    assert interval_held_percent(replace(record.closings[0], samples=tuple(camera))) == pytest.approx(100.0)
    silent = replace(record.closings[0].samples[0], predicted_tip_stddev=(math.nan, math.nan))
    assert math.isnan(interval_held_percent(replace(record.closings[0], samples=(silent,))))


def test_the_summary_is_json_without_nan_and_judges_by_table_4_2(record: ShiftRecord) -> None:
    summary = summarise(record, ReplayCheck("node", 5, identical=True, detail="", wall_clock_s=0.5), 0.1)
    text = json.dumps(summary, allow_nan=False)
    assert json.loads(text)["closings"][0]["tip_error_pct_mean"] == pytest.approx(2.0)
    assert [grasp["agrees"] for grasp in summary["grasps"]] == [True, False]
    assert summary["grasps"][1]["latency_ms"] is None
    assert set(summary) >= {"friction", "closings", "grasps", "swaps", "shape", "bag", "replay", "wall_s"}


def test_the_page_holds_everything_itself(record: ShiftRecord, tmp_path: Path) -> None:
    (tmp_path / "film").mkdir()
    (tmp_path / "film" / "000.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    summary = summarise(record, ReplayCheck("node", 5, identical=True, detail="", wall_clock_s=0.5), 0.1)
    page = render(record, summary, figures(record, tmp_path))
    assert "data:image/jpeg;base64,/9j/2Q==" in page
    assert page.count("<svg") == 4
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:|//|/)|url\((?!#)""", page)


def instant(stamp: float, pulled: float) -> Instant:
    return Instant(stamp, pulled, (pulled, 2.0 * pulled), (0.1, -pulled), 5.0, 4.0)


def test_predictions_are_interpolated_at_the_time_of_the_frame() -> None:
    between = at_stamp([instant(1.0, 0.0), instant(1.02, 0.02)], 1.005)
    assert between is not None
    assert between.pulled_length_m == pytest.approx(0.005)
    assert between.angles == pytest.approx((0.005, 0.01))
    assert between.tip == pytest.approx((0.1, -0.005))


@pytest.mark.parametrize("stamp", [0.99, 1.02, 1.5])
def test_no_prediction_outside_the_stream_or_across_a_gap(stamp: float) -> None:
    assert at_stamp([instant(1.0, 0.0), instant(1.01, 0.01), instant(2.0, 0.02)], stamp) is None


def test_frames_without_prediction_are_left_out() -> None:
    frames = [MeasuredTip(0.5, (0.0, 0.0), (0.1, 0.0)), MeasuredTip(1.005, (0.0, 0.0), (0.1, 0.0))]
    assert len(pair(frames, [instant(1.01, 0.01), instant(1.0, 0.0)])) == 1


def test_the_chain_closes_towards_minus_y() -> None:
    points = chain([2.0, 1.0], [math.pi / 2, math.pi / 2])
    assert points.ravel().tolist() == pytest.approx([0.0, 0.0, 0.0, -2.0, -1.0, -2.0], abs=1e-12)
