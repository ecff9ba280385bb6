# SPDX-License-Identifier: Apache-2.0
"""Cell files: what is wrong is named with its line; what is written is read back; hostile text ends nothing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_description.cell_file import (
    CellCamera,
    CellFile,
    CellFolders,
    CellRig,
    ChainServo,
    RigGauge,
    RigStage,
    ServoChain,
    TorqueValues,
    cell_text,
    load_cell,
    node_parameters,
    parse_cell,
    read_shipped,
    save_cell,
)
from softgrip_description.commands import cell_file
from softgrip_description.errors import CellFileError
from softgrip_description.json_schema import find_problems, shipped_schema

CONFIG = Path(__file__).parents[2] / "softgrip_bringup" / "config"
HEAD = "schema: 1\nhardware: real\n"
CHAIN = HEAD + "servos:\n  port: /dev/a\n  chain:\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected keys with values, found nothing"),
        ("schema: 1\n", ":1: hardware: expected it, found nothing .*real: the devices"),
        ("schema: 2\nhardware: real\n", ":1: schema: expected 1, found 2"),
        ("schema: true\nhardware: real\n", ":1: schema: expected 1, found true"),
        (HEAD + "servo: {}\n", ":3: servo: expected one of .*; did you mean servos"),
        (HEAD + "servos: [1]\n", r":3: servos: expected keys with values, found \[1\]"),
        (HEAD + "cell: a b\n", ":3: cell: expected letters, digits and _"),
        (
            CHAIN + "    - {tendon: a, model: M, id: 253}\n",
            r":6: servos.chain\[0\].id: expected at most 252, found 253",
        ),
        (CHAIN + "    - {tendon: a, model: M, id: 1.5}\n", r"chain\[0\].id: expected a whole number, found 1.5"),
        (CHAIN + "    - {tendon: a, model: M, id: 1, direction: 0}\n", "expected one of -1, 1, found 0"),
        (CHAIN + "    - {tendon: a, model: M, id: 1, spool_radius_m: 10}\n", "expected at most 0.1, found 10"),
        (CHAIN + "    - {tendon: a, model: M, id: 1, spool_radius_m: .nan}\n", "expected a number, found NaN"),
        (
            CHAIN + f"    - {{tendon: a, model: M, id: 1, spool_radius_m: -1{'0' * 400}}}\n",
            "expected a number, found -1",
        ),
        (CHAIN + "    - {tendon: a, id: 1}\n", r":6: servos.chain\[0\].model: expected it, found nothing"),
        (
            CHAIN + "    - {tendon: a, model: M, id: 1}\n    - {tendon: b, model: M, id: 1}\n",
            r":7: servos.chain\[1\].id: expected each ID once, found 1 again; .*wizard",
        ),
        (
            CHAIN + "    - {tendon: a, model: M, id: 1}\n    - {tendon: a, model: M, id: 2}\n",
            r":7: .*tendon: expected each tendon once, found a again",
        ),
        (
            HEAD + "rig:\n  stage: {kind: grbl, port: /dev/x}\n  gauge: {kind: gcl2, port: /dev/x}\n",
            ":5: rig.gauge.port: expected a port of its own, found that of rig.stage.port, /dev/x",
        ),
        (HEAD + "hardware: real\n", ":3: expected each key once, found hardware again"),
        (HEAD + "hand: !!python/object:os.system {}\n", "expected YAML"),
        (HEAD + "a: [\n", "expected YAML, found: .*; correct the line"),
        (
            "/**/tendon_driver:\n  ros__parameters: {port: x}\n",
            "found parameters of nodes; put them under `parameters:`",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_line(text: str, message: str) -> None:
    with pytest.raises(CellFileError) as error:
        parse_cell(text, Path("cell.yaml"))
    assert re.search(message, str(error.value)), str(error.value)


def test_all_problems_are_named_at_once() -> None:
    with pytest.raises(CellFileError) as error:
        parse_cell("schema: 3\nhardware: x\ncolour: red\n", Path("cell.yaml"))
    assert [line.split(":")[1] for line in str(error.value).splitlines()] == ["1", "2", "3"]


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    torque = TorqueValues(torque_per_ampere_nm_a=0.36, limited_current="supply")
    cell = CellFile(
        hardware="real",
        name="left",
        servos=ServoChain(
            "/dev/serial/by-id/x", 1_000_000, (ChainServo("index", "XL330-M288", 3, -1, 0.010, 0.005, torque),)
        ),
        hand=tmp_path / "hand.yaml",
        camera=CellCamera("0", tmp_path / "camera.yaml", exposure_s=0.01, power_line_hz=50),
        rig=CellRig(RigStage("grbl", "/dev/a"), RigGauge("stream", "/dev/b", "hx711", request="SI\r\n")),
        folders=CellFolders(out=tmp_path / "out"),
        parameters={"tendon_driver": {"loop_rate": 200.0}},
    )
    save_cell(cell, tmp_path / "cell.yaml")
    assert load_cell(tmp_path / "cell.yaml") == cell
    assert [path.name for path in tmp_path.iterdir()] == ["cell.yaml"]


def test_a_file_that_can_not_be_written_or_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CellFileError, match="expected a file that can be written"):
        save_cell(CellFile("emulated"), tmp_path / "file" / "cell.yaml")
    with pytest.raises(CellFileError, match="`wizard` makes one"):
        load_cell(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ("tendon_drive: {}", "expected a node of .*; did you mean tendon_driver"),
        ("tendon_driver: {homing_tenson_n: 2}", "did you mean homing_tension_n"),
        ("tendon_driver: {loop_rate: fast}", r"loop_rate: expected a value like 100.0, found 'fast'"),
        ("tendon_driver: {directions: [1, up]}", r"directions: expected a value like \[1\]"),
        ("tendon_driver: {autostart: 1}", "autostart: expected a value like True, found 1"),
    ],
)
def test_a_parameter_that_no_node_takes_is_refused(parameters: str, message: str) -> None:
    cell = parse_cell(f"{HEAD}parameters: {{{parameters}}}\n", Path("cell.yaml"))
    with pytest.raises(CellFileError, match=message):
        node_parameters(cell, read_shipped(CONFIG))


def test_a_whole_number_becomes_one_with_a_fraction_where_the_node_asks_for_that() -> None:
    cell = parse_cell(f"{HEAD}parameters: {{tendon_driver: {{loop_rate: 200}}}}\n", Path("cell.yaml"))
    value = node_parameters(cell, read_shipped(CONFIG))["tendon_driver"]["loop_rate"]
    assert (value, type(value)) == (200.0, float)


def test_a_servo_without_direction_moves_nothing() -> None:
    cell = parse_cell(CHAIN + "    - {tendon: index, model: XL330-M288, id: 1}\n", Path("cell.yaml"))
    with pytest.raises(CellFileError, match="tendon index: expected a direction of 1 or -1, found none; the wizard"):
        node_parameters(cell, read_shipped(CONFIG))


def test_the_launch_carries_out_nothing_of_a_cell_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(HEAD + "folders: {out: '$(command reboot)'}\n")
    assert cell_file.main(["launch", str(path), "--known", str(CONFIG)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "expected a plain path" in err


def test_the_command_checks_and_shows_the_schema(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(CHAIN + "    - {tendon: index, model: XL330-M288, id: 1, direction: 1}\n")
    assert cell_file.main(["check", str(path), "--known", str(CONFIG)]) == 0
    assert "real cell: tendons index; rig none; camera none" in capsys.readouterr().out
    assert cell_file.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == shipped_schema("cell")


KEYS = st.sampled_from([*shipped_schema("cell")["properties"]])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(VALUES)
def test_no_value_ends_the_check_otherwise_than_with_problems(value: object) -> None:
    for place, text in find_problems(value, shipped_schema("cell")):
        assert all(isinstance(part, str | int) for part in place)
        assert text.startswith("expected")


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=60))
def test_no_text_ends_the_reading_otherwise_than_with_a_reason(text: str) -> None:
    with pytest.raises(CellFileError):
        parse_cell(text, Path("cell.yaml"))


def test_an_empty_cell_is_as_short_as_it_can_be() -> None:
    lines = [line for line in cell_text(CellFile("emulated")).splitlines() if not line.startswith("#")]
    assert lines == ["schema: 1", "hardware: emulated"]
