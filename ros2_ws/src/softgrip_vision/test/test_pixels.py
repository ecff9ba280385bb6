# SPDX-License-Identifier: Apache-2.0
"""The compiled work on pixels against plain NumPy and OpenCV, and what it does with input that makes no sense."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from softgrip_vision import _core
from softgrip_vision.calibration import Lens
from softgrip_vision.colour import ColourModel
from softgrip_vision.marker_appearance import BodySide, colours_at, surrounds_of
from softgrip_vision.spots import Spot, Window, find_spots

#: No multiples of 60 deg: signals are no whole numbers, and none lies on a threshold by chance.
COLOUR = ColourModel(117.3, 43.0)
AREA = (30.0, 900.0)


def crowd(seed: int, shape: tuple[int, int] = (150, 210), count: int = 40) -> np.ndarray:
    """Blurred green blobs of all sizes, many touching, on noise."""
    random = np.random.default_rng(seed)
    image = np.full((*shape, 3), 115.0)
    for _ in range(count):
        place = tuple(int(x) for x in random.integers((0, 0), shape[::-1]))
        cv2.ellipse(image, place, (int(random.integers(1, 13)), int(random.integers(1, 13))), 30.0, 0.0, 360.0,
                    (60.0, float(random.uniform(130, 240)), 50.0), -1)  # fmt: skip
    image = cv2.GaussianBlur(image, (0, 0), 0.9) + random.normal(0.0, 3.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def plain_signal(image: np.ndarray) -> np.ndarray:
    """c - |o| / tan(half angle), as colour.py has it."""
    blue, green, red = (image[:, :, channel].astype(np.float64) for channel in range(3))
    alpha, beta = red - (green + blue) / 2, math.sqrt(3) / 2 * (green - blue)
    hue = math.radians(COLOUR.hue_deg)
    along, across = math.cos(hue) * alpha + math.sin(hue) * beta, math.cos(hue) * beta - math.sin(hue) * alpha
    return np.asarray(along - np.abs(across) / math.tan(math.radians(COLOUR.half_angle_deg)))


def plain_spots(image: np.ndarray, window: Window, threshold: float) -> list[Spot]:
    """What a spot is, word for word, in double precision and without a thought for time."""
    signal = plain_signal(window.cut(image))
    mask = signal > threshold
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    around = np.sort(signal[::2, ::2][~mask[::2, ::2]])
    if around.size < 8:
        level, noise = 0.0, 0.5
    else:
        level = around[around.size // 2]
        noise = max(0.5, 1.4826 * np.sort(np.abs(around - level))[around.size // 2])
    spots = []
    for label in range(1, count):
        left, top, width, height, pixels = (int(value) for value in stats[label])
        cut = left == 0 or top == 0 or left + width == window.width or top + height == window.height
        if cut or not max(4.0, AREA[0] / 2) <= pixels <= 2 * AREA[1]:
            continue
        plateau = np.sort(signal[labels == label])[int(0.75 * pixels)] - level
        if plateau <= 3 * noise:
            continue
        bottom, right = min(window.height, top + height + 2), min(window.width, left + width + 2)
        box = slice(max(0, top - 2), bottom), slice(max(0, left - 2), right)
        ramp = ((signal[box] - level) / plateau - 0.25) / (0.65 - 0.25)
        foreign = (labels[box] != label) & (labels[box] != 0)
        weight = np.clip(ramp, 0.0, 1.0) * (cv2.dilate(foreign.astype(np.uint8), np.ones((3, 3))) == 0)
        area = weight.sum()
        if not max(1.0, AREA[0]) <= area <= AREA[1]:
            continue
        rows, columns = np.mgrid[box]
        u, v = (weight * columns).sum() / area, (weight * rows).sum() / area
        x, y = columns - u, rows - v
        spread = np.array([[(weight * x * x).sum(), (weight * x * y).sum()], [0.0, (weight * y * y).sum()]]) / area
        minor, major = np.linalg.eigvalsh(spread, UPLO="U")
        edge = (ramp > 0) & (ramp < 1)
        slope = 1 / (0.4 * plateau)
        lever = (x**2 + y**2)[edge].sum() / 2 / area**2
        spots.append(
            Spot(
                window.left + u,
                window.top + v,
                math.hypot(0.03, noise * slope * math.sqrt(4.0 * lever)),
                area,
                math.sqrt(minor / major),
                min(1.0, area / (4 * math.pi * math.sqrt(minor * major))),
                plateau,
                level,
                noise,
            )
        )
    return spots


@pytest.mark.parametrize("seed", range(6))
def test_spots_are_what_they_are_said_to_be(seed: int) -> None:
    """Every number of every spot, in windows anywhere, at the image's border too."""
    image, random = crowd(seed), np.random.default_rng(seed)
    height, width = image.shape[:2]
    windows = [Window(0, 0, width, height), Window(width - 60, height - 50, 60, 50), Window(0, 17, 45, 90)]
    for _ in range(12):
        left, top = int(random.integers(0, width - 40)), int(random.integers(0, height - 40))
        windows.append(
            Window(left, top, int(random.integers(30, width - left)), int(random.integers(30, height - top)))
        )
    thresholds = random.uniform(15.0, 70.0, len(windows)).tolist()
    found = find_spots(image, windows, COLOUR, thresholds, AREA)
    assert sum(len(spots) for spots in found) > 20
    for window, threshold, spots in zip(windows, thresholds, found, strict=True):
        expected = plain_spots(image, window, threshold)
        assert len(spots) == len(expected)
        for spot, other in zip(sorted(spots), sorted(expected), strict=True):
            # A pixel that lies on the very end of the ramp counts to its edge or not, as rounding will have it.
            assert spot.stddev_px == pytest.approx(other.stddev_px, rel=0.03)
            numbers = tuple(spot._replace(stddev_px=other.stddev_px))
            assert numbers == pytest.approx(tuple(other), rel=1e-5, abs=1e-5)


