# SPDX-License-Identifier: Apache-2.0
"""What is drawn over the hand: where cables run, how tensions are coloured, how large contacts are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softgrip_description.overlay import (
    FULL_TENSION_N,
    SMALLEST_CONTACT_N,
    cable_picture,
    contact_diameter_m,
    measured_line_m,
    tension_colour,
)
from softgrip_model.profile import FingerDesign, load, shipped_directory


@pytest.fixture
def design() -> FingerDesign:
    return load(shipped_directory() / "power.yaml").finger("index")


def test_the_routing_points_of_a_closed_groove_lie_on_one_flank(design: FingerDesign) -> None:
    """The flanks of a hinge's groove meet when it has closed: the two points differ by their radii alone."""
    line = cable_picture(design, design.openings_rad, np.zeros((design.joints, 2)), [])
    for j in range(design.joints):
        entry, leave = line.points_m[2 * j : 2 * j + 2]
        before, behind = design.routing_radii_m[2 * j : 2 * j + 2]
        assert np.linalg.norm(leave - entry) == pytest.approx(abs(before - behind), abs=1e-12)


def test_a_straight_fingers_cable_runs_below_its_joints(design: FingerDesign) -> None:
    line = cable_picture(design, [0.0] * design.joints, np.zeros((design.joints, 2)), [])
    assert np.all(np.diff(line.points_m[:, 0]) > 0.0)
    assert np.all(line.points_m[:, 1] < 0.0)  # fingers close towards -y
    assert np.all(line.points_m[:, 2] == 0.0)
    at = np.cumsum((0.0, *design.link_lengths_m[:-1]))
    middles = 0.5 * (line.points_m[::2, 0] + line.points_m[1::2, 0])
    half = np.sin(0.5 * np.array(design.openings_rad))
    radii = np.array(design.routing_radii_m).reshape(-1, 2)
    assert middles == pytest.approx(at + 0.5 * half * (radii[:, 1] - radii[:, 0]))


def test_a_flexure_that_gives_takes_the_cable_beyond_along(design: FingerDesign) -> None:
    angles = [0.2] * design.joints
    still = np.zeros((design.joints, 2))
    moved = still.copy()
    moved[0] = (0.0005, 0.001)
    difference = cable_picture(design, angles, moved, []).points_m - cable_picture(design, angles, still, []).points_m
    assert difference[0] == pytest.approx([0.0, 0.0, 0.0])
    assert difference[1:] == pytest.approx(np.tile([0.0005, -0.001, 0.0], (2 * design.joints - 1, 1)))


def test_spans_are_coloured_by_their_own_tensions(design: FingerDesign) -> None:
    tensions_n = [9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0]
    colours = cable_picture(design, [0.0] * 3, np.zeros((3, 2)), tensions_n).colours
    assert colours == [tension_colour(tension_n) for tension_n in tensions_n[1:-1]]
    reds = [red for red, _, _, _ in colours]
    assert reds == sorted(reds, reverse=True)
    assert len(set(reds)) == 5


@pytest.mark.parametrize("tensions_n", [[], [5.0], [5.0] * 9])
def test_a_cable_whose_tensions_are_not_known_is_grey(design: FingerDesign, tensions_n: list[float]) -> None:
    colours = cable_picture(design, [0.0] * 3, np.zeros((3, 2)), tensions_n).colours
    assert len(colours) == 5
    assert set(colours) == {tension_colour(math.nan)}
    red, green, blue, alpha = colours[0]
    assert red == green == blue
    assert alpha == 1.0


def test_slack_is_blue_and_full_tension_red() -> None:
    slack, full = tension_colour(0.0), tension_colour(FULL_TENSION_N)
    assert slack[2] > slack[0]
    assert full[0] > full[2]
    assert tension_colour(-0.3) == slack
    assert tension_colour(2.0 * FULL_TENSION_N) == full


def test_a_contact_grows_with_the_tension_beyond_the_free_motions() -> None:
    assert contact_diameter_m(12.0, 4.0) == pytest.approx(0.008)
    assert contact_diameter_m(4.0 + 0.9 * SMALLEST_CONTACT_N, 4.0) == 0.0
    assert contact_diameter_m(2.0, 4.0) == 0.0
    assert contact_diameter_m(math.nan, 4.0) == 0.0
    assert contact_diameter_m(12.0, math.nan) == 0.0


def test_the_measured_finger_ends_at_the_measured_tip(design: FingerDesign) -> None:
    line = measured_line_m(design, [0.0, 0.0, 0.5 * math.pi], (0.07, -0.02))
    first, second, _ = design.link_lengths_m
    assert line[:, 2] == pytest.approx(np.zeros(4))
    assert line[:3, :2] == pytest.approx(np.array([[0.0, 0.0], [first, 0.0], [first + second, 0.0]]))
    assert line[3, :2].tolist() == [0.07, -0.02]
