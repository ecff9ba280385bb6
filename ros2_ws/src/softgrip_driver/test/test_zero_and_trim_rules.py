# SPDX-License-Identifier: Apache-2.0
"""Which stored zero holds, which file is believed, and how far a correction may go."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, MotionStep
from softgrip_driver.tendon.session import ZeroKeeper
from softgrip_driver.tendon.trajectory import MAX_POINTS, TendonTrajectory
from softgrip_driver.tendon.trim import Trim
from softgrip_driver.tendon.units import Spool
from softgrip_driver.tendon.zero_store import StoredZero, ZeroStore

DT = 0.01
ZERO = StoredZero("XL330 id 1", 0.01, 1, -0.0123, 3, "2026-01-01T00:00:00+00:00", 2)


class Loop:
    """One drive whose device shows a mark, and what it was told."""

    def __init__(self, mark: int, zero: float | None = None) -> None:
        self.session_mark, self.zero = mark, zero
        self.marked: list[int] = []
        self.drives = {"index": self}

    def call(self, request):  # type: ignore[no-untyped-def]
        return request(self, 0.0)

    def set_zero(self, position: float, mark: int) -> None:
        assert mark
        self.zero = position

    def mark_session(self, tendon: str, mark: int) -> None:
        assert tendon == "index"
        self.marked.append(mark)


class Identity:
    tendon, device = "index", ZERO.device


SPOOL = Spool(0.01, 1)


def keeper(store: ZeroStore, spool: Spool = SPOOL) -> ZeroKeeper:
    return ZeroKeeper(store, [Identity()], {"index": spool})  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("stored", "spool", "mark", "valid"),
    [
        (ZERO, Spool(0.01, 1), 3, True),
        (ZERO, Spool(0.01, -1), 3, False),
        (ZERO, Spool(0.011, 1), 3, False),
        (ZERO, Spool(0.01, 1), 0, False),
        (replace(ZERO, device="XL330 id 2"), Spool(0.01, 1), 3, False),
    ],
    ids=["the same", "wound the other way", "another radius", "restarted", "another servo"],
)
def test_a_zero_holds_for_its_own_servo_spool_and_session(
    tmp_path: Path, stored: StoredZero, spool: Spool, mark: int, valid: bool
) -> None:
    store, loop = ZeroStore(tmp_path / "zeros.yaml"), Loop(mark)
    store.save({"index": stored})
    (recalled,) = keeper(store, spool).recall(loop)  # type: ignore[arg-type]
    assert recalled.valid is valid
    assert (loop.zero == ZERO.position) is valid


def test_each_homing_leaves_another_mark_and_the_same_zero_none(tmp_path: Path) -> None:
    """The mark of an old homing must not vouch for a new zero."""
    store, loop = ZeroStore(tmp_path / "zeros.yaml"), Loop(0)
    kept = keeper(store)
    kept.recall(loop)  # type: ignore[arg-type]
    for number in range(4):
        loop.zero = 0.001 * number
        kept.save_zeros(loop, "now")  # type: ignore[arg-type]
        kept.save_zeros(loop, "now")  # type: ignore[arg-type]
    assert len(loop.marked) == len(set(loop.marked)) == 4
    assert store.load()["index"].mark == loop.marked[-1]


@pytest.mark.parametrize("schema", [0, 2, "1"])
def test_a_whole_file_of_another_schema_is_refused(tmp_path: Path, schema: Any) -> None:
    path = tmp_path / "zeros.yaml"
    ZeroStore(path).save({"index": ZERO})
    body = {"schema": schema, "zeros": yaml.safe_load(path.read_text())["zeros"]}
    digest = hashlib.sha256(yaml.safe_dump(body, sort_keys=True).encode()).hexdigest()
    path.write_text(yaml.safe_dump({**body, "sha256": digest}))
    with pytest.raises(ConfigurationError, match="expected schema 1"):
        ZeroStore(path).load()


# --- trajectories that a driver must not take ----------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "taken"), [(0.05, True), (-0.05, True), (0.051, False), (-0.051, False)])
def test_no_point_of_a_trajectory_goes_faster_than_the_drive(speed: float, taken: bool) -> None:
    limits = TendonLimits()
    if taken:
        TendonTrajectory.checked([1.0, 2.0], [0.01, 0.02], [0.0, speed], limits.travel, limits.speed)
        return
    with pytest.raises(ConfigurationError, match=r"expected velocities up to 0\.05"):
        TendonTrajectory.checked([1.0, 2.0], [0.01, 0.02], [0.0, speed], limits.travel, limits.speed)


@pytest.mark.parametrize(("points", "taken"), [(2000, True), (2001, False)])
def test_a_plan_of_more_than_2000_points_has_to_be_streamed(points: int, taken: bool) -> None:
    assert MAX_POINTS == 2000
    times = [0.01 * (number + 1) for number in range(points)]
    if taken:
        assert TendonTrajectory.checked(times, [0.01] * points, [], 0.035, 0.05).duration == pytest.approx(20.0)
        return
    with pytest.raises(ConfigurationError, match="at most 2000 points"):
        TendonTrajectory.checked(times, [0.01] * points, [], 0.035, 0.05)


# --- the correction of a set-point ---------------------------------------------------------------------------------


def corrected(trim: Trim, error: float, seconds: float, tension: float = 5.0) -> float:
    for number in range(round(seconds / DT)):
        seen = DriveObservation(number * DT, DT, 0.010 - error, 0.0, tension=tension, pull=tension, tension_cap=45.0)
        trim.step(MotionStep(0.010, 20.0), seen)
    return trim.value


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(("tension", "end"), [(0.0, 3e-3), (15.0, 4.5e-3)])
def test_a_correction_goes_towards_the_target_and_ends_at_3_mm_and_a_tenth_a_newton(
    way: float, tension: float, end: float
) -> None:
    """6 / s of the error: 1 mm makes 3 mm in half a second."""
    trim = Trim(max_following_error=0.006)
    assert corrected(trim, way * 1e-3, 0.1, tension) == pytest.approx(way * 0.6e-3)
    assert corrected(trim, way * 1e-3, 5.0, tension) == pytest.approx(way * end)


def test_at_the_tension_limit_nothing_winds_up() -> None:
    assert corrected(Trim(max_following_error=0.006), 1e-3, 1.0, tension=19.5) == 0.0


def test_cleared_it_adds_nothing() -> None:
    trim = Trim(max_following_error=0.006)
    corrected(trim, 1e-3, 0.2)
    trim.clear()
    assert trim.value == 0.0


@pytest.mark.parametrize(("tension", "kept"), [(5.0, 1.0), (20.0, 0.5), (40.0, 0.25)])
def test_whoever_stops_goes_on_with_the_share_of_its_pull_that_is_allowed(tension: float, kept: float) -> None:
    """10 N are allowed; proportional control pulls by how far the goal is ahead: 2 mm."""
    trim = Trim(max_following_error=0.006)
    trim.keep_pulling(0.002, 0.0, tension, 10.0)
    assert trim.value == pytest.approx(0.002 * kept)
