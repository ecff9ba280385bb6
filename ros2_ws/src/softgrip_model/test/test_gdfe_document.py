# SPDX-License-Identifier: Apache-2.0
"""docs/gdfe.md says what the code gives."""

from pathlib import Path

import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def generator():
    return load_script(ROOT / "tools" / "docs" / "gdfe.py")


@pytest.mark.slow
def test_the_document_is_what_the_code_gives(generator, differences):
    written = (ROOT / "docs" / "gdfe.md").read_text(encoding="utf-8")
    assert not differences(written, generator.render()), "docs/gdfe.md is out of date: run tools/docs/gdfe.py"


def test_its_figures_can_be_drawn(generator, tmp_path):
    generator.draw(tmp_path)
    for name in ("gdfe_forces.png", "gdfe_fingers.png", "gdfe_calculix.png"):
        assert (ROOT / "docs" / "figures" / name).read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / name).stat().st_size > 1000
        assert f"figures/{name}" in generator.render()


def test_a_changed_answer_changes_the_text(generator, monkeypatch, differences):
    before = generator._calibration_rows()
    exact = generator.stiffness_ratio
    monkeypatch.setattr(generator, "stiffness_ratio", lambda left, right: 1.001 * exact(left, right))
    assert not differences(before, before)
    assert differences(before, generator._calibration_rows())
