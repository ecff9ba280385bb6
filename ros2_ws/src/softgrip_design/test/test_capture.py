# SPDX-License-Identifier: Apache-2.0
"""The command on files: good ones, and every kind of bad one."""

from __future__ import annotations

import importlib.util
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from softgrip_design.capture.detector import DetectedHand, MediaPipeDetector
from softgrip_design.capture.frames import Image, Images, Video, record_camera
from softgrip_design.capture.recording import LONG_FINGERS, record
from softgrip_design.commands import capture as command
from softgrip_design.commands import optimise
from softgrip_design.errors import DesignError
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model import profile

Array = NDArray[np.float64]
OPEN = dict.fromkeys(LONG_FINGERS, (10.0, 8.0, 6.0))
FIST = dict.fromkeys(LONG_FINGERS, (70.0, 90.0, 50.0))
FRAMES = 60


class DrawnHand:
    """Sees an opening and closing hand in whatever it is shown; frames before `first` have none."""

    name = "drawn"

    def __init__(self, landmarks: Callable[..., Array], first: int = 0) -> None:
        self._landmarks, self._first, self._shown = landmarks, first, 0

    def find(self, image: Image) -> DetectedHand | None:
        share = float(np.clip((self._shown - 20) / 15.0, 0.0, 1.0))
        self._shown += 1
        if self._shown <= self._first:
            return None
        pose = {f: tuple((1 - share) * a + share * b for a, b in zip(OPEN[f], FIST[f], strict=True)) for f in OPEN}
        world = self._landmarks(pose)
        height, width = image.shape[:2]
        return DetectedHand(world, world[:, :2] * 1e3 + (width / 4, height / 2), 1.0)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "grey.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (320, 240))
    rng = np.random.default_rng(1)
    for k in range(FRAMES):
        writer.write(np.full((240, 320, 3), 60 + k, np.uint8) + rng.integers(0, 30, (240, 320, 3), dtype=np.uint8))
    writer.release()
    return path


def test_a_video_becomes_motions_with_their_files(
    video: Path, tmp_path: Path, hand_landmarks: Callable[..., Array], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "motion_09_hook.csv").write_text("of an earlier capture")
    options = command.parser().parse_args([str(video), "--out", str(tmp_path)])
    assert command.capture(options, DrawnHand(hand_landmarks)) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "motion_01_power.csv",
        "motions.json",
        "overlay.mp4",
        "recording.png",
    ]
    document = json.loads((tmp_path / "motions.json").read_text())
    assert (document["frames"], document["frames_with_hand"]) == (FRAMES, FRAMES)
    assert document["motions"][0]["curled"] == list(LONG_FINGERS)
    drawn = list(Video(tmp_path / "overlay.mp4").frames())
    assert len(drawn) == FRAMES
    banner = drawn[28].image[3, 160].astype(int)  # red in BGR while the fist closes
    assert banner[2] > banner[1] + 60
    assert "power" in capsys.readouterr().out

    assert optimise.main([str(tmp_path / "motion_01_power.csv"), "--out", str(tmp_path / "d"), "--starts", "2"]) == 0
    made = profile.load(tmp_path / "d" / "motion_01_power.yaml")
    assert set(made.slots) == {"thumb", *LONG_FINGERS}


def test_frames_have_the_times_of_the_file(video: Path) -> None:
    times = [frame.time_s for frame in Video(video).frames()]
    assert times == pytest.approx([k / 25.0 for k in range(FRAMES)], abs=1e-3)


def test_images_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for k in (1, 2, 10):
        cv2.imwrite(str(tmp_path / f"frame_{k}.png"), np.full((8, 8, 3), k, np.uint8))
    frames = list(Images(tmp_path, 10.0).frames())
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [1, 2, 10]
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.1, 0.2])


def test_frames_before_the_hand_comes_are_left_out(video: Path, hand_landmarks: Callable[..., Array]) -> None:
    seen = record(Video(video), DrawnHand(hand_landmarks, first=12))
    assert np.flatnonzero(seen.seen)[0] == 12


def test_a_video_without_a_hand_is_refused(video: Path, hand_landmarks: Callable[..., Array]) -> None:
    with pytest.raises(DesignError, match=r"expected a hand, found one in 0 of 60 frames"):
        record(Video(video), DrawnHand(hand_landmarks, first=1000))