def test_signal_is_that_of_the_definition() -> None:
    image = np.random.default_rng(1).integers(0, 256, (23, 31, 3)).astype(np.uint8)
    assert COLOUR.signal(image) == pytest.approx(plain_signal(image), abs=1e-3)
    assert COLOUR.signal(image[:, :1]).shape == (23, 1)
    assert COLOUR.signal(image[:0]).shape == (0, 31)


def test_components_are_those_of_opencv() -> None:
    """Random dots percolate: components of all shapes and sizes, joined late and by their corners."""
    random = np.random.default_rng(2)
    for share in (0.02, 0.2, 0.35, 0.45, 0.6, 0.95):
        signal = (random.uniform(size=(60, 83)) < share).astype(np.float32)
        count, _, stats, _ = cv2.connectedComponentsWithStats((signal > 0.5).astype(np.uint8), connectivity=8)
        ours = _core.components(signal, 0.5)
        assert len(ours) == count - 1
        assert sorted(ours.tolist()) == sorted(stats[1:].tolist())
    assert _core.components(np.zeros((0, 0), np.float32), 0.5).shape == (0, 5)
    assert _core.components(np.full((3, 4), np.nan, np.float32), 0.5).shape == (0, 5)


def views() -> dict[str, np.ndarray]:
    image = crowd(3)
    wide = np.zeros((160, 260, 3), np.uint8)
    wide[5:155, 20:230] = image
    four = np.dstack([image, image[:, :, :1]])
    fixed = image.copy()
    fixed.flags.writeable = False
    return {
        "part": wide[5:155, 20:230],
        "mirrored": np.ascontiguousarray(image[:, ::-1])[:, ::-1],
        "upside down": np.ascontiguousarray(image[::-1])[::-1],
        "every other": np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)[::2, ::2],
        "colours reversed": np.ascontiguousarray(image[:, :, ::-1])[:, :, ::-1],
        "three of four channels": four[:, :, :3],
        "by columns": np.asfortranarray(image),
        "read-only": fixed,
    }


