# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from softgrip_design.errors import DesignError
from softgrip_design.landmarks import joint_angles
from softgrip_design.trajectory import SHIPPED, FingerTrajectory, load


def test_angles_of_a_hand_bent_by_known_amounts() -> None:
    """A planar index finger whose bones turn by 30, 40 and 20 degrees."""
    landmarks = np.zeros((1, 21, 3))
    heading, point = 0.0, np.zeros(3)
    for index, turn in zip((5, 6, 7, 8), (0.0, 30.0, 40.0, 20.0), strict=True):
        heading += math.radians(turn)
        point = point + 0.03 * np.array([math.cos(heading), math.sin(heading), 0.0])
        landmarks[0, index] = point
    assert np.degrees(joint_angles(landmarks, "index"))[0] == pytest.approx([30.0, 40.0, 20.0])


@pytest.mark.parametrize(
    ("name", "closed_deg"),
    [("power", (70.0, 89.0, 50.0)), ("pinch", (42.0, 20.0, 24.0))],
)
def test_shipped_demonstrations_end_where_the_video_was_seen_to_end(name: str, closed_deg: tuple[float, ...]) -> None:
    """Expected: angles noted for these frames of the video by another person, about 5 degrees."""
    trajectory = load(SHIPPED / f"hand_{name}.csv")
    assert set(trajectory.angles) == {"thumb", "index", "middle", "ring", "little"}
    largest = trajectory.angles["index"][trajectory.angles["index"].sum(axis=1).argsort()[-8:]].mean(axis=0)
    assert np.degrees(largest) == pytest.approx(closed_deg, abs=6.0)
    assert "frames" in trajectory.origin["source"]


def test_a_closing_grows_and_begins_at_zero() -> None:
    closing = load(SHIPPED / "hand_power.csv").closing("index")
    assert closing[0].tolist() == [0.0, 0.0, 0.0]
    assert np.all(np.diff(closing.sum(axis=1)) >= 0.0)
    assert np.degrees(closing[-1].sum()) > 120.0


def test_a_trajectory_comes_back_from_its_file(tmp_path: Path) -> None:
    trajectory = FingerTrajectory(
        np.array([0.0, 0.5]), {"index": np.array([[0.1, 0.2], [0.3, 0.4]])}, {"source": "here: a"}
    )
    trajectory.save(tmp_path / "t.csv")
    again = load(tmp_path / "t.csv")
    assert again.times.tolist() == [0.0, 0.5]
    assert again.angles["index"].tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert again.origin == {"source": "here: a"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "header with time_s"),
        ("time_s,index_j0_rad\n", "rows after the header"),
        ("time_s,index_j0_rad\n0,0.1,0.2\n", "t.csv:2: expected 2 columns"),
        ("# a: b\ntime_s,index_j0_rad\n0,x\n", "t.csv:3: expected numbers"),
        ("time_s,speed\n0,1\n1,1\n", "columns like index_j0_rad"),
        ("time_s,index_j0_rad\n0,0.1\n1,nan\n", "gap at 1.000 s"),
        ("time_s,index_j0_rad\n1,0.1\n0,0.1\n", "growing times"),
        ("time_s,index_j0_rad\n0,0.1\n.03,0.1\n.06,0.2\n.6,0.3\n", "0.540 s between 0.060 s and 0.600 s"),
    ],
)
def test_wrong_files_are_refused_with_the_place(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(DesignError, match=said):
        load(tmp_path / "t.csv")
