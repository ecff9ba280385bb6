# SPDX-License-Identifier: Apache-2.0
"""The track command on a rendered film: table, picture, overlay, and what it says when something is wrong."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_testing.synthetic_images import Conditions, Occluder, SyntheticScene
from softgrip_vision import calibration as files
from softgrip_vision.calibration import CameraCalibration
from softgrip_vision.commands import calibrate_camera, track
from softgrip_vision.overlay import HIDDEN, draw
from softgrip_vision.tracker import Tracker

FRAMES = 12


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory, scene: SyntheticScene) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for k in range(FRAMES):
        cv2.imwrite(
            str(folder / f"{k:03d}.png"), scene.render({"index": np.full(3, 0.03 * k)}, Conditions(noise=1)).image
        )
    return folder


def test_a_film_becomes_a_table_a_picture_and_an_overlay(
    tmp_path: Path,
    film: Path,
    calibration: CameraCalibration,
    scene: SyntheticScene,
    capsys: pytest.CaptureFixture[str],
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
    tmp_path: Path, calibration: CameraCalibration, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    (tmp_path / "film").mkdir()
    cv2.imwrite(str(tmp_path / "film" / "0.png"), np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(SystemExit):
        track.main([str(tmp_path / "film"), "--calibration", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")])
    assert "expected images of 1280x720, found 640x480" in " ".join(capsys.readouterr().out.split())


def said(capsys: pytest.CaptureFixture[str]) -> str:
    return " ".join(capsys.readouterr().out.split())


def test_a_film_that_breaks_off_leaves_what_was_measured(
    tmp_path: Path, film: Path, calibration: CameraCalibration, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    cut = tmp_path / "cut"
    cut.mkdir()
    for path in sorted(film.iterdir())[:4]:
        (cut / path.name).write_bytes(path.read_bytes())
    (cut / "004.png").write_bytes(b"no picture")
    with pytest.raises(SystemExit) as ended:
        track.main(
            [str(cut), "--calibration", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), "--no-overlay"]
        )
    assert ended.value.code == 1
    assert "expected an image, found a file that is none; remove it from the folder; the results" in said(capsys)
    assert len(list(csv.DictReader((tmp_path / "out" / "track.csv").open()))) == 4


def test_a_video_that_is_cut_off_is_named(
    tmp_path: Path, film: Path, calibration: CameraCalibration, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    whole = tmp_path / "whole.avi"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (1280, 720))
    for path in sorted(film.iterdir()):
        writer.write(cv2.imread(str(path)))
    writer.release()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(SystemExit) as ended:
        track.main(
            [str(cut), "--calibration", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), "--no-overlay"]
        )
    assert ended.value.code == 1
    assert f"expected {FRAMES} frames, found" in said(capsys)
    assert 0 < len(list(csv.DictReader((tmp_path / "out" / "track.csv").open()))) < FRAMES


def test_folders_and_planes_that_are_none(
    tmp_path: Path, film: Path, calibration: CameraCalibration, capsys: pytest.CaptureFixture[str]
) -> None:
    files.save(calibration, tmp_path / "c.yaml")
    files.save(replace(calibration, planes=()), tmp_path / "lens.yaml")
    for known, out, words in (
        ("lens.yaml", "out", "expected a finger's plane, found none"),
        ("c.yaml", "c.yaml", "expected a folder for the results, found a file"),
    ):
        with pytest.raises(SystemExit):
            track.main([str(film), "--calibration", str(tmp_path / known), "--out", str(tmp_path / out)])
        assert words in said(capsys)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["plane", "0", "--calibration", "c", "--finger", "index", "--marker-diameter-mm", "0"], "less than 100 mm"),
        (["plane", "0", "--calibration", "c", "--finger", "index", "--base-marker-mm", "nan"], "less than 1000 mm"),
        (["plane", "0", "--calibration", "c", "--finger", " "], "expected the name of a finger"),
        (["target", "--plane", "--base-marker-mm", "-20", "--out", "b.pdf"], "less than 1000 mm"),
        (["lens", "0", "--out", "c.yaml", "--frames", "-3"], "expected a whole number of 1 or more"),
    ],
)
def test_what_a_calibration_cannot_hold_is_refused_at_once(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        calibrate_camera.main(words)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


def test_where_a_calibration_goes_is_made_sure_of_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit):
        calibrate_camera.main(["lens", "none.mp4", "--out", str(tmp_path / "file" / "c.yaml")])
    assert "file is a file" in said(capsys)
    calibrate_camera.main(["target", "--chessboard", "--out", str(tmp_path / "new" / "board.pdf")])
    assert (tmp_path / "new" / "board.pdf").read_bytes().startswith(b"%PDF")


def test_a_real_hand_without_markers(
    tmp_path: Path, hand_video: Path, calibration: CameraCalibration, capsys: pytest.CaptureFixture[str]
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
    words = said(capsys)
    assert "index: pose in 0 of" in words
    assert "found none in any of its frames" in words
    rows = list(csv.DictReader((tmp_path / "out" / "track.csv").open()))
    assert len(rows) >= 40
    assert all(row["joint_0_rad"] in {"", "nan"} for row in rows)


def test_overlay_marks_what_is_hidden(tracker: Tracker, scene: SyntheticScene) -> None:
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
