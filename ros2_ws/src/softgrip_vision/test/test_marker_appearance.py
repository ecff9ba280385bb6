# SPDX-License-Identifier: Apache-2.0
"""Do five spots lie on one finger? Their size, light and surroundings tell."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from softgrip_vision.marker_appearance import BodySide, alike
from softgrip_vision.spots import Spot

GREEN, BODY, BENCH = (40, 160, 30), 190, 40
PLACES = [(40, 40), (100, 40), (160, 40), (220, 40), (280, 40)]


def picture(bodies: list[int]) -> np.ndarray:
    """Green discs of radius 9, each within a patch of a body of its own grey level."""
    image = np.full((80, 320, 3), BENCH, dtype=np.uint8)
    for (u, v), body in zip(PLACES, bodies, strict=True):
        cv2.circle(image, (u, v), 25, (body,) * 3, -1)
        cv2.circle(image, (u, v), 9, GREEN, -1)
    return image


def spots(areas: list[float], heights: list[float]) -> list[Spot]:
    return [
        Spot(u, v, 0.03, area, 1.0, 1.0, height, 0.0, 1.0)
        for (u, v), area, height in zip(PLACES, areas, heights, strict=True)
    ]


AREA, HEIGHT = [254.0] * 5, [120.0] * 5


@pytest.mark.parametrize(
    ("bodies", "areas", "heights", "one_finger"),
    [
        ([BODY] * 5, AREA, HEIGHT, True),
        ([BENCH, BODY, BODY, BODY, BODY], AREA, HEIGHT, True),  # the base marker sits on the mount
        ([BODY, BODY, BODY, BODY, BENCH], AREA, HEIGHT, False),  # the last one is something green on the bench
        ([BODY] * 5, [*AREA[:4], 1.3 * 254.0], HEIGHT, False),
        ([BODY] * 5, AREA, [*HEIGHT[:4], 40.0], True),  # in shadow
        ([BODY] * 5, AREA, [*HEIGHT[:4], 25.0], False),
    ],
)
def test_what_is_alike(bodies: list[int], areas: list[float], heights: list[float], *, one_finger: bool) -> None:
    side = alike(picture(bodies), spots(areas, heights))
    assert (side is not None) is one_finger


def test_the_side_that_tells_is_the_body() -> None:
    """Markers at the edge of a bright body before a dark bench, one of them before something bright as well."""
    image = np.full((80, 320, 3), BENCH, dtype=np.uint8)
    image[40:] = BODY
    image[:40, 260:] = 120
    for place in PLACES:
        cv2.circle(image, place, 9, GREEN, -1)
    assert alike(image, spots(AREA, HEIGHT)) is BodySide.BRIGHTER
    assert alike(255 - image, spots(AREA, HEIGHT)) is BodySide.DARKER
