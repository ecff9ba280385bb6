# SPDX-License-Identifier: Apache-2.0
"""docs/friction.md says what the code gives."""

from pathlib import Path

import numpy as np
import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def generator():
    return load_script(ROOT / "tools" / "docs" / "friction.py")


@pytest.fixture(scope="module")
def written():
    return (ROOT / "docs" / "friction.md").read_text(encoding="utf-8")


@pytest.mark.skipif(
    not hasattr(np, "trapezoid"), reason="with the oldest libraries a bootstrap's quantile ends in another digit"
)
def test_the_document_is_what_the_code_gives(generator, written, differences):
    assert not differences(written, generator.render()), "docs/friction.md is out of date: run tools/docs/friction.py"


def test_its_figures_are_there_and_can_be_drawn(generator, written, tmp_path):
    figures = [line.split("(")[1].rstrip(")") for line in written.splitlines() if line.startswith("![")]
    generator.draw(tmp_path)
    assert {Path(figure).name for figure in figures} == {path.name for path in tmp_path.iterdir()}
    for figure in figures:
        assert (ROOT / "docs" / figure).read_bytes().startswith(b"\x89PNG")


def test_its_example_runs(written):
    example = written.split("```python\n")[1].split("```")[0]
    names = {}
    exec(compile(example, "docs/friction.md", "exec"), names)
    assert names["ratio"].shape == (3,)
    assert names["ratio"][1] == pytest.approx(1.2147, abs=5e-5)  # K as printed, 5.886 N, 50 deg
    assert names["slopes"].d_coefficients.shape == (4,)
    assert names["low"] < float(names["braid"].ratio(np.radians(50), 5.886)) < names["high"]
    assert names["model"].verdict == "usable"
