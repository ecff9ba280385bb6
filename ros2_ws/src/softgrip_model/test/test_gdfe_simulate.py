# SPDX-License-Identifier: Apache-2.0
"""The simulate command and its case files: what ships runs, what is wrong is refused with its place."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from softgrip_model.commands import simulate
from softgrip_model.gdfe import GdfeError, bar
from softgrip_model.gdfe.case_file import parse_case
from softgrip_model.gdfe.mesh_file import write_mesh

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
        ("title: small bar", "name: small bar\n7: nine", "missing keys ['title'], unknown keys ['7', 'name']"),
        ("schema: 1", "schema: 7", "schema: expected 1, found 7"),
        ("length: mm", "length: [mm]", "units.length: expected one of m, cm, mm, found ['mm']"),
        ("[4.0, 1.0, 1.0]", "4.0", "mesh.bar.size: expected a list of 3 numbers, found 4.0"),
        ("[4.0, 1.0, 1.0]", "[4.0, 1.0]", "mesh.bar.size: expected a list of 3 numbers, found [4.0, 1.0]"),
        ("[4.0, 1.0, 1.0]", "[4.0, 1.0, 1.0e+300]", "mesh.bar.size[2]: expected a number, found 1e+300"),
        ("materials: [soft]", "materials: []", "mesh.bar.materials: expected a list of names, found []"),
        ("materials: [soft]", "materials: 3", "mesh.bar.materials: expected a list of names, found 3"),
        ("displace: {x: 0.4}", "rotate: {axis: zx, angle_deg: 9}", "boundary[1].rotate.axis: expected one of x, y, z"),
    ],
)
def test_a_wrong_case_is_refused_with_its_place(old, new, message, tmp_path):
    with pytest.raises(GdfeError, match=re.escape(message)):
        parse_case(yaml.safe_load(GOOD.replace(old, new)), tmp_path)


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ("polynomial: {coefficients: 2.0, poisson: 0.3, max_strain: 1.0}", "soft.coefficients: expected a list of one"),
        ("ogden: {mu: 2.0, alpha: [2.0], poisson: 0.3}", "soft.mu: expected a list of one or more numbers, found 2.0"),
        ("ogden: {mu: [2.0], alpha: [], poisson: 0.3}", "soft.alpha: expected a list of one or more numbers, found []"),
    ],
)
def test_a_wrong_material_is_refused_with_its_place(material, message, tmp_path):
    data = yaml.safe_load(GOOD)
    data["materials"] = yaml.safe_load(f"{{soft: {{{material}}}}}")
    with pytest.raises(GdfeError, match=re.escape(message)):
        parse_case(data, tmp_path)


def test_a_bar_too_large_to_compute_is_refused(tmp_path):
    data = yaml.safe_load(GOOD)
    data["mesh"]["bar"]["elements"] = [10000, 1000, 1000]
    with pytest.raises(GdfeError, match="expected 1000000 hexahedra or fewer"):
        parse_case(data, tmp_path)


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


LOADED = """
schema: 1
title: loaded bar
units: {length: mm, stress: MPa}
materials: {soft: {linear: {modulus: 2.0, poisson: 0.0}, density_kg_m3: 1200.0}}
mesh: {bar: {size: [4.0, 1.0, 1.0], elements: [8, 2, 2], materials: [soft]}}
boundary: [{face: left, fix: xyz}]
increments: 1
"""


def simulated(tmp_path, text):
    case = tmp_path / "case.yaml"
    case.write_text(text)
    assert simulate.main([str(case), "--out", str(tmp_path), "--json", str(tmp_path / "out.json")]) == 0
    return json.loads((tmp_path / "out.json").read_text())


@pytest.mark.parametrize(
    ("units", "size"),
    [("{length: mm, stress: MPa}", "[4.0, 1.0, 1.0]"), ("{length: cm, stress: kPa}", "[0.4, 0.1, 0.1]")],
    ids=["mm", "cm"],
)
@pytest.mark.parametrize(
    ("load", "held"),
    [
        ("{face: right, force_n: {x: 0.01, y: -0.02}}", [-0.01, 0.02, 0.0]),
        ("{face: right, follower_n: {x: 0.01}}", [-0.01, 0.0, 0.0]),
        # 1200 kg/m3 x 4 mm3 x 1000 m/s2
        ("{gravity_m_s2: {y: -1000.0}}", [0.0, 0.0048, 0.0]),
    ],
    ids=["force", "follower", "weight"],
)
def test_loads_of_a_case_are_held_in_newtons(units, size, load, held, tmp_path):
    text = LOADED.replace("{length: mm, stress: MPa}", units).replace("[4.0, 1.0, 1.0]", size)
    if "kPa" in units:
        text = text.replace("modulus: 2.0", "modulus: 2000.0")
    data = simulated(tmp_path, text + f"loads: [{load}]\n")
    assert data["reaction_n"]["left"] == pytest.approx(held, abs=1e-6)


def test_pressure_of_a_case_is_in_its_unit_of_stress(tmp_path):
    data = simulated(tmp_path, LOADED + "loads: [{face: right, pressure: 0.05}]\n")
    assert data["reaction_n"]["left"][0] == pytest.approx(0.05, rel=1e-3)  # on 1 mm2, which nu = 0 leaves as it is


def test_a_plane_of_a_case_presses_the_bar(tmp_path):
    # E A d / L = 2 x 1 x 0.2 / 4
    plane = (
        "obstacles: [{plane: {point: [4.0, 0.0, 0.0], normal: [-1.0, 0.0, 0.0]}, touches: right, move: {x: -0.2}}]\n"
    )
    data = simulated(tmp_path, LOADED + plane)
    assert data["contacts"][0]["force_n"][0] == pytest.approx(-0.1, rel=1e-4)
    assert data["contacts"][0]["nodes"] == 9


def test_a_cable_of_a_case_pulls_by_tension_and_by_length(tmp_path):
    cable = "cables: [{points: [[0, 0, 0], [2, 0, 0], [4, 0, 0]], guides: 1, %s}]\n"
    data = simulated(tmp_path, LOADED + cable % "tension_n: 0.1")
    assert data["reaction_n"]["left"][0] == pytest.approx(0.1, rel=1e-4)
    shortening = data["cables"][0]["shortening"]
    again = simulated(tmp_path, LOADED + cable % f"pull: {shortening}")
    assert again["cables"][0]["tension_n"][0] == pytest.approx(0.1, rel=1e-3)


def test_a_cable_of_a_case_rubs_by_its_law(tmp_path):
    friction = "friction: {law: capstan, coefficients: [0.3], radius_mm: 1.0}"
    bend = "[[-1, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0]]"  # a right angle at the second point
    cable = f"cables: [{{points: {bend}, guides: 1, tension_n: 0.01, {friction}}}]\n"
    tension = simulated(tmp_path, LOADED + cable)["cables"][0]["tension_n"]
    assert tension[0] / tension[-1] == pytest.approx(np.exp(0.3 * np.pi / 2), rel=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loads: [{face: right}]", "loads[0]: expected one of force_n, pressure, follower_n"),
        ("loads: [{face: up, pressure: 1.0}]", "loads[0].face: expected one of left, right"),
        ("loads: [{face: right, force_n: {w: 1.0}}]", "loads[0].force_n: expected axes out of x, y, z"),
        ("loads: [{face: right, pressure: high}]", "loads[0].pressure: expected a number, found 'high'"),
        ("obstacles: [{cube: {}}]", "obstacles[0]: expected one of plane, sphere, cylinder"),
        ("obstacles: [{sphere: {centre: [0, 0, 0], radius: -1.0}}]", "obstacles[0]: sphere: expected a radius above 0"),
        ("obstacles: [{sphere: {centre: [0, 0], radius: 1.0}}]", "expected three numbers [x, y, z], found [0, 0]"),
        ("cables: [{points: [[0, 0, 0], [4, 0, 0]]}]", "cables[0]: expected either pull (a length) or tension_n"),
        ("cables: [{points: [[0, 0, 0], [9, 0, 0]], pull: 1.0}]", "(9.0, 0.0, 0.0) lies in no element"),
        (
            "cables: [{points: [[0, 0, 0], [4, 0, 0]], pull: 1, friction: {law: heap}}]",
            "cables[0].friction: missing keys",
        ),
    ],
)
def test_a_wrong_load_is_refused_with_its_place(text, message, tmp_path):
    with pytest.raises(GdfeError, match=re.escape(message)):
        parse_case(yaml.safe_load(LOADED + text), tmp_path)


def test_weight_without_density_and_cables_without_newtons_are_refused(tmp_path):
    with pytest.raises(GdfeError, match="weight needs density_kg_m3 in every material"):
        parse_case(yaml.safe_load(GOOD + "loads: [{gravity_m_s2: {y: -9.81}}]"), tmp_path)
    in_kpa = LOADED.replace("stress: MPa", "stress: kPa") + "cables: [{points: [[0, 0, 0], [4, 0, 0]], pull: 1.0}]"
    with pytest.raises(GdfeError, match="units whose force is the newton"):
        parse_case(yaml.safe_load(in_kpa), tmp_path)


def test_the_thesis_law_takes_no_forces(tmp_path, capsys):
    case = tmp_path / "forced.yaml"
    case.write_text(LOADED + "loads: [{face: right, force_n: {x: 0.01}}]\n")
    assert simulate.main([str(case), "--law", "thesis", "--out", str(tmp_path)]) == 2
    assert "prescribed displacements only" in capsys.readouterr().err


FINGER = """
schema: 1
title: short closing
finger: {profile: hook, finger: index, resolution: coarse, pull_m: 0.006, steps: 3}
"""


def test_a_finger_closes_beside_the_pseudo_rigid_prediction(tmp_path, capsys):
    data = simulated(tmp_path, FINGER)
    assert [state["converged"] for state in data["states"]] == [True] * 3
    last = data["states"][-1]
    # the published designs and the mesh are different models: some per cent of the finger's 95 mm apart, not more
    apart = np.linalg.norm(np.array(last["tip_m"][:2]) - last["pseudo_rigid_tip_m"][:2])
    assert apart < 0.05 * 0.095
    assert last["tension_n"][0] > last["tension_n"][-1] > 0.0
    assert (tmp_path / "case.vtu").stat().st_size > 1000
    assert (tmp_path / "case.png").read_bytes().startswith(b"\x89PNG")
    assert "predictor" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("hook", "fist", "finger.profile: expected one of hook, pinch, power"),
        ("finger: index", "finger: toe", "toe"),
        ("coarse", "finest", "finger.resolution: expected one of coarse, fine"),
        ("pull_m: 0.006", "pull_m: -1.0", "finger.pull_m: expected 0.0001 or more"),
    ],
)
def test_a_wrong_finger_is_refused(old, new, message, tmp_path, capsys):
    case = tmp_path / "finger.yaml"
    case.write_text(FINGER.replace(old, new))
    assert simulate.main([str(case), "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err


def test_another_mesh_can_be_given(tmp_path):
    write_mesh(tmp_path / "fine.vtu", bar((4.0, 1.0, 1.0), (16, 3, 3)))
    case = tmp_path / "bar.yaml"
    case.write_text(GOOD)
    arguments = ["--mesh", str(tmp_path / "fine.vtu"), "--out", str(tmp_path), "--json", str(tmp_path / "out.json")]
    assert simulate.main([str(case), *arguments]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["hexahedra"] == 144


def test_the_documents_case_runs(tmp_path):
    document = Path(__file__).parents[4] / "docs" / "gdfe.md"
    text = document.read_text(encoding="utf-8").split("```yaml")[1].split("```")[0]
    data = simulated(tmp_path, text)
    assert data["contacts"][0]["force_n"][1] > 0.0
    assert data["cables"][0]["tension_n"][0] == pytest.approx(0.05)