@pytest.mark.parametrize("name", views())
def test_any_layout_in_memory_shows_the_same(name: str) -> None:
    image, view = crowd(3), views()[name]
    windows, thresholds = [Window(0, 0, 210, 150), Window(100, 60, 110, 90)], [30.0, 45.0]
    assert np.array_equal(view, image)
    spots = find_spots(image, windows, COLOUR, thresholds, AREA)
    assert find_spots(view, windows, COLOUR, thresholds, AREA) == spots
    assert np.array_equal(COLOUR.signal(view), COLOUR.signal(image))
    assert np.array_equal(colours_at(view, spots[0]), colours_at(image, spots[0]))


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((20, 20), np.uint8),
        np.zeros((20, 20, 1), np.uint8),
        np.zeros((20, 20, 4), np.uint8),
        np.zeros((20, 20, 3), np.float32),
        np.zeros((20, 20, 3), np.uint16),
        np.zeros((20, 20, 3), np.int8),
        np.zeros((20, 20, 3), np.bool_),
        np.zeros((2, 20, 20, 3), np.uint8),
    ],
)
def test_what_is_no_colour_image_is_named(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected 8-bit BGR"):
        find_spots(image, [Window(0, 0, 10, 10)], COLOUR, [30.0], AREA)
    with pytest.raises(ValueError, match="expected 8-bit BGR"):
        COLOUR.signal(image)


@pytest.mark.parametrize(
    "window",
    [
        Window(-1, 0, 10, 10),
        Window(0, -1, 10, 10),
        Window(0, 0, 211, 10),
        Window(0, 0, 10, 151),
        Window(210, 150, 1, 1),
        Window(5, 5, -3, 10),
        Window(5, 5, 10, -3),
        Window(2**31 - 1, 0, 2**31 - 1, 1),
        Window(-(2**31), 0, 2**31 - 1, 1),
    ],
)
def test_a_window_that_reaches_out_of_the_image_is_named(window: Window) -> None:
    with pytest.raises(ValueError, match="inside the image"):
        find_spots(crowd(4), [Window(0, 0, 50, 50), window], COLOUR, [30.0, 30.0], AREA)


def test_windows_of_no_size_and_of_a_pixel_show_nothing() -> None:
    image = crowd(4)
    sizes = [(0, 0), (0, 9), (9, 0), (1, 1), (1, 9), (9, 1), (2, 2), (3, 3)]
    windows = [Window(left, top, *size) for size in sizes for left, top in [(0, 0), (210 - size[0], 150 - size[1])]]
    assert find_spots(image, windows, COLOUR, [-1000.0] * len(windows), (0.0, 1e9)) == [[] for _ in windows]
    assert find_spots(image, [], COLOUR, [], AREA) == []
    assert find_spots(np.zeros((0, 0, 3), np.uint8), [Window(0, 0, 0, 0)], COLOUR, [1.0], AREA) == [[]]


def test_numbers_that_are_none_are_named() -> None:
    image, window = crowd(4), Window(0, 0, 50, 50)
    for threshold in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="finite grey levels"):
            find_spots(image, [window], COLOUR, [threshold], AREA)
    for thresholds in ([], [30.0, 30.0]):
        with pytest.raises(ValueError, match="one for each of 1 windows"):
            find_spots(image, [window], COLOUR, thresholds, AREA)
    for area in ((math.nan, 10.0), (10.0, math.nan), (-1.0, 10.0), (20.0, 10.0)):
        with pytest.raises(ValueError, match="smallest <= largest"):
            find_spots(image, [window], COLOUR, [30.0], area)
    with pytest.raises(ValueError, match="forms: expected finite"):
        find_spots(image, [window], ColourModel(math.nan), [30.0], AREA)


def test_saturated_pictures_and_pictures_without_background() -> None:
    everything = Window(0, 0, 64, 64)
    white, green = np.full((64, 64, 3), 255, np.uint8), np.zeros((64, 64, 3), np.uint8)
    green[:, :, 1] = 255
    for image in (white, green):
        for threshold in (-1e6, -1.0, 0.0, 30.0, 1e6):
            assert find_spots(image, [everything], COLOUR, [threshold], (0.0, 1e9)) == [[]]
    island = np.full((64, 64, 3), 255, np.uint8)
    island[20:40, 10:50] = (0, 255, 0)
    ((spot,),) = find_spots(island, [everything], COLOUR, [30.0], AREA)
    assert (spot.u, spot.v, spot.area_px) == pytest.approx((29.5, 29.5, 800.0))
    # A frame of background one pixel wide, of which seven samples are looked at: too few to tell a level.
    tight = np.zeros((5, 13, 3), np.uint8)
    tight[1:4, 1:12, 1] = 200
    assert len(find_spots(tight, [Window(0, 0, 13, 5)], COLOUR, [30.0], (1.0, 100.0))[0]) == 1


def test_hundreds_of_touching_and_nested_spots() -> None:
    """Every second pixel of a comb, rings within rings, a chessboard whose squares meet at their corners."""
    image = np.zeros((220, 220, 3), np.uint8)
    image[2:60:2, 2:200, 1] = 200
    for radius in range(4, 70, 4):
        cv2.circle(image, (110, 140), radius, (0, 220, 0), 1)
    image[::5, 200:][:, ::2, 1] = 180
    board = np.indices((40, 40)).sum(axis=0) % 2 == 0
    image[170:210, 10:50][board] = (0, 210, 0)
    whole = Window(0, 0, 220, 220)
    (spots,) = find_spots(image, [whole], COLOUR, [30.0], (1.0, 1e5))
    assert len(spots) == 40
    for spot in spots:
        assert np.isfinite(spot).all()
        assert 0.0 < spot.roundness <= 1.0
        assert 0.0 < spot.solidity <= 1.0


