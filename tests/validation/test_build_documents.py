# SPDX-License-Identifier: Apache-2.0
"""docs/build: its pictures are what the code draws, its links lead somewhere, its figures are those of the code."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import ModuleType

import pytest

from softgrip_demo.first_run import camera_steps
from softgrip_demo.first_run.cube import TEST_CUBE
from softgrip_description.hand import shipped_hand
from softgrip_design.parts import drives, foot, palm
from softgrip_design.parts.bill import TURNS, bought_rows
from softgrip_design.parts.kit import whole_kit
from softgrip_driver.damiao import frames as damiao
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.feetech import registers as feetech
from softgrip_driver.rig.plan import NINE_ANGLES_DEG, NINE_LOADS_KG
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import TorqueModel
from softgrip_driver.wizard.direction import SpoolPull
from softgrip_driver.wizard.tensioning import SETTLED_M, TensioningPlan
from softgrip_driver.wizard.wizard import WizardSettings
from softgrip_model.profile import load as load_profile
from softgrip_model.profile import shipped_directory
from softgrip_testing.scripts import load_script
from softgrip_vision.calibrating.plane import LARGEST_RMS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted((ROOT / "docs/build").glob("*.md")), ROOT / "docs/cell_file.md"]


def load(name: str) -> ModuleType:
    return load_script(ROOT / f"tools/docs/{name}.py")


@pytest.mark.parametrize("name", load_script(ROOT / "tools/docs/drawings.py").PICTURES)
def test_a_picture_is_what_the_code_draws(name: str) -> None:
    assert (ROOT / f"docs/figures/{name}.svg").read_text() == load("drawings").PICTURES[name]()


def test_the_currents_drawn_are_those_of_the_page() -> None:
    """At rest the supply gives R i^2 / V (balance of power, docs/driver.md)."""
    winding, supply = load("driver_current").currents(5.0)
    motor = MODELS["XL330-M288"]
    assert supply == pytest.approx(winding**2 * motor.resistance / motor.rated_voltage)
    assert winding == pytest.approx(5.0 * 0.01 / (0.52 / 1.47) + motor.no_load_current)  # e-manual: 0.52 N m at 1.47 A
    page = (ROOT / "docs/driver.md").read_text()
    assert f"5 N are {winding:.1f} A in the winding and {1e3 * supply:.0f} mA from the supply" in page


def test_each_drive_has_a_plate() -> None:
    known = set(MODELS) | set(feetech.MODELS) | set(damiao.MODELS)
    made = [model for face in drives.FACES for model in face.models]
    assert sorted(made) == sorted(known)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_links_of_a_page_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_figures_of_the_pages_are_those_of_the_code() -> None:
    servos, camera = ((ROOT / f"docs/build/{name}.md").read_text() for name in ("servos", "camera"))
    plan, settings = TensioningPlan(), WizardSettings(Path())
    pull = SpoolPull()
    reach = f"{pull.reach_m * 1e3:g} mm at most"
    assert f"about {pull.tension_n:g} N, more where that does not turn the gears, {reach}" in servos
    assert f"holds {plan.tension_n:g} N (a Feetech 12 N) for {plan.hold_s:g} s" in servos
    assert f"less than {SETTLED_M * 1e3:g} mm | {settings.slack_m * 1e3:g} mm of slack" in servos
    exposure = (camera_steps.MIN_SIGNAL, 100 * camera_steps.MAX_CLIPPED_SHARE, 100 * camera_steps.MAX_FLICKER)
    assert "| {:g} grey levels; {:g} %; {:g} % |".format(*exposure) in camera
    assert f"| {camera_steps.MAX_EDGE_SHARE:g} |" in camera
    assert f"| {camera_steps.MAX_MARKER_OFFSET_M * 1e3:g} mm |" in camera
    assert f"| {LARGEST_RMS:g} px; {camera_steps.MAX_LINK_ERROR_M * 1e3:g} mm |" in camera
    assert f"| {camera_steps.MAX_STALE_FRAMES} of them |" in camera
    assert f"| {camera_steps.MIN_PICTURE_LEVEL:g} grey levels |" in camera
    assert f"known to {100 * TorqueModel.relative_stddev:g} % from the data sheet" in servos
    assert "2 walls, 30 % infill" in (ROOT / "docs/build/printing.md").read_text()
    printing, bill = ((ROOT / f"docs/build/{name}.md").read_text() for name in ("printing", "bill"))
    assert f"{TEST_CUBE.size_m[0] * 1e3:g} mm" in printing
    assert f"{TEST_CUBE.mass_kg * 1e3:g} g" in printing
    assert f"{MODELS['XL330-M288'].stall_torque:g} N m" in bill
    assert f"(three XL330: {3 * MODELS['XL330-M288'].stall_current:.1f} A)" in bill


def test_the_turns_on_a_spool_are_those_of_its_radius_and_the_tendons_way() -> None:
    """One number of turns on every page; what homing and closing take of it or add follows from the spool's size."""
    limits, one_turn_m = TendonLimits(), 2.0 * math.pi * WizardSettings(Path()).spool_radius_m
    winding, bench = (ROOT / "docs/build/winding.md").read_text(), (ROOT / "docs/bench.md").read_text()
    assert TURNS == 3.0
    assert "Wind three turns side by side" in winding
    assert "Wind three turns, side by side" in bench
    assert "3 turns on it while the finger is straight" in (ROOT / "docs/parts.md").read_text()
    assert f"one turn is {1e3 * one_turn_m:.0f} mm" in winding
    for length_m, sign in ((limits.slack_travel, -1), (limits.travel, 1), (limits.homing_travel, 1)):
        turns = length_m / one_turn_m
        assert f"| {1e3 * length_m:g} mm, {turns:.1f} turn | {TURNS + sign * turns:.1f} |" in winding
    assert limits.homing_travel < one_turn_m, "less than one turn more"
    min_turns, max_turns = TURNS - limits.slack_travel / one_turn_m, TURNS + limits.homing_travel / one_turn_m
    assert math.exp(2.0 * math.pi * round(min_turns, 1) * 0.1) == pytest.approx(6.2, abs=0.05)
    assert f"{max_turns:.1f} turns\nof 0.25 mm are {max_turns * 0.25:.0f} mm wide" in winding
    assert f"in a groove of {drives.GROOVE_MM:g} mm" in winding


