# SPDX-License-Identifier: Apache-2.0
"""docs/gdfe.md says what the code gives."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("docs_gdfe", ROOT / "tools" / "docs" / "gdfe.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_document_is_what_the_code_gives(generator):
    written = (ROOT / "docs" / "gdfe.md").read_text(encoding="utf-8")
    assert written == generator.render(), "docs/gdfe.md is out of date: run tools/docs/gdfe.py"


def test_its_figure_can_be_drawn(generator, tmp_path):
    assert (ROOT / "docs" / "figures" / "gdfe_forces.png").read_bytes().startswith(b"\x89PNG")
    generator.draw(tmp_path)
    assert (tmp_path / "gdfe_forces.png").stat().st_size > 1000
