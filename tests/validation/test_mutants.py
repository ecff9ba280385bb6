# SPDX-License-Identifier: Apache-2.0
"""The list of mutants fits the code, and what runs them can tell a noticed error from one that nobody notices."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "mutants"

#: What they copy is what `make setup` has built.
needs_set_up = pytest.mark.skipif(importlib.util.find_spec("embedded_ros") is None, reason="make setup")

AREA = """
area = "example"
file = "ros2_ws/src/softgrip_driver/softgrip_driver/tendon/limits.py"
tests = ["ros2_ws/src/softgrip_driver/test/test_guard_limits.py"]
suite = ["ros2_ws/src/softgrip_driver/test/test_guard_limits.py"]

[[mutant]]
id = "one"
old = "{old}"
new = "{new}"
why = "an example"
"""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that reads the list."""
    monkeypatch.syspath_prepend(str(TOOL))
    return importlib.import_module("mutant")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(TOOL), *arguments], capture_output=True, text=True, check=False, cwd=ROOT
    )


def test_every_mutant_applies_to_the_code_as_it_is() -> None:
    done = run("--check")
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[0]) >= 150


def read(tool: Any, folder: Path, old: str, new: str) -> Any:
    (folder / "example.toml").write_text(AREA.format(old=old, new=new))
    return tool.read_list(folder)[0]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("return self.temperature_limit - 50.0", "return 0.0", "found it 0 times"),
        ("float = ", "float=", "found it 2"),
        ("tension_hard: float = 45.0", "tension_hard: float = 45.0", "texts that differ"),
        ("tension_hard: float = 45.0", "tension_hard: float = = 45.0", "expected Python"),
    ],
    ids=["stale", "not unique", "no change", "no Python"],
)
def test_a_mutant_that_does_not_fit_is_an_error_and_no_survivor(
    tool: Any, tmp_path: Path, old: str, new: str, expected: str
) -> None:
    (problem,) = tool.check_list([read(tool, tmp_path, old, new)], ROOT)
    assert expected in problem


def test_a_mutant_without_a_reason_or_with_an_unknown_key_is_refused(tool: Any, tmp_path: Path) -> None:
    text = AREA.format(old="tension_hard: float = 45.0", new="tension_hard: float = 90.0")
    for wrong, expected in (
        (text.replace('why = "an example"', ""), "expected also"),
        (text + "speed = 1\n", "found also"),
    ):
        (tmp_path / "example.toml").write_text(wrong)
        with pytest.raises(tool.ListError, match=expected):
            tool.read_list(tmp_path)


@needs_set_up
def test_errors_in_a_copy_are_noticed_and_the_checkout_is_not_touched(tmp_path: Path) -> None:
    limits = ROOT / "ros2_ws/src/softgrip_driver/softgrip_driver/tendon/guards.py"
    before = limits.read_bytes(), limits.stat().st_mtime_ns
    handful = ("hard-limit-twice", "heat-no-floor", "break-never-confirmed")
    done = run("--only", *handful, "--results", str(tmp_path / "results.jsonl"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert sorted(line.split()[1] for line in done.stdout.splitlines() if line.startswith("killed")) == sorted(
        f"guards/{name}" for name in handful
    )
    assert (limits.read_bytes(), limits.stat().st_mtime_ns) == before


@needs_set_up
def test_an_error_that_changes_nothing_survives_and_the_run_says_so(tool: Any, tmp_path: Path) -> None:
    harmless = read(tool, tmp_path, "tension_hard: float = 45.0", "tension_hard: float = 45.00")
    campaign = importlib.import_module("campaign")
    (result,) = campaign.Campaign(ROOT, tmp_path / "results.jsonl", 1, lambda _: None).run([harmless])
    assert result.outcome == "survived"
    report = importlib.import_module("report").format_report([harmless], [result])
    assert "SURVIVED example/one: an example" in report
    assert "0.0 %" in report
