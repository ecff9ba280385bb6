# SPDX-License-Identifier: Apache-2.0
"""The shipped parameter files are what the nodes' tables say."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
parameters = load_script(ROOT / "tools" / "parameters.py")


@pytest.mark.parametrize(("path", "content"), [pytest.param(p, c, id=p.stem) for p, c in parameters.files().items()])
def test_shipped_file_is_up_to_date(path: Path, content: str) -> None:
    assert path.read_text() == content, "run: python tools/parameters.py"


@pytest.mark.parametrize("path", sorted(parameters.CONFIG.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_value_has_a_unit_comment_and_reads_back_as_its_type(path: Path) -> None:
    document = yaml.safe_load(path.read_text())
    values = document[f"/**/{path.stem}"]["ros__parameters"]
    lines = path.read_text().splitlines()
    for name in values:
        at = next(i for i, line in enumerate(lines) if line.startswith(f"    {name}:"))
        assert lines[at - 1].strip().startswith("# ["), name
