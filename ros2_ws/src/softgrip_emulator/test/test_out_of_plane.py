# SPDX-License-Identifier: Apache-2.0
"""A finger that leaves its plane: against rotations in space, Saint-Venant's torsion, the camera's projection."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from softgrip_emulator.camera.optics import draw_optics
from softgrip_emulator.plant.fingers import FingerBank
from softgrip_emulator.plant.out_of_plane import leave_plane, torsional_stiffness, twist


def bent(finger):
    """A finger half closed: joints and tip, directions."""
    bank = FingerBank([finger])
    for step in range(1500):
        bank.step(np.array([0.012 * step / 1500]), 1e-3)
    joints_m, headings = bank.chain()
    return joints_m[0], headings[0]


def test_a_rolled_finger_is_turned_about_its_axis(plain_finger):
    joints_m, headings = bent(plain_finger())
    rolled = replace(plain_finger(), mounting_roll_rad=0.2)
    points = leave_plane(rolled, joints_m, headings, np.zeros(3))
    rotation, _ = cv2.Rodrigues(np.array([0.2, 0.0, 0.0]))
    expected = np.column_stack([joints_m, np.zeros(4)]) @ rotation.T
    assert points == pytest.approx(expected, abs=1e-12)


def test_twisted_strips_turn_what_lies_beyond_about_their_links(plain_finger):
    finger = plain_finger()
    joints_m, headings = bent(finger)
    turns = np.array([0.004, -0.002, 0.003])
    points = leave_plane(finger, joints_m, headings, turns)
    flat = np.column_stack([joints_m, np.zeros(4)])
    expected = flat.copy()
    for joint, (heading, turn) in enumerate(zip(headings, turns, strict=True)):
        rotation, _ = cv2.Rodrigues(turn * np.array([np.cos(heading), -np.sin(heading), 0.0]))
        expected[joint + 1 :] += (flat[joint + 1 :] - flat[joint]) @ (rotation - np.eye(3)).T
    # To first order: what is left is of the order of a square of a turn times a length.
    assert points == pytest.approx(expected, abs=2e-6)
    assert np.abs(points[:, 2]).max() > 5e-5


def test_a_strip_twists_as_saint_venant_says(plain_finger):
    finger = plain_finger()
    # J = beta w h^3; Timoshenko's table has beta = 0.281 for w / h = 4 and 0.291 for 5, so 0.284 for 13 / 3
    shear_pa, beta = 21.89e6 / 2.0, 0.284
    assert torsional_stiffness(finger) == pytest.approx(beta * 0.013 * 0.003**3 * shear_pa / 0.010, rel=0.01)
    aside = replace(finger, cable_aside_m=np.array([1e-4, 0.0, -1e-4]))
    turned = twist(aside, np.array([0.5, 0.5, 0.5]), np.array([10.0, 8.0, 6.0]), 0.0)
    assert turned * torsional_stiffness(finger) == pytest.approx(np.sin(0.5) * np.array([1e-3, 0.0, -6e-4]))


def test_a_point_beside_the_plane_is_seen_where_its_ray_meets_the_plane():
    optics = draw_optics(640, 480, 3)
    # Rotation and place of the plane from the homography, as any textbook takes them apart.
    columns = np.linalg.solve(optics.matrix, optics.homography)
    columns /= np.linalg.norm(columns[:, 0])
    rotation = np.column_stack([columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1])])
    # Towards the camera is against its view, whichever way the plane's normal points.
    towards = -np.sign(rotation[2, 2])
    for point in ([0.05, -0.03, 0.004], [0.0, 0.0, -0.006], [0.09, -0.06, 0.010]):
        in_camera = rotation @ np.array([point[0], point[1], towards * point[2]]) + columns[:, 2]
        seen = optics.in_plane(np.array([point]))[0]
        in_plane = rotation @ np.array([*seen, 0.0]) + columns[:, 2]
        # the plane of a calibrated homography is not exactly a rotation's
        assert in_plane[:2] / in_plane[2] == pytest.approx(in_camera[:2] / in_camera[2], abs=1e-7)
