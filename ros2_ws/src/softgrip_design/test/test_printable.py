# SPDX-License-Identifier: Apache-2.0
"""What `optimise` says about printing is what `parts` refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_description.hand import shipped_hand
from softgrip_design.commands import optimise
from softgrip_design.parts.printable import problems_of
from softgrip_model.profile import Profile, load, shipped_directory

POWER = load(shipped_directory() / "power.yaml")


def with_first_routing(radius_m: float) -> Profile:
    index = POWER.finger("index")
    design = replace(index, openings_rad=(1.5707963,) * 3, routing_radii_m=(radius_m, *index.routing_radii_m[1:]))
    return replace(POWER, fingers=tuple((slot, design if slot == "index" else one) for slot, one in POWER.fingers))


def test_a_cable_deeper_than_the_foot_has_room_for_is_named() -> None:
    # the sheath's seat (3.1 mm) and a wall of a nozzle's width below it in a foot 12 mm deep: 10.05 mm, r0 = 14.21 mm
    assert problems_of(with_first_routing(0.01415), shipped_hand()) == {}
    (text,) = problems_of(with_first_routing(0.01425), shipped_hand()).values()
    assert "finger index, joint 0: routing point 0" in text


def test_the_command_says_what_has_no_slot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["hand_power", "--finger", "index", "--finger", "ring", "--out", str(tmp_path), "--starts", "2"]
    assert optimise.main(arguments) == 0
    refused = json.loads((tmp_path / "hand_power.json").read_text())["not_printable"]
    assert "expected one of index, middle, thumb" in refused["ring"]
    assert f"parts would refuse it for the shipped hand: {refused['ring']}" in capsys.readouterr().out
