# SPDX-License-Identifier: Apache-2.0
"""docs/cell.md: its command lines fit the interfaces, its table is the code's, the tests that it names are there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
import yaml

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).parents[4]
PAGE = ROOT / "docs" / "cell.md"
CALL = re.compile(r'ros2 (?:service call|action send_goal)(?: --feedback)? (\S+) (\S+)/(srv|action)/(\S+) "(.*)"')
CALLS = CALL.findall(re.sub(r" *\\\n *", " ", PAGE.read_text()))  # a long line goes on below
SERVED = {
    "/cell/confirm_step",
    "/cell/grasp",
    "/cell/list_fingers",
    "/cell/list_grasps",
    "/cell/list_products",
    "/cell/plan_mix",
    "/cell/retire_finger",
    "/cell/select_product",
    "/cell/swap",
    "/cell/write_audit",
}


def test_every_service_and_action_of_the_cell_is_shown() -> None:
    assert {name for name, *_ in CALLS} >= SERVED
    nodes = ROOT / "ros2_ws" / "src" / "softgrip_cell" / "softgrip_cell" / "nodes"
    code = "".join(path.read_text() for path in nodes.glob("*.py"))
    assert {f"/{name}" for name in re.findall(r'"(cell/\w+)"', code)} - {"/cell/state", "/cell/swap_progress"} == SERVED


@pytest.mark.parametrize(("name", "package", "kind", "interface", "text"), CALLS)
def test_a_documented_call_fits_its_interface(name: str, package: str, kind: str, interface: str, text: str) -> None:
    found = getattr(importlib.import_module(f"{package}.{kind}"), interface)
    request = found.Request if kind == "srv" else found.Goal
    fields = yaml.safe_load(text)
    message = request(**fields)
    assert set(fields) <= set(request.get_fields_and_field_types())
    for field, value in fields.items():
        assert type(getattr(message, field)) is type(value) or list(getattr(message, field)) == value


def test_console_scripts_are_those_of_the_page() -> None:
    scripts = re.findall(r"ros2 run softgrip_cell (\w+)", PAGE.read_text())
    declared = (ROOT / "ros2_ws/src/softgrip_cell/setup.cfg").read_text()
    assert scripts
    assert all(f"    {script} = softgrip_cell." in declared for script in scripts)


def test_the_table_of_the_grasp_sequence_is_the_codes() -> None:
    script = load_script(ROOT / "tools/docs/cell.py")
    assert script.render() == PAGE.read_text(), "run: python tools/docs/cell.py"
    assert script.table().count("\n") > 15


def test_the_tests_that_the_page_names_are_there() -> None:
    named = set(re.findall(r"`(test_\w+)`", PAGE.read_text()))
    assert named
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert all(f"def {name}(" in tests for name in named)
