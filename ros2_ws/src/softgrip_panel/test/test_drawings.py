# SPDX-License-Identifier: Apache-2.0
"""Nothing of a drawing lies outside its picture, whatever the step, the hand, the angle."""

from __future__ import annotations

import itertools
import math
import re
from xml.etree import ElementTree as ET

import pytest

from softgrip_panel.model.swap import HANDS_OUT, STEPS
from softgrip_panel.web.drawings import rig_drawing, swap_drawing

#: Letters of a path and the numbers that each takes.
_NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "Q": 4, "A": 7, "Z": 0}


def path_points(path: str) -> list[tuple[float, float]]:
    """Return the points of a path of absolute commands; a curve's control points, which hold it, are among them."""
    points: list[tuple[float, float]] = []
    for letter, rest in re.findall(r"([A-Za-z])([^A-Za-z]*)", path):
        numbers = [float(one) for one in re.findall(r"-?[\d.]+", rest)]
        assert len(numbers) == _NUMBERS[letter], path  # a relative command is none of them
        if letter == "H":
            points.append((numbers[0], points[-1][1]))
        elif letter == "V":
            points.append((points[-1][0], numbers[0]))
        elif letter == "A":
            points.append((numbers[5], numbers[6]))
        else:
            points += zip(numbers[::2], numbers[1::2], strict=True)
    return points


def points_of(part: ET.Element) -> list[tuple[float, float]]:
    """Return the points that one part reaches."""
    kind, number = part.tag.rpartition("}")[2], {k: float(v) for k, v in part.items() if k in _SIZES}
    assert "transform" not in part.attrib
    if kind == "path":
        return path_points(part.attrib["d"])
    if kind == "rect":
        x, y = number["x"], number["y"]
        return [(x, y), (x + number["width"], y + number["height"])]
    if kind == "circle":
        return [(number["cx"] + k * number["r"], number["cy"] + k * number["r"]) for k in (-1, 1)]
    if kind == "text":
        half = 0.6 * number["font-size"] * len(part.text or "") / 2.0  # letters are narrower than that
        return [(number["x"] - half, number["y"] - number["font-size"]), (number["x"] + half, number["y"] + 5.0)]
    assert kind == "g"
    return []


_SIZES = {"x", "y", "width", "height", "cx", "cy", "r", "font-size"}


def assert_whole(drawing: str) -> ET.Element:
    """Assert that every part, with half its stroke, lies inside the picture; return it."""
    root = ET.fromstring(drawing)
    left, top, width, height = (float(one) for one in root.attrib["viewBox"].split())
    for part in list(root.iter())[1:]:
        half = float(part.get("stroke-width", "0")) / 2.0
        for x, y in points_of(part):
            assert left + half <= x <= left + width - half, part.attrib
            assert top + half <= y <= top + height - half, part.attrib
    return root


@pytest.mark.parametrize("slots", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("step", [*STEPS, HANDS_OUT])
def test_a_step_of_a_swap_is_drawn_whole_with_every_slot(step: str, slots: int) -> None:
    root = assert_whole(swap_drawing(step, "<what>", slots))
    places = [float(one.attrib["x"]) for one in root.iter() if one.get("class") == "slot"]
    wide = [float(one.attrib["width"]) for one in root.iter() if one.get("class") == "slot"]
    assert len(places) == slots
    assert all(later - earlier > wide[0] for earlier, later in itertools.pairwise(places))


@pytest.mark.parametrize("degrees", range(10, 181, 5))
def test_the_rig_is_drawn_whole_with_a_stage_where_the_cable_ends(degrees: int) -> None:
    root = assert_whole(rig_drawing(math.radians(degrees), 1.25, "Cable"))
    (stage,) = [one for one in root.iter() if one.get("class") == "stage"]
    cable = [path_points(one.attrib["d"])[-1] for one in root.iter() if " A" in one.get("d", "")]
    carriage = path_points(stage[0].attrib["d"])
    middle = tuple(sum(one[k] for one in carriage[:2]) / 2.0 for k in (0, 1))
    assert middle == pytest.approx(cable[0], abs=0.2)
    # it leaves the surface as a tangent: what pulls has no lever but the radius
    centre, left = (210.0, 140.0), math.radians(degrees)
    radius = (math.cos(left), -math.sin(left))
    assert (middle[0] - centre[0]) * radius[0] + (middle[1] - centre[1]) * radius[1] == pytest.approx(55.0, abs=0.2)
