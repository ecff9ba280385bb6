# SPDX-License-Identifier: Apache-2.0
"""docs/finger.md says what the code gives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    return load_script(ROOT / "tools" / "docs" / "finger.py")


def test_the_document_is_what_the_code_gives(
    generator: ModuleType, differences: Callable[[str, str], list[str]]
) -> None:
    written = (ROOT / "docs" / "finger.md").read_text(encoding="utf-8")
    assert not differences(written, generator.render()), "docs/finger.md is out of date: run tools/docs/finger.py"


def test_its_figures_are_there() -> None:
    written = (ROOT / "docs" / "finger.md").read_text(encoding="utf-8")
    figures = [line.split("(")[1].rstrip(")") for line in written.splitlines() if line.startswith("![")]
    assert figures
    for figure in figures:
        assert (ROOT / "docs" / figure).read_bytes().startswith((b"\x89PNG", b"<svg"))


def test_every_figure_can_be_drawn(generator: ModuleType, tmp_path: Path) -> None:
    generator.draw(tmp_path)
    assert len(list(tmp_path.glob("finger_*.png"))) == 3


def test_its_example_runs() -> None:
    written = (ROOT / "docs" / "finger.md").read_text(encoding="utf-8")
    example = written.split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(compile(example, "docs/finger.md", "exec"), names)
    assert names["closing"].angle_rad.shape == (1, 200, 3)
    assert names["shapes"].gradient.routing.shape == (50, 2, 8, 6)
    assert names["path"].slide.shape == (3, 6)
    assert names["path"].contact_force[1, 0] > 0.0