def test_damaged_videos_are_refused(video: Path, tmp_path: Path) -> None:
    data = video.read_bytes()
    cut, noise, empty = (tmp_path / name for name in ("cut.avi", "noise.mp4", "empty.mp4"))
    cut.write_bytes(data[: len(data) // 3])
    noise.write_bytes(np.random.default_rng(1).bytes(20_000))
    empty.write_bytes(b"")
    with pytest.raises(DesignError, match=r"breaks off; the file is damaged|no frame that can be decoded"):
        list(Video(cut).frames())
    for path in (noise, empty):
        with pytest.raises(DesignError, match="cannot be opened as one"):
            list(Video(path).frames())
    with pytest.raises(DesignError, match="no such file"):
        list(Video(tmp_path / "none.mp4").frames())


def test_bad_images_and_absent_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DesignError, match="at least two images"):
        Images(tmp_path, 30.0)
    for k in (1, 2):
        (tmp_path / f"{k}.png").write_bytes(b"no image")
    with pytest.raises(DesignError, match=r"1\.png: expected an image"):
        list(Images(tmp_path, 30.0).frames())
    with pytest.raises(DesignError, match="expected a camera at index 97, found none"):
        record_camera(97, 1.0, tmp_path / "c.avi")


def test_a_film_that_is_not_there_is_named_before_the_detector_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "MediaPipeDetector", lambda: pytest.fail("it was loaded"))
    assert command.main([str(tmp_path / "hand.mp4")]) == 2
    assert f"expected a film, a folder of images or camera, found nothing at {tmp_path}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["camera:x"], "camera:<number>"),
        (["x.mp4", "--rate", "0"], "above 0"),
        (["x.mp4", "--seconds", "nan"], "above 0"),
    ],
)
def test_wrong_requests_are_refused(
    arguments: list[str], said: str, tmp_path: Path, hand_landmarks: Callable[..., Array]
) -> None:
    options = command.parser().parse_args([*arguments, "--out", str(tmp_path)])
    with pytest.raises(DesignError, match=said):
        command.capture(options, DrawnHand(hand_landmarks))


def hand_video() -> Path | None:
    """The recording of a real hand: named by SOFTGRIP_HAND_VIDEO, or in the shared data beside the repository."""
    named = os.environ.get("SOFTGRIP_HAND_VIDEO")
    path = Path(named) if named else Path(__file__).parents[5] / "shared/data/hand/human_hand_video.mp4"
    return path if path.is_file() else None


@pytest.mark.slow
@pytest.mark.skipif(hand_video() is None, reason="no recording of a hand: set SOFTGRIP_HAND_VIDEO")
@pytest.mark.skipif(importlib.util.find_spec("mediapipe") is None, reason="MediaPipe, an extra, is not installed")
def test_fist_and_pinch_of_a_real_hand_are_found_and_designed(tmp_path: Path) -> None:
    """Expected: what another person noted about the recording (fists, thumb-index pinch), to a fifth of a second."""
    path = hand_video()
    assert path is not None
    options = command.parser().parse_args([str(path), "--out", str(tmp_path), "--no-overlay"])
    with MediaPipeDetector() as detector:
        assert command.capture(options, detector) == 0
    motions = json.loads((tmp_path / "motions.json").read_text())["motions"]
    fists = [motion for motion in motions if motion["kind"] == "power"]
    pinches = [m for m in motions if m["kind"] == "pinch" and m["nearest_to_thumb"] == "index"]
    assert [fist["end_s"] for fist in fists] == pytest.approx([258 / 30, 607 / 30], abs=0.2)
    assert [pinch["end_s"] for pinch in pinches] == pytest.approx([316 / 30], abs=0.2)
    assert not any(motion["kind"] == "hook" for motion in motions)
    # the index curled alone in frames 56 to 80 is no grasp
    assert [m["kind"] for m in motions if m["curled"] == ["index"]] == ["none"]
    for motion in (fists[0], pinches[0]):
        shipped = load(SHIPPED / f"captured_{motion['kind']}.csv")
        captured = load(tmp_path / motion["file"])
        assert captured.closing("index")[-1] == pytest.approx(shipped.closing("index")[-1], abs=math.radians(2.0))
        out = tmp_path / motion["kind"]
        assert optimise.main([str(tmp_path / motion["file"]), "--finger", "index", "--out", str(out)]) == 0
        report = json.loads((out / f"{Path(motion['file']).stem}.json").read_text())
        ours = report["fingers"]["index"]["error_deg"]
        theirs = report["published_designs_on_the_same_target"]["index"].values()
        assert ours < min(design["error_deg"] for design in theirs)
