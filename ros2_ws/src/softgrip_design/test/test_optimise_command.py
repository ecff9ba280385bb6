# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from softgrip_design.commands import optimise
from softgrip_model import profile
from softgrip_model.finger import Finger


def test_a_shipped_motion_becomes_profile_parameters_plot_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        optimise.main(["hand_power", "--finger", "index", "--out", str(tmp_path), "--id", "mine", "--starts", "3"]) == 0
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.json", "mine.png", "mine.yaml", "mine_cad.csv"]
    made = profile.load(tmp_path / "mine.yaml")
    finger = Finger.from_profile(made, "index")
    assert made.friction_id == "braid-tpu-chapter4"
    assert finger.link_mm == pytest.approx((45.0, 27.0, 23.0))  # Fig 4.1
    with (tmp_path / "mine_cad.csv").open() as file:
        rows = {row["Name"]: row for row in csv.DictReader(file)}
    for j, thickness in enumerate(finger.thickness_mm):
        assert float(rows[f"index_h{j}"]["Value"]) == pytest.approx(thickness, abs=1e-3)
        assert rows[f"index_h{j}"]["Expression"] == f"{rows[f'index_h{j}']['Value']} mm"
    for i, routing in enumerate(finger.routing_mm):
        assert float(rows[f"index_r{i}"]["Value"]) == pytest.approx(routing, abs=1e-3)
    report = json.loads((tmp_path / "mine.json").read_text())
    index = report["fingers"]["index"]
    assert index["objective"] == pytest.approx(2.0 * index["error_deg"] + index["force_n"])
    assert len(index["starts"]) == 3
    assert report["error_deg_of_the_thesis_on_its_own_demonstrations"]["power"] == pytest.approx(6.59)
    output = capsys.readouterr().out
    assert "1 finger in" in output
    assert "Fig 4.4" in output
    assert "power 6.59 deg, hook 5.53 deg, pinch 3.76 deg" in output


def test_the_uniform_finger(tmp_path: Path) -> None:
    assert optimise.main(["--objective", "uniform", "--out", str(tmp_path), "--starts", "8"]) == 0
    report = json.loads((tmp_path / "uniform.json").read_text())
    assert report["spread_deg"] < report["published_routing_spread_deg"]
    assert profile.load(tmp_path / "uniform.yaml").finger("index").link_lengths_m == (0.035,) * 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "expected a TRAJECTORY"),
        (["absent.csv"], "expected a trajectory at absent.csv"),
        (["unheard_of"], "found none"),
        (["hand_power", "--friction", "butter"], "butter"),
        (["hand_power", "--starts", "0"], "at least one start"),
        (["hand_power", "--weights", "0", "0"], "not both 0"),
        (["hand_power", "--weights", "nan", "1"], "not both 0"),
        (["hand_pinch", "--finger", "middle"], "15 deg or more"),
        (["hand_power", "--id", "a b"], "letters, digits"),
        (["hand_power", "--objective", "uniform"], "takes no trajectory"),
    ],
)
def test_what_cannot_be_designed_is_said(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert optimise.main([*arguments, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
