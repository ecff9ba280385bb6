# SPDX-License-Identifier: Apache-2.0
"""The camera's steps of the first run on rendered frames of known truth: what is wrong with the picture is named."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.camera_steps import (
    FRAMES,
    MAX_EDGE_SHARE,
    MAX_STALE_FRAMES,
    BenchCamera,
    ExposureStep,
    FocusStep,
    MarkersStep,
    PlaneStep,
)
from softgrip_demo.first_run.figures import Figure
from softgrip_description.cell_file import CellCamera
from softgrip_emulator.camera.stream import FrameBoard, StreamServer
from softgrip_model.profile import shipped_directory
from softgrip_testing.synthetic_images import Conditions, Occluder, SyntheticScene, make_calibration
from softgrip_vision import calibration
from softgrip_vision.layout import ChainLayout, read_chains

CALIBRATION = make_calibration()
CHAIN = read_chains(shipped_directory())["power"]["index"]
Bench = Callable[..., BenchCamera]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """Make a camera that gives frames of the straight index finger, taken under some conditions."""

    def make(
        conditions: Conditions | None = None,
        hidden: int | None = None,
        gains: tuple[float, ...] = (1.0,),
        angle: float = 0.0,
    ) -> BenchCamera:
        scene = SyntheticScene(CALIBRATION, {"index": CHAIN})
        pose = np.full(CHAIN.joints, angle)
        things = [] if hidden is None else [Occluder(*scene.centres("index", pose)[hidden], 26.0)]
        folder = tmp_path / "frames"
        folder.mkdir()
        image = scene.render({"index": pose}, conditions or Conditions(noise=2.0), things).image
        for number, gain in enumerate(gains):
            cv2.imwrite(str(folder / f"{number}.png"), np.clip(image * gain, 0, 255).astype(np.uint8))
        calibration.save(CALIBRATION, tmp_path / "camera.yaml")
        return BenchCamera(CellCamera(str(folder), tmp_path / "camera.yaml"))

    return make


def wrong(figures: list[Figure]) -> list[Figure]:
    return [figure for figure in figures if not figure.is_good]


def test_a_good_picture_passes_every_step(bench: Bench) -> None:
    camera = bench(gains=(1.0, 0.99, 1.01))
    for step in (ExposureStep(camera), FocusStep(camera), MarkersStep(camera), PlaneStep(camera)):
        assert wrong(list(step.measure())) == []


@pytest.mark.parametrize("blur", [0.8, 1.5, 3.0])
def test_the_edge_of_a_marker_is_as_wide_as_the_lens_blurs_it(bench: Bench, blur: float) -> None:
    """A step that a Gaussian of sigma blurs rises from 10 to 90 % over 2.56 sigma."""
    camera = bench(Conditions(blur=blur))
    edges = [one.edge_px for one in camera.of_first()]
    assert np.median(edges) == pytest.approx(2.0 * 1.2816 * blur, abs=1.0)


def test_a_camera_out_of_focus_is_named(bench: Bench) -> None:
    camera = bench(Conditions(blur=5.0))
    (figure,) = wrong(list(FocusStep(camera).measure()))
    assert figure.bound == f"at most {MAX_EDGE_SHARE:g}"
    assert "focus ring" in figure.remedy


@pytest.mark.parametrize("marker", range(CHAIN.joints + 2))
def test_a_missing_marker_is_named(bench: Bench, marker: int) -> None:
    camera = bench(hidden=marker)
    (figure,) = wrong(list(MarkersStep(camera).measure()))
    assert (figure.name, figure.found) == (f"index {CHAIN.marker_names[marker]}", "no marker")
    assert "glue a green marker of 5 mm" in figure.remedy
    with pytest.raises(FirstRunError, match="some missing"):
        list(PlaneStep(camera).measure())


def test_a_dark_picture_and_one_that_is_clipped_are_named(bench: Bench) -> None:
    (figure,) = wrong(list(ExposureStep(bench(Conditions(exposure=0.25))).measure()))
    assert "more light" in figure.remedy


def test_a_clipped_picture_is_named(bench: Bench) -> None:
    names = [figure.name for figure in wrong(list(ExposureStep(bench(Conditions(exposure=1.6))).measure()))]
    assert "clipped share of a marker" in names


def test_a_camera_that_chooses_its_exposure_is_named(bench: Bench) -> None:
    (figure,) = wrong(list(ExposureStep(bench(gains=(1.0, 0.85, 1.1, 0.9))).measure()))
    assert "power_line_hz" in figure.remedy


def test_a_finger_that_is_bent_is_not_in_its_place(bench: Bench) -> None:
    found = wrong(list(MarkersStep(bench(angle=math.radians(4.0))).measure()))
    assert found
    assert all("is the finger straight" in figure.remedy or figure.found == "no marker" for figure in found)


def test_links_of_another_profile_are_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = bench()
    longer = ChainLayout(tuple(length + 0.003 for length in CHAIN.link_lengths_m))
    monkeypatch.setattr(BenchCamera, "layout", longer)
    found = wrong(list(PlaneStep(camera).measure()))
    assert [figure.name for figure in found] == [f"link {n}: length beside the profile's" for n in range(CHAIN.joints)]


def test_no_finger_at_all_is_named(tmp_path: Path, bench: Bench) -> None:
    camera = bench()
    cv2.imwrite(str(tmp_path / "frames" / "0.png"), np.full((720, 1280, 3), 60, np.uint8))
    with pytest.raises(FirstRunError, match="found none; is the finger in sight"):
        list(FocusStep(camera).measure())


def test_a_camera_without_calibration_plane_or_frames_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(FirstRunError, match="expected a calibration in the cell file"):
        list(MarkersStep(BenchCamera(CellCamera(str(tmp_path / "empty")))).measure())
    calibration.save(CALIBRATION, tmp_path / "camera.yaml")
    camera = BenchCamera(CellCamera(f"@{tmp_path}/none", tmp_path / "camera.yaml"))
    with pytest.raises(FirstRunError, match="is it running"):
        list(FocusStep(camera).measure())
    with pytest.raises(FirstRunError, match=r"expected the plane of 'thumb', found \['index'\]"):
        list(MarkersStep(BenchCamera(camera.camera, finger="thumb")).measure())


# --- a camera that repeats its last frame, as a server of motion JPEG does --------------------------------------------


def jpeg_of(blur: float, angle: float = 0.0) -> bytes:
    scene = SyntheticScene(CALIBRATION, {"index": CHAIN})
    image = scene.render({"index": np.full(CHAIN.joints, angle)}, Conditions(noise=2.0, blur=blur)).image
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


class LiveCamera:
    """A stream whose newest frame is an old one until somebody looks; then others come.

    Args:
        old, new: JPEG files.
        lag_s: by which its clock is behind the computer's.
    """

    def __init__(self, old: bytes, new: bytes, lag_s: float = 0.0) -> None:
        self._board, self._ended = FrameBoard(), threading.Event()
        self._board.pin(old, time.time() - 60.0)
        self._server = StreamServer(self._board)
        self._server.start()
        self.url = self._server.url
        self._thread = threading.Thread(target=self._run, args=(new, lag_s))
        self._thread.start()

    def _run(self, new: bytes, lag_s: float) -> None:
        while not self._ended.wait(0.02):
            if self._board.viewers:
                self._board.pin(new, time.time() - lag_s)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._server.close()


Film = Callable[..., BenchCamera]


@pytest.fixture
def film(tmp_path: Path) -> Iterator[Film]:
    """Make a bench whose camera has an old frame, and others from when somebody looks."""
    opened: list[LiveCamera] = []

    def make(old: bytes, new: bytes, lag_s: float = 0.0) -> BenchCamera:
        opened.append(LiveCamera(old, new, lag_s))
        calibration.save(CALIBRATION, tmp_path / "camera.yaml")
        return BenchCamera(CellCamera(opened[-1].url, tmp_path / "camera.yaml"))

    yield make
    for one in opened:
        one.close()


def test_a_frame_of_before_the_focus_was_turned_is_not_judged(film: Film) -> None:
    camera = film(jpeg_of(blur=5.0), jpeg_of(blur=1.0))
    assert wrong(list(FocusStep(camera).measure())) == []
    assert len(camera.frames) == FRAMES


def test_a_frame_of_before_the_finger_was_put_straight_is_not_judged(film: Film) -> None:
    camera = film(jpeg_of(1.0, angle=math.radians(12.0)), jpeg_of(1.0))
    assert wrong(list(MarkersStep(camera).measure())) == []


def test_a_good_frame_of_before_does_not_hide_what_is_wrong_now(film: Film) -> None:
    assert wrong(list(FocusStep(film(jpeg_of(1.0), jpeg_of(5.0))).measure()))


def test_a_camera_whose_clock_is_behind_is_named(film: Film) -> None:
    camera = film(jpeg_of(1.0), jpeg_of(1.0), lag_s=3600.0)
    with pytest.raises(FirstRunError, match=rf"found {MAX_STALE_FRAMES} that say they are 3\d{{3}}\.\d s older.*NTP"):
        list(FocusStep(camera).measure())


def test_markers_that_go_out_of_sight_are_named_not_the_exposure(tmp_path: Path, bench: Bench) -> None:
    camera = bench(gains=(1.0, 1.0, 1.0))
    cv2.imwrite(str(tmp_path / "frames" / "1.png"), np.full((720, 1280, 3), 60, np.uint8))
    (figure,) = wrong(list(ExposureStep(camera).measure()))
    assert (figure.name, figure.found, figure.bound) == ("frames that show a marker", "2", "3")
    assert "lens free" in figure.remedy
    assert "exposure_s" not in figure.remedy


def test_a_lens_under_its_cap_is_named(tmp_path: Path, bench: Bench) -> None:
    camera = bench()
    cv2.imwrite(str(tmp_path / "frames" / "0.png"), np.full((720, 1280, 3), 6, np.uint8))
    with pytest.raises(FirstRunError, match=r"found a dark one .* take the cap off the lens"):
        list(ExposureStep(camera).measure())