def test_colours_and_surroundings_are_those_of_the_pixels() -> None:
    """Beside the image its border counts, however far away; NaN counts as left or above."""
    image = crowd(5)
    height, width = image.shape[:2]
    brightness = image.sum(axis=2)
    turns = np.arange(16) * math.pi / 8
    for u, v in [(50.3, 40.6), (0.2, 0.4), (209.0, 149.0), (-5.0, 200.0), (1e12, -1e12), (-math.inf, math.inf)]:
        spot = Spot(u, v, 0.03, 120.0, 1.0, 1.0, 80.0, 0.0, 1.0)
        rows = [int(np.clip(np.rint(v) + k, 0, height - 1)) for k in (-1, 0, 1)]
        columns = [int(np.clip(np.rint(u) + k, 0, width - 1)) for k in (-1, 0, 1)]
        centre = image[np.ix_(rows, columns)].reshape(-1, 3)
        assert colours_at(image, [spot])[0] == pytest.approx(centre.mean(axis=0))
        reach = 1.4 * math.sqrt(120.0 / math.pi)
        at_u = np.clip(np.floor(u + 0.5 + reach * np.cos(turns)), 0, width - 1).astype(int)
        at_v = np.clip(np.floor(v + 0.5 + reach * np.sin(turns)), 0, height - 1).astype(int)
        ring = np.sort(brightness[at_v, at_u])
        own = centre.sum(axis=1).mean()
        assert surrounds_of(image, [spot], BodySide.BRIGHTER) == pytest.approx([(ring[13] + 1) / (own + 1)])
        assert surrounds_of(image, [spot], BodySide.DARKER) == pytest.approx([(ring[2] + 1) / (own + 1)])
    nowhere = Spot(math.nan, math.nan, 0.03, 120.0, 1.0, 1.0, 80.0, 0.0, 1.0)
    assert np.isfinite(surrounds_of(image, [nowhere], BodySide.DARKER)).all()
    assert surrounds_of(image, [], BodySide.DARKER) == []
    with pytest.raises(ValueError, match="expected pixels, found none"):
        colours_at(image[:0], [nowhere])
    with pytest.raises(ValueError, match="one for each centre"):
        _core.surrounds(image, np.zeros((2, 2)), [1.0], body_is_brighter=True)


@pytest.mark.parametrize(
    "distortion",
    [
        (0.0, 0.0, 0.0, 0.0),
        (-0.12, 0.05, 5e-4, -3e-4, 0.0),
        (0.2, -0.1, -1e-3, 2e-3, 0.05),
        (0.4, -0.2, 1e-3, -5e-4, 0.03, 0.5, -0.1, 0.02),
    ],
)
def test_the_lens_is_opencvs(distortion: tuple[float, ...]) -> None:
    matrix = np.array([[900.0, 0.0, 655.0], [0.0, 890.0, 350.0], [0.0, 0.0, 1.0]])
    lens = Lens(1280, 720, matrix, np.array(distortion))
    undistorted = np.random.default_rng(1).uniform((0, 0), (1280, 720), (200, 2))
    rays = np.column_stack([(undistorted - matrix[:2, 2]) / (900.0, 890.0), np.ones(200)])
    pixels = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0].reshape(-1, 2)
    assert lens.distort(undistorted) == pytest.approx(pixels, abs=1e-9)
    assert lens.undistort(pixels) == pytest.approx(undistorted, abs=1e-8)
    assert lens.undistort(np.empty((0, 2))).shape == (0, 2)


def test_a_lens_says_something_about_every_pixel() -> None:
    """Beyond what a strong barrel can show there is no inverse; the search for one ends all the same."""
    lens = Lens(640, 480, np.array([[300.0, 0, 320], [0, 300.0, 240], [0, 0, 1]]), np.array([-0.4, 0.0, 0.0, 0.0]))
    assert lens.undistort(np.array([[1e6, -1e6], [math.nan, 0.0], [math.inf, 1.0]])).shape == (3, 2)
    with pytest.raises(ValueError, match="8 coefficients"):
        _core.Lens(np.eye(3), np.zeros(12))