def test_what_is_bought_is_what_the_parts_have_holes_for() -> None:
    kit = whole_kit(load_profile(shipped_directory() / "power.yaml"), shipped_hand(), 10.0)
    rows = {(row.title, row.use): row.amount for row in bought_rows(kit, 10.0)}
    bill = (ROOT / "docs/build/bill.md").read_text()
    pins = [
        title.removeprefix("screw ").removesuffix(", ISO 4762") for title, use in rows if use.startswith("cross pin")
    ]
    assert pins == ["M3 x 30", "M3 x 30", "M3 x 40"]
    assert "| cross pin | 2, 1 | screw M3 x 30 (index, middle), M3 x 40 (thumb), ISO 4762 |" in bill
    m4 = {
        title.split(" x ")[1].split(",")[0]: amount
        for (title, _), amount in rows.items()
        if title.startswith("screw M4")
    }
    row = next(line for line in bill.splitlines() if line.startswith("| screws M4"))
    lengths = re.findall(r"x (\d+) \(", row)
    assert row.split(" | ")[1] == ", ".join(m4[length] for length in lengths)
    assert {*lengths} == {*m4}
    nuts = next(amount for (title, _), amount in rows.items() if title.startswith("nut M4"))
    assert f"| nuts M4, ISO 4032 | {nuts} |" in bill
    one = {name: amount for (name, _), amount in rows.items()}
    assert f"| crimp bead | {one['crimp bead 2 mm']} |" in bill
    assert f"| markers | {one['dot 5 mm, green']} |" in bill
    assert f"| screws M6 | {one['screw M6 x 12, ISO 4762']} |" in bill
    plates, spools = (one[f"screw {name}"] for name, _ in drives.FACES[0].screws)
    assert f"| screws of the servos | {plates}, {spools} | XL330: M2 x 10 (plate), M2 x 12 (spool)" in bill


def test_the_page_of_assembly_has_the_places_and_screws_of_the_parts() -> None:
    page = " ".join((ROOT / "docs/build/winding.md").read_text().split())
    face, hand = drives.FACES[0], shipped_hand()
    assert f"hole of {2.0 * (face.horn_radius_mm + drives.PLAY_MM):g} mm: {face.screws[0][1]} M2 x 10" in page
    spool = drives.spool(face, 10.0, 0.125, 3)
    collar = max(corner.x_mm for corner in spool.bodies[0].outline)
    assert f"its collar ({2.0 * collar:g} mm) towards the servo" in page
    assert spool.bodies[0].start_mm == 0.0, "the collar is the lowest"
    assert max(bore.start[2] for bore in spool.bores) > spool.bodies[2].start_mm, "the knot hole is in the upper rim"
    plate = drives.servo_plate(face, 10.0, 3)
    axes = [x for x, _, _ in drives.horn_places_mm(face, 10.0, 3)]
    holes = [bore.start[0] for bore in plate.bores if bore.radius_mm == drives.CABLE_RADIUS_MM]
    assert "axes at {:g}, {:g} and {:g} mm".format(*axes) in page
    assert "holes at {:g}, {:g} and {:g} mm".format(*holes) in page
    assert {axis - hole for axis, hole in zip(axes, holes, strict=True)} == {10.0}
    window = (axes[-1] - axes[0] + face.case_mm[0] + 4.0, face.case_mm[1] + 4.0)  # 2 mm beside the cases
    assert "window of {:g} x {:g} mm".format(*window) in page
    board = [bore for bore in plate.bores if bore.radius_mm == drives.M4_MM]
    assert min(abs(bore.start[0]) - bore.radius_mm for bore in board) > 0.5 * window[0], "its screws hold beside it"
    pins = {name: palm.pin_screw(hand, name) for name in hand.slots}
    assert {name: one.length_mm for name, one in pins.items()} == {"index": 30.0, "middle": 30.0, "thumb": 40.0}
    assert f"{pins['index'].sunk_mm:.1f} mm and {pins['thumb'].sunk_mm:.1f} mm below the side" in page
    assert f"{foot.SHEATH_DEPTH_MM:g} mm of it into the end of the foot" in page
    servo_plate_end = max(bore.end[1] for bore in plate.bores)
    assert {bore.end[1] for bore in plate.bores if bore.radius_mm == foot.SHEATH_RADIUS_MM} == {servo_plate_end}


def test_the_rigs_pages_name_the_nine_points_of_the_plan() -> None:
    angles = "{:g}, {:g} and {:g} deg".format(*NINE_ANGLES_DEG)
    loads = "{:g}, {:g} and {:.1f} kg".format(*NINE_LOADS_KG)
    rig, printing = ((ROOT / f"docs/build/{name}.md").read_text() for name in ("rig", "printing"))
    assert f"guide blocks of {angles}; weights of {loads}" in rig
    assert f"guide blocks of {angles} only" in printing
