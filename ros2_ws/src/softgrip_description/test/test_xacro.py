# SPDX-License-Identifier: Apache-2.0
"""The xacro macros, expanded by ROS' own xacro, beside the URDF that they stand for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from softgrip_description import macro_of, shipped_hand, urdf_of
from softgrip_description.commands import describe
from softgrip_description.geometry import rotation_of
from softgrip_model.profile import Profile, load, shipped_directory

pytest.importorskip("mujoco")
pytest.importorskip("xacro")
import mujoco
import xacro

URDF = Path(__file__).resolve().parents[1] / "urdf"
SETS = ("power", "pinch", "hook")
Differences = Callable[[str, str], list[str]]


@pytest.fixture(params=SETS)
def profile(request: pytest.FixtureRequest) -> Profile:
    return load(shipped_directory() / f"{request.param}.yaml")


def lines(robot: ET.Element) -> str:
    """Return the elements below a robot, one a line, whatever their spaces and the order of attributes."""
    whole = ET.canonicalize(ET.tostring(robot, encoding="unicode"), strip_text=True)
    return whole.partition(">")[2].replace("><", ">\n<")


def expanded(path: Path, **arguments: str) -> ET.Element:
    return ET.fromstring(xacro.process_file(str(path), mappings=arguments).toxml())


def urdf(profile: Profile, prefix: str = "") -> ET.Element:
    mounted = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    return ET.fromstring(urdf_of(shipped_hand(), mounted, prefix=prefix))


@pytest.mark.parametrize("prefix", ["", "left_", "left/"])
def test_the_shipped_hand_expands_to_the_urdf_of_its_fingers(
    profile: Profile, prefix: str, differences: Differences
) -> None:
    found = expanded(URDF / "hand.urdf.xacro", fingers=profile.id, prefix=prefix)
    assert found.get("name") == shipped_hand().name
    assert differences(lines(found), lines(urdf(profile, prefix))) == []


@pytest.mark.parametrize("name", SETS)
def test_the_shipped_macros_are_those_of_the_hand_file(name: str, differences: Differences) -> None:
    """`python tools/hand_macros.py` writes them."""
    given = macro_of(shipped_hand(), load(shipped_directory() / f"{name}.yaml"))
    assert differences((URDF / f"{name}.urdf.xacro").read_text(), given) == []


TWO_HANDS = """<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="{folder}/power.urdf.xacro"/>
  <xacro:include filename="{folder}/hook.urdf.xacro"/>
  <link name="left_arm"/><link name="right_arm"/>
  <joint name="between" type="fixed"><parent link="left_arm"/><child link="right_arm"/></joint>
  <xacro:softgrip_power prefix="left_" parent="left_arm" xyz="0.1 -0.2 0.3" rpy="0.4 0.5 ${{pi / 3}}"/>
  <xacro:softgrip_hook prefix="right_" parent="right_arm"/>
</robot>
"""


def test_two_hands_hang_on_their_parents_in_one_tree(tmp_path: Path) -> None:
    path = tmp_path / "two.urdf.xacro"
    path.write_text(TWO_HANDS.format(folder=URDF))
    robot = expanded(path)
    links = {link.get("name") for link in robot.findall("link")}
    children = [joint.find("child").get("link") for joint in robot.findall("joint")]
    assert len(set(children)) == len(children)
    assert links - set(children) == {"left_arm"}
    mounts = {joint.get("name"): joint.find("parent").get("link") for joint in robot.findall("joint")}
    assert (mounts["left_flange_mount"], mounts["right_flange_mount"]) == ("left_arm", "right_arm")

    model = mujoco.MjModel.from_xml_string(ET.tostring(robot, encoding="unicode"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # an open finger's first link begins at its slot; the palm stands in the flange without a turn
    slot_m = np.add(shipped_hand().flange_position_m, shipped_hand().slots["index"].position_m)
    expected_m = [0.1, -0.2, 0.3] + rotation_of((0.4, 0.5, np.pi / 3)) @ slot_m
    assert data.body("left_index_link_0").xpos == pytest.approx(expected_m, abs=1e-9)
    assert data.body("right_index_link_0").xpos == pytest.approx(slot_m, abs=1e-9)


def test_a_finger_set_that_is_not_there_is_named() -> None:
    with pytest.raises(xacro.XacroException, match="claw"):
        expanded(URDF / "hand.urdf.xacro", fingers="claw")


def test_describe_writes_the_macro_of_ones_own_fingers_with_their_meshes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.yaml"
    own.write_text((shipped_directory() / "hook.yaml").read_text().replace("id: hook", "id: my-fingers", 1))
    path = tmp_path / "own.urdf.xacro"
    arguments = [str(own), "--format", "xacro", "--meshes", str(tmp_path / "meshes"), "--output", str(path)]
    assert describe.main(arguments) == 0
    capsys.readouterr()
    path.write_text(path.read_text().replace("</robot>", '<xacro:softgrip_my-fingers prefix="a_"/></robot>'))
    robot = expanded(path)
    meshes = [mesh.get("filename").removeprefix("file://") for mesh in robot.iter("mesh")]
    assert meshes
    assert all(Path(mesh).stat().st_size > 84 for mesh in meshes)
    assert all(link.get("name").startswith("a_") for link in robot.iter("link"))


def test_a_prefix_is_the_macros(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        describe.main(["power", "--format", "xacro", "--prefix", "left_"])
    assert "--prefix: expected none with --format xacro" in capsys.readouterr().err
