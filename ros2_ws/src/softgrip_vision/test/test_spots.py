# SPDX-License-Identifier: Apache-2.0
"""Colour signal and spot measurement on drawn images with known centres."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_vision.colour import ColourModel, hue_of
from softgrip_vision.spots import Window, find_spots, window_around

GREEN = ColourModel(120.0)


def disc(u: float, v: float, radius: float = 9.0, size: int = 48, fine: int = 8) -> np.ndarray:
    """A green disc on grey by supersampled coverage."""
    at = (np.arange(size * fine) + 0.5) / fine - 0.5
    x, y = np.meshgrid(at - u, at - v)
    cover = ((x**2 + y**2) <= radius**2).reshape(size, fine, size, fine).mean(axis=(1, 3))[:, :, None]
    image = 150.0 + cover * (np.array([60.0, 190.0, 50.0]) - 150.0)
    return np.rint(image).astype(np.uint8)


def whole(image: np.ndarray) -> Window:
    return Window(0, 0, image.shape[1], image.shape[0])


def test_signal_of_green_is_green_over_the_others() -> None:
    random = np.random.default_rng(1)
    image = random.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    blue, green, red = (image[:, :, c].astype(float) for c in range(3))
    assert GREEN.signal(image) == pytest.approx(green - np.maximum(red, blue), abs=1e-3)


def test_grey_has_no_signal() -> None:
    grey = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    for hue in range(0, 360, 15):
        assert np.abs(ColourModel(float(hue)).signal(grey)).max() < 1e-3


@given(hue=st.floats(0.0, 359.9))
def test_hue_agrees_with_hsv(hue: float) -> None:
    """On the hexagon's corners exactly; between them the two definitions differ by 1.1 deg at most."""
    red, green, blue = colorsys.hsv_to_rgb(hue / 360, 0.8, 0.9)
    turn = (hue_of(np.array([blue, green, red])) - hue + 180) % 360 - 180
    assert abs(turn) < 1.2


@pytest.mark.parametrize("noise", [6.0, 12.0])
def test_deviation_is_that_of_noisy_pictures(noise: float) -> None:
    """Neighbouring pixels share their noise, as demosaicing and JPEG have it: four act as one."""
    random = np.random.default_rng(3)
    clean = disc(23.3, 24.6).astype(float)
    centres, deviations = [], []
    for _ in range(150):
        shared = np.kron(random.normal(0.0, noise, (24, 24, 3)), np.ones((2, 2, 1)))
        image = np.clip(np.rint(clean + shared), 0, 255).astype(np.uint8)
        ((spot,),) = find_spots(image, [whole(image)], GREEN, [40.0], (50.0, 1000.0))
        centres.append((spot.u, spot.v))
        deviations.append(spot.stddev_px)
    true = np.std(centres, axis=0).mean()
    assert true < np.median(deviations) < 3.0 * true  # rather too large than too small: the edge is less noisy


def test_a_neighbour_in_the_corner_does_not_pull() -> None:
    """Its pixels lie in the spot's own box."""
    image = np.minimum(disc(18.2, 17.7), disc(34.0, 34.0))
    image[:, :, 1] = np.maximum(disc(18.2, 17.7), disc(34.0, 34.0))[:, :, 1]
    (spots,) = find_spots(image, [whole(image)], GREEN, [40.0], (50.0, 1000.0))
    assert len(spots) == 2
    assert (spots[0].u, spots[0].v) == pytest.approx((18.2, 17.7), abs=0.1)
    assert (spots[1].u, spots[1].v) == pytest.approx((34.0, 34.0), abs=0.1)


@settings(max_examples=40, deadline=None)
@given(u=st.floats(20.0, 27.0), v=st.floats(20.0, 27.0))
def test_centre_of_a_disc(u: float, v: float) -> None:
    ((spot,),) = find_spots(disc(u, v), [Window(0, 0, 48, 48)], GREEN, [40.0], (50.0, 1000.0))
    assert (spot.u, spot.v) == pytest.approx((u, v), abs=0.1)
    assert spot.area_px == pytest.approx(np.pi * 81, rel=0.06)
    assert spot.roundness > 0.97
    assert spot.solidity > 0.97


