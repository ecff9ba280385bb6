# SPDX-License-Identifier: Apache-2.0
"""Benchmarks are found by subject, and by the paths that pages and other code name."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"\bbenchmarks/[\w/]*\.py\b")


def test_every_named_script_is_there() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "*.md", "*.py", "Makefile"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    named = {(file, path) for file in listed for path in NAMED.findall((ROOT / file).read_text())}
    missing = sorted(f"{file}: {path}" for file, path in named if not (ROOT / path).is_file())
    assert len(named) > 20
    assert not missing, "\n".join(missing)


def test_a_script_stands_below_its_subject_and_names_are_not_used_twice() -> None:
    folder = ROOT / "benchmarks"
    assert [path.name for path in folder.glob("*.py")] == ["run_all.py"]
    names = [path.name for path in folder.glob("*/*.py")]
    assert len(set(names)) == len(names) > 30
