# SPDX-License-Identifier: Apache-2.0
"""What docs/glossary.md names exists: message fields, Python names, former names of parameters and files."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from softgrip_cell.yaml_fields import PRESENT_NAMES
from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
INTERFACES = ROOT / "ros2_ws/src/softgrip_interfaces"
vocabulary = load_script(ROOT / "tools/vocabulary.py")
NODES = {
    "grasp_mix_manager": "softgrip_cell.nodes.parameters",
    "marker_tracker": "softgrip_vision.nodes.marker_tracker",
    "friction_rig": "softgrip_driver.nodes.rig_parameters",
    "tendon_driver": "softgrip_driver.nodes.tendon_parameters",
}


def rows(section: str) -> Iterator[dict[str, str]]:
    """Give the rows of a section's table by column."""
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
    lines = [line.strip()[1:-1].split("|") for line in text.splitlines() if line.startswith("|")]
    header = [cell.strip() for cell in lines[0]]
    for cells in lines[2:]:
        yield dict(zip(header, [cell.strip() for cell in cells], strict=True))


TERMS = [row for section in ("Quantities", "Things", "States and events") for row in rows(section)]


@pytest.mark.parametrize("row", [row for row in TERMS if row["message field"]], ids=lambda row: row["term"])
def test_a_message_field_of_the_glossary_exists(row: dict[str, str]) -> None:
    message, field = row["message field"].split(".")
    (path,) = INTERFACES.glob(f"*/{message}.*")
    assert re.search(rf"\s{field}\b", path.read_text(encoding="utf-8")), f"{path.name} has no {field}"


def test_the_python_names_of_the_glossary_exist() -> None:
    source = {
        name for path in vocabulary.python_files() if "src" in path.parts for name in vocabulary.identifiers(path)
    }
    named = {row["Python name"].strip("`") for row in TERMS}
    assert named - source == set()


def test_former_names_of_parameters_are_those_of_the_tables() -> None:
    for row in rows("Former names"):
        former, present, where = row["former"].strip("`"), row["present"].strip("`"), row["where"]
        if where.startswith("parameter of "):
            table = importlib.import_module(NODES[where.removeprefix("parameter of ")]).PARAMETERS
            assert {(one.former, one.name) for one in table.rows} >= {(former, present)}
        else:
            assert PRESENT_NAMES[former] == present


def test_every_former_name_is_in_the_glossary() -> None:
    listed = {row["former"].strip("`") for row in rows("Former names")}
    assert set(PRESENT_NAMES) <= listed
    for module in NODES.values():
        assert {one.former for one in importlib.import_module(module).PARAMETERS.rows if one.former} <= listed
