# SPDX-License-Identifier: Apache-2.0
"""The shipped schemas, and what the readers find by them, beside an independent validator."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_description import HandError, load_hand
from softgrip_description.json_schema import find_problems, schema_path, shipped_schema

jsonschema = pytest.importorskip("jsonschema")

HAND = yaml.safe_load((schema_path("hand").parent / "hand.yaml").read_text())
CELL = yaml.safe_load("""
schema: 1
cell: left
hardware: real
servos:
  port: /dev/a
  chain:
    - {tendon: index, model: XL330-M288, id: 1, direction: -1, spool_radius_m: 0.01, slack_m: 0.005}
    - {tendon: thumb, model: XL330-M288, id: 2}
hand: hand.yaml
camera: {source: "0", calibration: camera.yaml, exposure_s: 0.01}
rig: {stage: {kind: grbl, port: /dev/b}, gauge: {kind: gcl2, port: /dev/c}}
folders: {out: out}
parameters: {tendon_driver: {loop_rate: 200.0}}
""")
GOOD = {"hand": HAND, "cell": CELL}
SLOT = {"position_m": [0.0, 0.0, 0.0], "rest_angle_rad": 1.0, "closes_towards_x": 1, "max_length_m": 0.1}
Place = tuple[str | int, ...]


def places(value: Any, place: Place = ()) -> Iterator[Place]:
    yield place
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in inner:
        yield from places(one, (*place, key))


def found_by_jsonschema(value: Any, kind: str) -> set[Place]:
    """Return where the reference implementation finds problems, as `find_problems` names the place."""
    found: set[Place] = set()
    for error in jsonschema.Draft202012Validator(shipped_schema(kind)).iter_errors(value):
        at = tuple(error.absolute_path)
        if error.validator == "required":
            found |= {(*at, name) for name in error.validator_value if name not in error.instance}
        elif error.validator == "additionalProperties" and error.validator_value is False:
            found |= {(*at, name) for name in error.instance if name not in error.schema["properties"]}
        elif "propertyNames" in error.absolute_schema_path:
            found.add((*at, error.instance))
        else:
            found.add(at)
    return found


@pytest.mark.parametrize("kind", GOOD)
def test_a_schema_is_one_and_a_good_file_passes(kind: str) -> None:
    jsonschema.Draft202012Validator.check_schema(shipped_schema(kind))
    assert found_by_jsonschema(GOOD[kind], kind) == set()
    assert list(find_problems(GOOD[kind], shipped_schema(kind))) == []


OTHERS = st.sampled_from(
    [None, True, False, "", "text", "two words", "ö", -4, -1, 0, 1, 7, 0.5, -0.5, [], [0.1, 0.2, 0.3], [0.1, 0.2], {}]
).map(copy.deepcopy)


@pytest.mark.parametrize("kind", GOOD)
@settings(max_examples=300)
@given(st.data())
def test_a_reader_finds_what_the_reference_implementation_finds(kind: str, data: st.DataObject) -> None:
    """Values of a good file exchanged, taken out, and put where none belongs: the same places are wrong."""
    document = copy.deepcopy(GOOD[kind])
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.sampled_from([place for place in places(document) if place]))
        holder = document
        for key in place[:-1]:
            holder = holder[key]
        act = data.draw(st.sampled_from(["exchange", "take out", "add", "rename"]))
        if act == "exchange":
            holder[place[-1]] = data.draw(OTHERS)
        elif act == "take out":
            del holder[place[-1]]
        elif isinstance(holder, list):
            holder.append(data.draw(OTHERS))
        else:
            name = data.draw(st.sampled_from(["colour", "index", "my-fingers", "a b", "ä", ""]))
            holder[name] = data.draw(OTHERS) if act == "add" else holder.pop(place[-1])
        if not isinstance(document, dict) or not document:
            break
    assert {place for place, _ in find_problems(document, shipped_schema(kind))} == found_by_jsonschema(document, kind)


@pytest.mark.parametrize(
    "broken",
    [
        {"schema": 2}, {"name": "two words"}, {"colour": "blue"}, {"slots": {}}, {"finger_density_kg_m3": "heavy"},
        {"finger_density_kg_m3": 0}, {"flange": {"position_m": [0, 0, 0]}}, {"tool_centre_points_m": {"a b": [0] * 3}},
        {"palm": {"size_m": [0.1, 0.0, 0.03], "mass_kg": 0.2}}, {"default_tool_centre_point_m": [0, 0]},
        {"slots": {"index": SLOT | {"rest_angle_rad": 4.0}}}, {"slots": {"index": SLOT | {"closes_towards_x": 0}}},
        {"slots": {"index": SLOT | {"closes_towards_x": True}}}, {"slots": {"in dex": SLOT}},
        {"slots": {"index": SLOT | {"length_m": 0.1}}}, {"slots": {"index": None}},
    ],
)  # fmt: skip
def test_what_is_no_hand_is_refused_by_reader_and_schema(tmp_path: Path, broken: dict[str, Any]) -> None:
    document = HAND | broken
    path = tmp_path / "hand.yaml"
    path.write_text(yaml.safe_dump(document))
    assert found_by_jsonschema(document, "hand")
    with pytest.raises(HandError, match="expected"):
        load_hand(path)
