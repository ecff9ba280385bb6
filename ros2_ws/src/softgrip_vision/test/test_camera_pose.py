# SPDX-License-Identifier: Apache-2.0
"""The camera's pose by a plane: what it is put at comes back, from either side of the finger."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from softgrip_vision.calibration import FingerPlane, Lens
from softgrip_vision.camera_pose import camera_pose

LENS = Lens(1280, 720, np.array([[1150.0, 0.0, 651.0], [0.0, 1140.0, 349.0], [0.0, 0.0, 1.0]]), np.zeros(5))


def plane_of(rotation: Rotation, position: np.ndarray, factor: float = 1.0) -> FingerPlane:
    """The plane z = 0 as a camera at a position in the finger's base frame sees it; rotation: of its axes there."""
    into = rotation.as_matrix().T
    homography = LENS.matrix @ np.column_stack([into[:, 0], into[:, 1], -into @ position])
    return FingerPlane("index", factor * homography, 0.02, 0.005)


@given(
    st.tuples(*[st.floats(-0.4, 0.4)] * 3),
    st.tuples(*[st.floats(-0.1, 0.1)] * 2),
    st.sampled_from([-1.0, 1.0]),
    st.floats(0.1, 1.0),
    st.sampled_from([-3.0, 0.01, 1.0]),
)
def test_a_camera_is_found_where_it_was_put(
    tilt: tuple[float, ...], beside: tuple[float, ...], side: float, distance: float, factor: float
) -> None:
    # from +z the camera looks along -z of the base, half a turn about x; from -z along +z
    facing = Rotation.from_rotvec([np.pi, 0.0, 0.0] if side > 0.0 else [0.0, 0.0, 0.0])
    rotation = facing * Rotation.from_rotvec(tilt)
    position = rotation.apply([0.0, 0.0, -distance]) + np.array([*beside, 0.0])
    depth = (-rotation.as_matrix().T @ position)[2]
    if depth < 0.02:
        return  # the base lies behind such a camera
    found = camera_pose(LENS, plane_of(rotation, position, factor))
    assert found[:3, 3] == pytest.approx(position, abs=1e-9)
    assert found[:3, :3] == pytest.approx(rotation.as_matrix(), abs=1e-9)


def test_a_plane_with_errors_gives_a_rotation_all_the_same() -> None:
    rotation, position = Rotation.from_rotvec([np.pi, 0.0, 0.1]), np.array([0.05, -0.03, 0.4])
    good = plane_of(rotation, position)
    errors = np.array([[1.01, 0.99, 1.0], [1.0, 1.01, 1.0], [1.02, 1.0, 1.0]])
    found = camera_pose(LENS, FingerPlane("index", good.homography * errors, 0.02, 0.005))
    assert found[:3, :3] @ found[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert found[:3, 3] == pytest.approx(position, abs=0.02)
    assert (Rotation.from_matrix(found[:3, :3]).inv() * rotation).magnitude() < 0.1
