# SPDX-License-Identifier: Apache-2.0
"""The predict command: table, JSON, plot, and what it says when it cannot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.commands.predict import main


def test_every_law_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, plot = tmp_path / "power.json", tmp_path / "power.png"
    chosen = ["--profile", "power", "--joint-model", "hinge", "--pull", "20", "--steps", "40"]  # the thesis' numbers
    assert main([*chosen, "--json", str(data), "--plot", str(plot)]) == 0
    printed = capsys.readouterr().out
    assert "Power grasp as published: index finger, friction braid-tpu-chapter4" in printed
    assert "tip [mm]" in printed
    laws = json.loads(data.read_text())["laws"]
    assert list(laws) == ["no friction", "capstan", "heap", "matte"]
    np.testing.assert_allclose(np.degrees(laws["matte"]["angle_rad"][-1]), [83.728, 46.710, 45.102], atol=6e-4)
    assert laws["matte"]["tension_n"][-1][0] == pytest.approx(14.4452, abs=6e-5)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_closing_that_breaks_off_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "far.json"
    assert main(["--profile", "power", "--pull", "80", "--steps", "8", "--json", str(data)]) == 1
    assert "pulled further than the closed grooves leave" in capsys.readouterr().out
    matte = json.loads(data.read_text())["laws"]["matte"]
    assert matte["angle_rad"][-1] == [None, None, None]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--profile", "fist"], "unknown profile 'fist'; found hook, pinch, power"),
        (["--profile", "missing.yaml"], "missing.yaml: cannot be read as a profile"),
        (["--profile", "power", "--finger", "ring"], "no finger 'ring'; it has index, middle, thumb"),
        (["--profile", "power", "--pull", "-3"], "expected a pull > 0 mm"),
        (["--profile", "power", "--friction", "ice"], "ice"),
    ],
)
def test_requests_that_cannot_be_met(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert message in capsys.readouterr().err