def test_stated_deviation_is_what_noise_does() -> None:
    """Independent noise: the spread of the centres over 300 draws against what each spot states."""
    random = np.random.default_rng(4)
    clean = disc(23.3, 24.1).astype(float)
    spots = []
    for _ in range(300):
        noisy = np.clip(np.rint(clean + random.normal(0, 8.0, clean.shape)), 0, 255).astype(np.uint8)
        (found,) = find_spots(noisy, [Window(0, 0, 48, 48)], GREEN, [40.0], (50.0, 1000.0))
        spots += found
    assert len(spots) == 300
    observed = np.std([(spot.u, spot.v) for spot in spots], axis=0).mean()
    stated = np.mean([spot.stddev_px for spot in spots])
    assert observed < stated < 5.0 * observed


def test_a_spot_cut_by_the_window_is_none() -> None:
    image = disc(23.0, 24.0)
    assert find_spots(image, [Window(0, 0, 26, 48)], GREEN, [40.0], (50.0, 1000.0)) == [[]]


def test_shade_across_a_marker_does_not_pull_its_centre() -> None:
    image = disc(23.0, 24.0).astype(float)
    image *= np.linspace(1.0, 0.75, 48)[None, :, None]
    ((spot,),) = find_spots(np.rint(image).astype(np.uint8), [whole(image)], GREEN, [40.0], (50.0, 1000.0))
    assert (spot.u, spot.v) == pytest.approx((23.0, 24.0), abs=0.1)


def test_windows_looked_at_together_show_what_each_shows_alone() -> None:
    """Overlapping ones, cut ones, ones of other sizes and thresholds, at the image's border too."""
    random = np.random.default_rng(7)
    image = np.full((200, 300, 3), 120.0)
    for _ in range(60):
        u, v = random.uniform(0, 300), random.uniform(0, 200)
        corner = max(0, int(v) - 24), max(0, int(u) - 24)
        patch = disc(u - corner[1], v - corner[0], random.uniform(5.0, 10.0))
        part = image[corner[0] : corner[0] + 48, corner[1] : corner[1] + 48]
        green = (patch[:, :, 1] != 150)[: part.shape[0], : part.shape[1]]
        part[green] = patch[: part.shape[0], : part.shape[1]][green]
    image = np.clip(np.rint(image + random.normal(0, 3.0, image.shape)), 0, 255).astype(np.uint8)
    places = random.uniform((0, 0), (300, 200), (40, 2))
    windows = [w for place in places if (w := window_around(place, random.uniform(15.0, 60.0), (300, 200)))]
    thresholds = random.uniform(20.0, 80.0, len(windows)).tolist()
    together = find_spots(image, windows, GREEN, thresholds, (50.0, 500.0))
    alone = [find_spots(image, [w], GREEN, [t], (50.0, 500.0))[0] for w, t in zip(windows, thresholds, strict=True)]
    assert together == alone
    assert sum(len(spots) for spots in alone) > len(windows) / 2


def test_a_crowd_of_specks_does_not_exhaust_the_labels() -> None:
    """More components than 16 bits can number, and one spot after them all."""
    image = np.full((560, 560, 3), 120, np.uint8)
    image[1:500:2, 1::2] = (60, 190, 50)
    image[510:558, 500:548] = disc(23.0, 24.0)
    ((spot,),) = find_spots(image, [whole(image)], GREEN, [40.0], (50.0, 1000.0))
    assert (spot.u, spot.v) == pytest.approx((523.0, 534.0), abs=0.1)


def test_other_colours_are_not_seen() -> None:
    for colour in ((60, 60, 200), (200, 60, 60), (60, 200, 200)):  # red, blue, yellow
        image = np.full((48, 48, 3), 120, np.uint8)
        image[16:32, 16:32] = colour
        assert find_spots(image, [whole(image)], GREEN, [15.0], (50.0, 1000.0)) == [[]]


def test_windows_stay_in_the_image() -> None:
    assert window_around((2.0, 3.0), 10.0, (640, 480)) == Window(0, 0, 13, 14)
    assert window_around((-50.0, 3.0), 10.0, (640, 480)) is None
