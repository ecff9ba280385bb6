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
from softgrip_design.parts import drives
from softgrip_design.parts.bill import TURNS
from softgrip_driver.damiao import frames as damiao
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.feetech import registers as feetech
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import TorqueModel
from softgrip_driver.wizard.direction import SpoolPull
from softgrip_driver.wizard.tensioning import SETTLED_M, TensioningPlan
from softgrip_driver.wizard.wizard import WizardSettings
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
    assert "wind three turns side by side" in winding
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
