# SPDX-License-Identifier: Apache-2.0
"""docs/design.md says what the code gives."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[4]
NUMBER = re.compile(r"-?\d+\.\d+|-?\d+")


def test_the_document_is_up_to_date() -> None:
    script = ROOT / "tools/docs/design.py"
    generator = load_script(script)
    written, rendered = (ROOT / "docs/design.md").read_text(encoding="utf-8"), generator.render()
    assert NUMBER.sub("#", written) == NUMBER.sub("#", rendered), "out of date: run tools/docs/design.py"
    # a flat optimum leaves the last digit to the processor's rounding
    theirs, ours = ([float(text) for text in NUMBER.findall(page)] for page in (written, rendered))
    assert theirs == pytest.approx(ours, rel=0.02, abs=0.11), "out of date: run tools/docs/design.py"


def test_the_page_of_the_parts_is_up_to_date() -> None:
    script = ROOT / "tools/docs/parts.py"
    generator = load_script(script)
    written = (ROOT / "docs/parts.md").read_text(encoding="utf-8")
    assert written == generator.render(), "out of date: run tools/docs/parts.py"
