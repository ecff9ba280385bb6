# SPDX-License-Identifier: Apache-2.0
"""The track command on a rendered film: table, picture, overlay, and what it says when something is wrong."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_vision import calibration as files
from softgrip_vision.calibration import Calibration
from softgrip_vision.commands import track
from softgrip_vision.overlay import HIDDEN, draw
from softgrip_vision.synthetic import Conditions, Occluder, Scene
from softgrip_vision.tracker import Tracker

FRAMES = 12


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for k in range(FRAMES):
        cv2.imwrite(
            str(folder / f"{k:03d}.png"), scene.render({"index": np.full(3, 0.03 * k)}, Conditions(noise=1)).image
        )
    return folder


def test_a_film_becomes_a_table_a_picture_and_an_overlay(
    tmp_path: Path, film: Path, calibration: Calibration, scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    out = tmp_path / "out"
    track.main([str(film), "--calibration", str(tmp_path / "c.yaml"), "--out", str(out)])
    rows = list(csv.DictReader((out / "track.csv").open()))
    assert len(rows) == FRAMES
    for k, row in enumerate(rows):
        assert float(row["time_s"]) == pytest.approx(k / 30, abs=1e-6)
        for joint in range(3):
            assert float(row[f"joint_{joint}_rad"]) == pytest.approx(0.03 * k, abs=0.005)
            assert 0 < float(row[f"joint_{joint}_stddev_rad"]) < 0.035
        tip = scene.tip("index", np.full(3, 0.03 * k))
        assert (float(row["tip_x_m"]), float(row["tip_y_m"])) == pytest.approx(tuple(tip), abs=2e-4)
        assert row["tip_occluded"] == "0"
    assert (out / "track.png").read_bytes().startswith(b"\x89PNG")
    video = cv2.VideoCapture(str(out / "overlay.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == FRAMES
    video.release()
    assert f"index: pose in {FRAMES} of {FRAMES} frames" in capsys.readouterr().out


def test_what_is_wrong_is_said(tmp_path: Path, film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        track.main([str(film), "--calibration", str(tmp_path / "none.yaml"), "--out", str(tmp_path)])
    assert "expected a camera calibration" in " ".join(capsys.readouterr().out.split())


def test_a_video_of_another_size_than_calibrated_is_refused(
    tmp_path: Path, calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    (tmp_path / "film").mkdir()
    cv2.imwrite(str(tmp_path / "film" / "0.png"), np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(SystemExit):
        track.main([str(tmp_path / "film"), "--calibration", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")])
    assert "expected images of 1280x720, found 640x480" in " ".join(capsys.readouterr().out.split())


def test_a_real_hand_without_markers(
    tmp_path: Path, hand_video: Path, calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    """Forty frames of the recording, spread over it: nothing is measured, and the command says so."""
    files.save(calibration, tmp_path / "c.yaml")
    film = tmp_path / "film"
    film.mkdir()
    video = cv2.VideoCapture(str(hand_video))
    frames = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    for k in range(frames):
        assert video.grab()
        if k % (frames // 40) == 0:
            cv2.imwrite(str(film / f"{k:04d}.jpg"), video.retrieve()[1])
    with pytest.raises(SystemExit) as ended:
        track.main([str(film), "--calibration", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")])
    assert ended.value.code == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "index: pose in 0 of" in said
    assert "found none in any of its frames" in said
    rows = list(csv.DictReader((tmp_path / "out" / "track.csv").open()))
    assert len(rows) >= 40
    assert all(row["joint_0_rad"] in {"", "nan"} for row in rows)


def test_overlay_marks_what_is_hidden(tracker: Tracker, scene: Scene) -> None:
    pose = np.full(3, 0.3)
    tip = scene.centres("index", pose)[-1]
    tracker.measure(scene.render({"index": pose}).image, 1.0)
    hidden = scene.render({"index": pose}, occluders=[Occluder(*tip, 26.0)]).image
    readings = tracker.measure(hidden, 1.0 + 1 / 30)
    drawn = draw(hidden, readings)
    around = drawn[int(tip[1]) - 90 : int(tip[1]) + 90, int(tip[0]) - 90 : int(tip[0]) + 90].astype(int)
    assert (np.abs(around - np.array(HIDDEN)).sum(axis=2) < 60).any()
    assert drawn.shape == hidden.shape
    assert not np.shares_memory(drawn, hidden)
