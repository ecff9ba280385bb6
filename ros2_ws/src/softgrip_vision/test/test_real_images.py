# SPDX-License-Identifier: Apache-2.0
"""Real photographs: whatever images the installed packages carry, cut to pieces, never crash the tracker.

No package that the suite installs ships photographs of green markers; what there is tells whether anything in a real
picture is taken for a finger, and that nothing in one ends the program.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_testing.synthetic_images import SyntheticScene
from softgrip_vision.calibration import CameraCalibration
from softgrip_vision.colour import ColourModel
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.search import search_spots
from softgrip_vision.sources import decode
from softgrip_vision.spots import Window
from softgrip_vision.tracker import Tracker

CHAIN = ChainLayout((0.045, 0.027, 0.023))
CROPS = 2000
#: Packages that are known to carry photographs; those that are not installed are left out.
PACKAGES = ("matplotlib", "skimage", "sklearn", "mediapipe", "cv2", "scipy", "imageio", "PIL")
SMALLEST = 5_000
#: A drawing or an icon has fewer colours.
MIN_COLOURS = 1_000
VIDEO_FRAMES = 30


def photographs() -> dict[str, np.ndarray]:
    """Photographs that come with installed packages, by where they are."""
    found = {}
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            continue
        for root in spec.submodule_search_locations:
            for path in sorted(Path(root).rglob("*")):
                if path.suffix.lower() not in {".jpg", ".jpeg", ".png"} or path.stat().st_size < SMALLEST:
                    continue
                image = decode(path.read_bytes())
                if len(np.unique(image.reshape(-1, 3), axis=0)) > MIN_COLOURS:
                    found[f"{package}/{path.relative_to(root)}"] = image
    return found


def frames_of(path: Path) -> list[np.ndarray]:
    """Frames of a video, spread over it."""
    video = cv2.VideoCapture(str(path))
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    requested = set(np.linspace(0, count - 1, VIDEO_FRAMES).astype(int).tolist())
    frames = [np.asarray(video.retrieve()[1]) for k in range(count) if video.grab() and k in requested]
    video.release()
    return frames


@pytest.fixture(scope="module")
def real(request: pytest.FixtureRequest) -> list[np.ndarray]:
    named = photographs()
    assert any(image.shape[0] > 300 for image in named.values()), "matplotlib ships at least one photograph"
    try:
        video = frames_of(request.getfixturevalue("hand_video"))
    except pytest.skip.Exception:
        video = []
    sizes = [f"{name} {image.shape[1]}x{image.shape[0]}" for name, image in named.items()]
    with request.config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        print(  # noqa: T201  which ones it was, for the log
            f"\nreal images: {', '.join(sizes)}; {len(video)} frames of a recorded hand"
        )
    return [*named.values(), *video]


def test_random_crops_of_real_images_never_crash(real: list[np.ndarray]) -> None:
    """Crops of any size and shape through the search, at random hues, sizes and channel orders."""
    random = np.random.default_rng(7)
    for _ in range(CROPS):
        image = real[random.integers(len(real))]
        height = int(random.integers(1, min(200, image.shape[0]) + 1))
        width = int(random.integers(1, min(200, image.shape[1]) + 1))
        top = int(random.integers(0, image.shape[0] - height + 1))
        left = int(random.integers(0, image.shape[1] - width + 1))
        crop = image[top : top + height, left : left + width][:, :, random.permutation(3)]
        colour = ColourModel(float(random.uniform(0, 360)), float(random.uniform(20, 80)))
        for spot in search_spots(crop, Window(0, 0, width, height), colour, float(random.uniform(5, 40))):
            assert np.isfinite([spot.u, spot.v, spot.stddev_px, spot.area_px]).all()
            assert 0 <= spot.u < width
            assert 0 <= spot.v < height


def test_no_finger_is_seen_in_real_images(calibration: CameraCalibration, real: list[np.ndarray]) -> None:
    random = np.random.default_rng(8)
    tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
    for frame in range(40):
        image = real[random.integers(len(real))][:, :, random.permutation(3)]
        picture = cv2.resize(image, (1280, 720))
        (reading,) = tracker.measure(picture, 1.0 + frame / 30)
        assert reading.pose is None
        assert reading.problem


def test_a_real_picture_put_over_a_followed_finger(
    calibration: CameraCalibration, scene: SyntheticScene, real: list[np.ndarray]
) -> None:
    """Parts of photographs hide parts of the finger: what is still given out is right."""
    random = np.random.default_rng(9)
    tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
    truth = np.array([0.5, 0.4, 0.3])
    clean = scene.render({"index": truth}).image
    given = 0
    for frame in range(60):
        picture = clean.copy()
        if frame % 3:
            image = real[random.integers(len(real))]
            side = int(random.integers(20, 160))
            patch = cv2.resize(image, (side, side))[:, :, random.permutation(3)]
            left, top = int(random.integers(200, 640)), int(random.integers(120, 500))
            picture[top : top + side, left : left + side] = patch
        (reading,) = tracker.measure(picture, 1.0 + frame / 30)
        if reading.pose is not None:
            given += 1
            assert reading.pose.angles == pytest.approx(truth, abs=np.radians(2.0))
    assert given > 30
