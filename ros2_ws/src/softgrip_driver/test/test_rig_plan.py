# SPDX-License-Identifier: Apache-2.0
"""Plans of a measurement, and the file of the pulley."""

import math

import pytest

from softgrip_driver.errors import ConfigurationError, DriverError
from softgrip_driver.rig import plan
from softgrip_driver.rig.plan import Point, points_of
from softgrip_driver.rig.pulley import Pulley, read_pulley, write_pulley


def test_plans():
    nine = points_of("9")
    assert len(nine) == 9
    assert {round(math.degrees(p.angle)) for p in nine} == {10, 50, 90}
    assert {p.load for p in nine} == {0.2, 0.6, 1.0}
    assert len(points_of("45")) == 45
    assert points_of("custom", (0.1,) * 4, (0.2,) * 4)[0] == Point(0.1, 0.2)
    assert set(plan.PLANS) == {"9", "45", "adaptive", "custom", "pulley"}


@pytest.mark.parametrize(
    ("name", "angles", "loads", "reason"),
    [
        ("seven", (), (), "expected one of"),
        ("custom", (0.1, 0.2), (0.2,), "as many angles as loads"),
        ("custom", (0.1, 0.2, 0.3), (0.2, 0.2, 0.3), "at least 4"),
        ("custom", (0.1, 0.2, 90.0, 0.3), (0.2, 0.2, 0.2, 0.2), "point 3"),
        ("custom", (0.1, 0.2, 0.3, 0.4), (0.2, 200.0, 0.2, 0.2), "point 2"),
    ],
)
def test_impossible_plans_are_refused(name, angles, loads, reason):
    with pytest.raises(ConfigurationError, match=reason):
        points_of(name, angles, loads)


def test_the_pulley_file(tmp_path):
    assert read_pulley(tmp_path) is None
    write_pulley(tmp_path, Pulley(1.012, 0.002))
    assert read_pulley(tmp_path) == Pulley(1.012, 0.002)
    (tmp_path / "pulley.calibration").write_text("ratio: 7\nstddev: 0\n")
    with pytest.raises(ConfigurationError, match="calibrate the pulley again"):
        read_pulley(tmp_path)
    (tmp_path / "pulley.calibration").write_text("no")
    with pytest.raises(DriverError, match="expected ratio"):
        read_pulley(tmp_path)
