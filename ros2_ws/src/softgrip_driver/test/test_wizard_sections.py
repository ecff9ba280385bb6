# SPDX-License-Identifier: Apache-2.0
"""The rest of the cell file: found on this computer, asked for, verified over the wires, or left out by name."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import yaml

from softgrip_description.cell_file import (
    CellCamera,
    CellFile,
    CellFolders,
    CellRig,
    RigGauge,
    RigStage,
    load_cell,
    node_parameters,
    read_shipped,
    save_cell,
)
from softgrip_description.commands.cell_file import write_launch_files
from softgrip_description.errors import CellFileError
from softgrip_driver.commands import wizard as command
from softgrip_driver.commands.person import GivenAnswers, WrittenAnswers
from softgrip_driver.errors import ConfigurationError, CorruptReplyError
from softgrip_driver.wizard.sections import CellSections, FoundDevices, find_devices
from softgrip_driver.wizard.wizard import SetupWizard, WizardSettings

CONFIG = Path(__file__).parents[2] / "softgrip_bringup" / "config"
HAND = Path(__file__).parents[2] / "softgrip_description/softgrip_description/data/hand.yaml"


class Person:
    """Answers by key, else with the default."""

    def __init__(self, **answers):
        self.answers, self.asked, self.lines = answers, {}, []

    def print_line(self, text):
        self.lines.append(text)

    def ask(self, key, text, default=""):
        self.asked[key] = (text, default)
        return self.answers.get(key.replace(".", "_"), default)

    def confirm(self, key, text):
        raise AssertionError(f"{key}: {text}")

    def try_again(self, key, problem):
        raise AssertionError(f"{key}: {problem}")

    @property
    def text(self):
        return "\n".join(self.lines)


def filled(cell, person, folder, found=None):
    for _, fill in [*CellSections(person, found or FoundDevices(), folder).missing(cell)]:
        cell = fill(cell)
    return cell


def node(folder, name, device):
    """A link as udev makes it."""
    folder.mkdir(parents=True, exist_ok=True)
    device.touch()
    (folder / name).symlink_to(device)
    return str(folder / name)


@pytest.fixture
def plugged(tmp_path):
    """Two cameras, three adapters, one of which has a name of its own."""
    dev = tmp_path / "dev"
    dev.mkdir()
    camera = node(dev / "v4l", "usb-046d_C920-video-index0", dev / "video0")
    node(dev / "v4l", "usb-046d_C920-video-index1", dev / "video1")
    other = node(dev / "v4l", "usb-0c45_Box-video-index0", dev / "video2")
    servos = node(dev / "serial", "usb-FTDI_U2D2-if00-port0", dev / "ttyUSB0")
    board = node(dev / "serial", "usb-1a86_USB_Serial-if00-port0", dev / "ttyUSB1")
    node(dev / "serial", "usb-Mark-10_gauge-if00", dev / "ttyACM0")
    gauge = node(dev / "softgrip", "gauge", dev / "ttyACM0")
    look = partial(find_devices, serial=dev / "serial", cameras=dev / "v4l", own_names=dev / "softgrip")
    return look, servos, camera, other, board, gauge


@pytest.mark.parametrize("as_number", [False, True])
def test_cameras_and_ports_are_found_by_names_that_stay_but_for_the_servos(plugged, tmp_path, as_number):
    look, servos, camera, other, board, gauge = plugged
    found = look(str(Path(servos).resolve()) if as_number else servos)
    assert found == FoundDevices((camera, other), (gauge, board))
    nothing = find_devices("", tmp_path / "no", tmp_path / "no", tmp_path / "no")
    assert nothing == FoundDevices()


def test_with_nothing_plugged_in_the_cell_is_whole_and_says_what_it_lacks(tmp_path):
    person = Person()
    cell = filled(CellFile("real"), person, tmp_path)
    assert cell == CellFile("real", folders=CellFolders(out=tmp_path / "out"))
    assert {*person.asked} == {"cell", "hand", "out", "profiles", "camera", "stage"}
    for words in (
        "camera: left out",
        "rig: left out",
        "no camera found",
        "no serial port found",
        "run the wizard again",
    ):
        assert words in person.text
    # a second run asks for the devices alone
    again = Person()
    assert filled(cell, again, tmp_path) == cell
    assert {*again.asked} == {"camera", "stage"}


def test_every_section_that_is_there_is_kept(tmp_path):
    whole = CellFile(
        "real",
        camera=CellCamera("0", exposure_s=0.01),
        rig=CellRig(RigStage("grbl", "/dev/a"), RigGauge("gcl2", "/dev/b")),
        folders=CellFolders(bags=tmp_path / "disk"),
    )
    person = Person()
    assert filled(whole, person, tmp_path) == whole
    assert person.asked == {}


def test_the_only_camera_is_proposed_and_one_of_several_is_chosen_by_its_number(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).touch()
    (tmp_path / "camera.yaml").touch()
    one, two = str(tmp_path / "one"), str(tmp_path / "two")
    only = filled(CellFile("real"), Person(), tmp_path, FoundDevices((one,)))
    assert only.camera == CellCamera(one, tmp_path / "camera.yaml")
    nobody = Person()
    assert filled(CellFile("real"), nobody, tmp_path, FoundDevices((one, two))).camera is None
    assert f"camera 2: {two}" in nobody.lines
    chosen = Person(camera="2", camera_calibration="none")
    assert filled(CellFile("real"), chosen, tmp_path, FoundDevices((one, two))).camera == CellCamera(two)
    by_index = Person(camera="0", camera_calibration="none")
    assert filled(CellFile("real"), by_index, tmp_path, FoundDevices((one,))).camera == CellCamera("0")


@pytest.mark.parametrize(("stage", "gauge", "line"), [("mark10", "gcl2", None), ("grbl", "stream", "scale")])
def test_the_rigs_devices_are_asked_for_and_answer_over_their_wires(tmp_path, make_rig, stage, gauge, line):
    rig = make_rig(stage=stage, gauge=line or gauge)
    ports = FoundDevices((), (str(tmp_path / "stand"), str(tmp_path / "gauge")))
    person = Person(stage="1", gauge="2", stage_kind=stage, gauge_kind=gauge, gauge_line=line)
    cell = filled(CellFile("real"), person, tmp_path, ports)
    assert cell.rig == CellRig(RigStage(stage, str(tmp_path / "stand")), RigGauge(gauge, str(tmp_path / "gauge"), line))
    assert "stage: " in person.text
    assert "gauge: " in person.text
    assert rig.plant.travel == 0.0
    save_cell(cell, tmp_path / "cell.yaml")
    read = load_cell(tmp_path / "cell.yaml")
    assert read == cell
    write_launch_files(read, CONFIG, tmp_path)
    parameters = yaml.safe_load((tmp_path / "parameters.yaml").read_text())["/**/friction_rig"]["ros__parameters"]
    assert (parameters["stage"], parameters["gauge"]) == (stage, gauge)


def test_the_kind_of_a_board_is_proposed_by_its_name_and_refused_where_there_is_none(tmp_path):
    ports = FoundDevices((), ("/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0",))
    person = Person(stage="1", stage_kind="lathe")
    with pytest.raises(ConfigurationError, match="stage: expected a kind of mark10, grbl, found 'lathe'"):
        filled(CellFile("real"), person, tmp_path, ports)
    assert person.asked["stage.kind"][1] == "grbl"


def test_a_device_of_another_kind_is_named_and_not_written(tmp_path, make_rig):
    make_rig(stage="grbl", gauge="gcl2")
    person = Person(stage=str(tmp_path / "stand"), stage_kind="mark10")
    with pytest.raises(CorruptReplyError, match="stand: expected a travel like"):
        filled(CellFile("real"), person, tmp_path)


def test_a_stage_without_gauge_is_no_rig(tmp_path, make_rig):
    make_rig(stage="grbl", gauge="gcl2")
    person = Person(stage=str(tmp_path / "stand"), stage_kind="grbl")
    assert filled(CellFile("real"), person, tmp_path).rig is None
    assert "rig: left out, it wants a stage and a gauge" in person.text


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"camera": "/dev/video77"}, r"camera: expected a device, found nothing at /dev/video77; plug it in"),
        ({"hand": "no.yaml"}, r"hand: expected a file or folder, found nothing at .*no.yaml"),
        ({"profiles": "no"}, r"profiles: expected a file or folder, found nothing at"),
        ({"camera": "0", "camera_calibration": "no.yaml"}, r"camera.calibration: expected a file or folder"),
    ],
)
def test_what_is_not_there_is_named(tmp_path, answers, message):
    with pytest.raises(ConfigurationError, match=message):
        filled(CellFile("real"), Person(**answers), tmp_path)


def test_a_hand_of_your_own_is_read_before_it_is_taken(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text(HAND.read_text(encoding="utf-8"), encoding="utf-8")
    cell = filled(CellFile("real"), Person(hand=str(own), cell="left"), tmp_path)
    assert (cell.hand, cell.name) == (own, "left")
    save_cell(cell, tmp_path / "cell.yaml")
    text = (tmp_path / "cell.yaml").read_text()
    assert "hand: own.yaml" in text  # the folder may be moved
    assert "out: out" in text
    assert load_cell(tmp_path / "cell.yaml") == cell
    shipped = read_shipped(CONFIG)
    assert node_parameters(cell, shipped)["hand_description"]["hand_file"] == str(own)
    own.write_text("slots: []\n")
    with pytest.raises(ConfigurationError, match=r"own.yaml:1: "):
        filled(CellFile("real"), Person(hand=str(own)), tmp_path)


def test_an_option_answers_before_the_person_is_asked(capsys):
    person = GivenAnswers({"camera": "none"}, WrittenAnswers({"stage": "x"}, takes_defaults=True))
    answers = [person.ask("camera", "Camera", "1"), person.ask("stage", "Stage"), person.ask("out", "Folder", "out")]
    assert answers == ["none", "x", "out"]
    assert not person.try_again("camera", "nothing there")
    person.confirm("straight", "See that")
    assert "? Camera: none" in capsys.readouterr().out


def test_every_question_about_a_section_has_an_option_of_its_name(tmp_path):
    """What can be asked can be given: a run without a person stops at no question."""
    person = Person(camera="0", stage="none")
    filled(CellFile("real"), person, tmp_path)
    asked = {*person.asked} | {"stage.kind", "gauge", "gauge.kind", "gauge.line", "gauge.calibration"}
    assert asked == {*command.SECTION_OPTIONS}


def test_a_name_that_no_cell_may_have_is_not_written(tmp_path):
    file = tmp_path / "cell.yaml"
    save_cell(CellFile("real"), file)
    wizard = SetupWizard(WizardSettings(file, "/dev/none", tendons=("index",)), Person())
    with pytest.raises(CellFileError, match="cell: expected letters, digits and _"):
        wizard._fill(lambda cell: replace(cell, name="a b"))
    assert "a b" not in file.read_text()
