# SPDX-License-Identifier: Apache-2.0
"""Hand files: what is refused, and that every problem is named with what is allowed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import yaml

from softgrip_description import HandError, load_hand, shipped_hand
from softgrip_description.commands import hand_file
from softgrip_description.json_schema import shipped_schema
from softgrip_model.profile import load, shipped_directory

SHIPPED = Path(__file__).resolve().parents[1] / "softgrip_description" / "data" / "hand.yaml"


def write(tmp_path: Path, **changes: object) -> Path:
    data = yaml.safe_load(SHIPPED.read_text())
    data.update(changes)
    path = tmp_path / "hand.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_the_shipped_hand_has_the_three_slots_of_the_cell() -> None:
    assert list(shipped_hand().slots) == ["index", "middle", "thumb"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"schema": 2}, "schema: expected"),
        ({"colour": "blue"}, "colour: expected one of schema, name, .*, found colour"),
        ({"slots": {}}, "slots: expected at least 1, found none"),
        ({"palm": {"size_m": [0.1, 0.0, 0.03], "mass_kg": 0.2}}, r"palm.size_m\[1\]: expected more than 0, found 0"),
        ({"palm": {"size_m": [0.1, 0.1, 0.03]}}, "palm.mass_kg: expected it, found nothing .of palm and drives"),
        ({"palm": {"size_m": [0.1, 0.1], "mass_kg": 0.2}}, "palm.size_m: expected at least 3, found 2"),
        (
            {"default_tool_centre_point_m": [0.0, float("nan"), 0.0]},
            r"_point_m\[1\]: expected a number, found NaN",
        ),
        ({"finger_density_kg_m3": "heavy"}, "finger_density_kg_m3: expected a number, found .heavy"),
        ({"name": "two words"}, "name: expected letters, digits and _, found .two words"),
    ],
)
def test_a_wrong_hand_file_is_refused_with_the_key(tmp_path: Path, changes: dict[str, object], text: str) -> None:
    with pytest.raises(HandError, match=text):
        load_hand(write(tmp_path, **changes))


def test_all_problems_are_named_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, name="", finger_density_kg_m3=-1.0)
    with pytest.raises(HandError, match=r"hand.yaml:\d+: finger_density_kg_m3: .*\n.*hand.yaml:\d+: name: "):
        load_hand(path)


def test_a_problem_has_its_line_and_a_key_stands_there_once(tmp_path: Path) -> None:
    text = SHIPPED.read_text()
    (line,) = [number for number, row in enumerate(text.splitlines(), start=1) if row.startswith("  mass_kg:")]
    path = tmp_path / "hand.yaml"
    path.write_text(text.replace("mass_kg: 0.180", "mass_kg: -1"))
    with pytest.raises(HandError, match=rf"hand.yaml:{line}: palm.mass_kg: expected more than 0, found -1"):
        load_hand(path)
    path.write_text(text + "name: again\n")
    with pytest.raises(HandError, match="expected each key once, found name again"):
        load_hand(path)


def test_a_slot_closes_towards_one_of_two_sides(tmp_path: Path) -> None:
    slots = yaml.safe_load(SHIPPED.read_text())["slots"]
    slots["thumb"]["closes_towards_x"] = 0
    with pytest.raises(HandError, match=r"slots\.thumb\.closes_towards_x: expected one of -1, 1, found 0"):
        load_hand(write(tmp_path, slots=slots))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(HandError, match=r"expected a hand file, found: .*No such file"):
        load_hand(tmp_path / "none.yaml")


def test_a_finger_longer_than_its_slot_allows_is_refused_with_both_lengths() -> None:
    design = load(shipped_directory() / "power.yaml").finger("index")
    long = dataclasses.replace(design, link_lengths_m=(0.09, 0.027, 0.023))
    with pytest.raises(HandError, match="at most 120 mm, found 140 mm"):
        shipped_hand().check_mounting({"index": long})


def test_an_unknown_slot_is_refused_with_those_there_are() -> None:
    design = load(shipped_directory() / "power.yaml").finger("index")
    with pytest.raises(HandError, match="expected one of index, middle, thumb"):
        shipped_hand().check_mounting({"ring": design})


def test_the_command_checks_and_shows_the_schema(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hand_file.main(["check", str(SHIPPED), "power", "pinch", "hook"]) == 0
    assert "slots index (up to 120 mm), middle (up to 130 mm), thumb (up to 100 mm)" in capsys.readouterr().out
    slots = yaml.safe_load(SHIPPED.read_text())["slots"]
    slots["index"]["max_length_m"] = 0.05
    short = write(tmp_path, slots=slots)
    assert hand_file.main(["check", str(short)]) == 0
    assert hand_file.main(["check", str(short), "power"]) == 1
    assert "at most 50 mm" in capsys.readouterr().err
    assert hand_file.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == shipped_schema("hand")
