# SPDX-License-Identifier: Apache-2.0
"""Every small file that a node keeps: a power cut at any moment leaves the old one or the new one, whole."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from softgrip_bag import metadata
from softgrip_driver.rig.journal import MeasuredPoint, PlanJournal, Request
from softgrip_driver.rig.pulley import Pulley, write_pulley
from softgrip_driver.tendon.zero_store import StoredZero, ZeroStore
from softgrip_model.friction.model_file import write_model
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.store import ModelStore
from softgrip_model.profile.files import load_directory, save, shipped_directory

ZERO = StoredZero("XL330-M288/1200 id 1 fw 52", 0.01, 1, -0.0123, 3, "2026-01-01T00:00:00+00:00", 2)
PROFILE = load_directory(shipped_directory())["power"]
MODEL = dataclasses.replace(published(published_ids()[0]), id="measured")


def activate(folder: Path, number: int) -> None:
    ModelStore(folder).activate(published_ids()[number])


#: file -> what writes it in a folder; called with 0 for the old content and with 1 for the new one.
WRITERS: dict[str, Callable[[Path, int], Any]] = {
    "active": activate,
    "measured.yaml": lambda folder, n: write_model(dataclasses.replace(MODEL, points=n), folder / "measured.yaml"),
    "power.yaml": lambda folder, n: save(dataclasses.replace(PROFILE, title=f"{n}"), folder / "power.yaml"),
    "zeros.yaml": lambda folder, n: ZeroStore(folder / "zeros.yaml").save({f"t{n}": ZERO}),
    "pulley.calibration": lambda folder, n: write_pulley(folder, Pulley(1.0 + 0.1 * n, 0.01)),
    "metadata.yaml": lambda folder, n: metadata.write(folder, {"version": n}),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_power_cut_leaves_the_old_file_or_the_new_one(tmp_path, volatile_disk, name):
    write = WRITERS[name]
    write(tmp_path, 0)
    old = (tmp_path / name).read_bytes()
    disk = volatile_disk()
    write(tmp_path, 1)
    new = (tmp_path / name).read_bytes()
    assert new != old
    assert disk.moments
    for outcomes in disk.moments:
        assert {found.get(name) for found in outcomes} <= {old, new}
    assert [found.get(name) for found in disk.after_power_cut()] == [new, new]


def test_a_plan_and_its_points_outlive_a_power_cut(tmp_path, volatile_disk):
    disk = volatile_disk()
    journal = PlanJournal.create(tmp_path / "plans", "p1", Request("quick"))
    for index in range(3):
        journal.accept(MeasuredPoint(index, 1.0, 0.1, 1.0, 1.2))
        for found in disk.after_power_cut():
            assert found["plans/p1.jsonl"].count(b'"accepted"') == index + 1


def test_the_files_are_readable(tmp_path):
    for write in WRITERS.values():
        write(tmp_path, 1)
    assert yaml.safe_load((tmp_path / "metadata.yaml").read_text())["rosbag2_bagfile_information"] == {"version": 1}
    assert ModelStore(tmp_path).active == published_ids()[1]
