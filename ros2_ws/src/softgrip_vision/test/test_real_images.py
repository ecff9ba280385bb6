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

from softgrip_vision.calibration import Calibration
from softgrip_vision.colour import ColourModel
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.search import search_spots
from softgrip_vision.sources import decode
from softgrip_vision.spots import Window
from softgrip_vision.synthetic import Scene
from softgrip_vision.tracker import Tracker

CHAIN = ChainLayout((0.045, 0.027, 0.023))
CROPS = 2000
SMALLEST = 5_000


def photographs() -> list[Path]:
    """Images that come with installed packages, large enough to be more than icons."""
    found = []
    for package in ("matplotlib", "cv2", "scipy", "PIL"):
        spec = importlib.util.find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            continue
        for root in spec.submodule_search_locations:
            found += [p for p in sorted(Path(root).rglob("*")) if p.suffix.lower() in {".jpg", ".jpeg", ".png"}]
    return [path for path in found if path.stat().st_size > SMALLEST]


@pytest.fixture(scope="module")
def real() -> list[np.ndarray]:
    images = [decode(path.read_bytes()) for path in photographs()]
    assert any(image.shape[0] > 300 for image in images), "matplotlib ships at least one photograph"
    return images


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


def test_no_finger_is_seen_in_real_images(calibration: Calibration, real: list[np.ndarray]) -> None:
    random = np.random.default_rng(8)
    tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
    for frame in range(40):
        image = real[random.integers(len(real))][:, :, random.permutation(3)]
        picture = cv2.resize(image, (1280, 720))
        (reading,) = tracker.measure(picture, 1.0 + frame / 30)
        assert reading.pose is None
        assert reading.problem


def test_a_real_picture_put_over_a_followed_finger(
    calibration: Calibration, scene: Scene, real: list[np.ndarray]
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
