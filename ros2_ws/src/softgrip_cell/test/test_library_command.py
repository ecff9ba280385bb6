# SPDX-License-Identifier: Apache-2.0
"""The library's command line: export, edit, import, conflict, outcomes, audit."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.commands.library import main
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.storage import Database, Library


@pytest.fixture
def url(tmp_path: Path) -> str:
    place = f"sqlite:///{tmp_path}/cell.db"
    with Database(place) as database:
        library = Library(database, time.time_ns)
        library.import_catalogue(read_catalogue(), "test")
        library.import_finger_records(read_finger_records().values(), "test")
    return place


def test_a_file_goes_out_is_edited_and_comes_back(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    assert main(["--database-url", url, "export", str(first)]) == 0
    assert main(["--database-url", url, "export", str(second)]) == 0
    first.write_text(first.read_text().replace("mass_kg: 0.06\n", "mass_kg: 0.065\n", 1))
    assert main(["--database-url", url, "--who", "Ada", "import", str(first)]) == 0
    assert "written: egg" in capsys.readouterr().out
    second.write_text(second.read_text().replace("mass_kg: 0.06\n", "mass_kg: 0.07\n", 1))
    assert main(["--database-url", url, "--who", "Bob", "import", str(second)]) == 1
    assert "found 2 written by Ada" in capsys.readouterr().err
    assert main(["--database-url", url, "audit"]) == 0
    assert "Ada: save product egg {'version': 2}" in capsys.readouterr().out.splitlines()[0]


def test_fingers_go_out_and_come_back(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fingers.yaml"
    assert main(["--database-url", url, "finger", "PW-I-01", "retired"]) == 0
    assert main(["--database-url", url, "export-fingers", str(path)]) == 0
    assert read_finger_records(path)["PW-I-01"].state.value == "retired"
    assert main(["--database-url", url, "import-fingers", str(path)]) == 0
    assert "nothing, all is as in the database" in capsys.readouterr().out
    assert main(["--database-url", url, "finger", "PX-1", "store"]) == 1


def test_a_day_with_a_time_of_day_is_refused(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fingers.yaml"
    assert main(["--database-url", url, "export-fingers", str(path)]) == 0
    path.write_text(path.read_text().replace("calibrated: never", "calibrated: 2026-11-21 10:00:00", 1))
    assert main(["--database-url", url, "import-fingers", str(path)]) == 1
    assert "calibrated: expected a day as 2026-11-21, found datetime" in capsys.readouterr().err
    assert main(["--database-url", url, "export-fingers", str(path)]) == 0, "it can still be read"


def test_outcomes_are_listed_with_their_intervals(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--database-url", url, "outcomes"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "success 0.90" in lines["egg"]
    assert "failure 0.10" in lines["egg"]
    assert "partial 0.50" in lines["frozen_pizza"]


def test_a_new_product_is_classified_with_reasons(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["classify", "slab", "0.2", "0.1", "0.02"]) == 0
    assert capsys.readouterr().out.startswith("pinch (confidence 0.80)\n  200 x 100 x 20 mm slab: flat")
    assert main(["classify", "ball", "0.2", "0.2", "0.2"]) == 1
    assert "not graspable" in capsys.readouterr().err
