# SPDX-License-Identifier: Apache-2.0
"""Frames that show what the last one showed are left out, and never one that shows something else."""

import cv2
import numpy as np
import pytest

from softgrip_testing.synthetic_images import SyntheticScene
from softgrip_vision.encoded_image import decode, thumbnail, thumbnail_of
from softgrip_vision.still import REST_AFTER_S, StillWatch

PERIOD_S, REST_PERIOD_S = 0.05, 0.2
POSE = np.array([0.4, 0.3, 0.2])
NOISE = np.random.default_rng(5)


def seen(scene: SyntheticScene, pose: np.ndarray) -> bytes:
    """A frame as a camera sends it, each with noise of its own (standard deviation 5 grey levels)."""
    image = scene.render({"index": pose}).image
    noisy = np.clip(image + NOISE.normal(0.0, 5.0, image.shape), 0, 255).astype(np.uint8)
    return bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 92])[1])


@pytest.fixture(scope="module")
def still(scene: SyntheticScene) -> list[np.ndarray]:
    return [thumbnail(seen(scene, POSE)) for _ in range(8)]


def measured(watch: StillWatch, pictures: list[np.ndarray], begin_s: float = 0.0) -> list[float]:
    """The stamps [s] of the frames that are to be measured."""
    stamps = [begin_s + PERIOD_S * number for number in range(len(pictures))]
    return [stamp for picture, stamp in zip(pictures, stamps, strict=True) if not watch.may_skip(picture, stamp)]


def test_a_picture_that_stays_the_same_is_measured_less_often_after_a_while(still):
    stamps = measured(StillWatch(REST_PERIOD_S), [still[n % 8] for n in range(120)])
    assert np.diff([stamp for stamp in stamps if stamp <= REST_AFTER_S]) == pytest.approx(PERIOD_S)
    assert np.diff([stamp for stamp in stamps if stamp > REST_AFTER_S]) == pytest.approx(REST_PERIOD_S)


@pytest.mark.parametrize("turned_rad", [0.004, -0.004, 0.1])
def test_a_finger_that_moves_is_measured_in_the_first_frame_that_shows_it(scene, still, turned_rad):
    """0.004 rad at the base are some 0.4 px at the tip of this scene."""
    watch = StillWatch(REST_PERIOD_S)
    measured(watch, [still[n % 8] for n in range(122)])
    moved = [thumbnail(seen(scene, POSE + np.array([turned_rad, 0.0, 0.0]))) for _ in range(20)]
    begin_s = 122 * PERIOD_S
    assert measured(watch, moved, begin_s) == pytest.approx([begin_s + PERIOD_S * n for n in range(20)])


def test_after_a_reset_every_frame_is_measured(still):
    watch = StillWatch(REST_PERIOD_S)
    measured(watch, [still[n % 8] for n in range(100)])
    watch.reset()
    assert len(measured(watch, [still[n % 8] for n in range(20)], 5.0)) == 20


def test_a_source_that_begins_again_is_measured(still):
    watch = StillWatch(REST_PERIOD_S)
    measured(watch, [still[n % 8] for n in range(100)], 1000.0)
    assert len(measured(watch, [still[n % 8] for n in range(20)], 1.0)) == 20


def test_a_picture_of_another_size_is_measured(still):
    watch = StillWatch(REST_PERIOD_S)
    measured(watch, [still[n % 8] for n in range(101)])
    assert not watch.may_skip(still[0][1:], 101 * PERIOD_S)


def test_both_transports_see_alike(scene):
    data = seen(scene, POSE)
    from_pixels, from_jpeg = thumbnail_of(decode(data)), thumbnail(data)
    assert from_pixels.shape == from_jpeg.shape
    assert np.abs(from_pixels.astype(int) - from_jpeg.astype(int)).max() <= 3
