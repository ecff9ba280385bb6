# SPDX-License-Identifier: Apache-2.0
"""The simulate command and its case files: what ships runs, what is wrong is refused with its place."""

import json
import re

import pytest
import yaml

from softgrip_model.commands import simulate
from softgrip_model.gdfe import GdfeError
from softgrip_model.gdfe.case_file import parse_case

GOOD = """
schema: 1
title: small bar
units: {length: mm, stress: MPa}
materials: {soft: {linear: {modulus: 2.0, poisson: 0.3}}}
mesh: {bar: {size: [4.0, 1.0, 1.0], elements: [4, 1, 1], materials: [soft]}}
boundary:
  - {face: left, fix: xyz}
  - {face: right, displace: {x: 0.4}}
"""


@pytest.mark.parametrize("name", ["five_materials", "rotation", "tension"])
def test_a_shipped_bar_agrees_with_calculix(name, tmp_path, capsys):
    assert simulate.main([name, "--out", str(tmp_path), "--json", str(tmp_path / "out.json")]) == 0
    data = json.loads((tmp_path / "out.json").read_text())
    assert data["completed"]
    assert data["difference_to_calculix"]["mean"] < 0.005
    assert (tmp_path / f"{name}.vtu").stat().st_size > 1000
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "difference to CalculiX" in capsys.readouterr().out


def test_the_unit_of_force_is_newton(tmp_path):
    case = tmp_path / "bar.yaml"
    # 2 MPa, 1 mm2, strain 0.1, lateral contraction free on the right: 0.2 N of Hooke within the clamp's stiffening
    case.write_text(GOOD)
    simulate.main([str(case), "--out", str(tmp_path), "--json", str(tmp_path / "mm.json"), "--refine", "2"])
    in_mm = json.loads((tmp_path / "mm.json").read_text())["reaction_n"]["right"][0]
    assert in_mm == pytest.approx(0.2, rel=0.05)
    in_si = GOOD.replace("length: mm, stress: MPa", "length: m, stress: Pa").replace("modulus: 2.0", "modulus: 2.0e+6")
    case.write_text(in_si.replace("[4.0, 1.0, 1.0]", "[0.004, 0.001, 0.001]").replace("x: 0.4", "x: 0.0004"))
    simulate.main([str(case), "--out", str(tmp_path), "--json", str(tmp_path / "m.json"), "--refine", "2"])
    assert json.loads((tmp_path / "m.json").read_text())["reaction_n"]["right"][0] == pytest.approx(in_mm, rel=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("stress: MPa", "stress: psi", "units.stress: expected one of Pa, kPa, MPa, found 'psi'"),
        ("materials: [soft]", "materials: [hard]", "unknown materials ['hard']"),
        ("face: left", "face: inside", "face: expected one of left, right"),
        ("fix: xyz", "fix: xw", "expected axes out of x, y, z"),
        ("modulus: 2.0", "modulus: 2e3", "YAML reads exponents"),
        ("poisson: 0.3", "poisson: 0.5", "below 0.5, found 0.5"),
        ("title: small bar", "name: small bar", "missing keys ['title'], unknown keys ['name']"),
        ("schema: 1", "schema: 7", "schema: expected 1, found 7"),
    ],
)
def test_a_wrong_case_is_refused_with_its_place(old, new, message, tmp_path):
    with pytest.raises(GdfeError, match=re.escape(message)):
        parse_case(yaml.safe_load(GOOD.replace(old, new)), tmp_path)


def test_a_case_without_boundary_conditions_is_refused(tmp_path):
    data = yaml.safe_load(GOOD)
    data["boundary"] = []
    with pytest.raises(GdfeError, match="nothing would hold the mesh"):
        parse_case(data, tmp_path)


def test_a_bar_that_can_slide_is_refused_by_the_command(tmp_path, capsys):
    case = tmp_path / "loose.yaml"
    case.write_text(GOOD.replace("fix: xyz", "fix: x"))
    assert simulate.main([str(case), "--out", str(tmp_path)]) == 2
    assert "can move freely" in capsys.readouterr().err
