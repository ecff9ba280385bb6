# SPDX-License-Identifier: Apache-2.0
"""Interface text, the classes made from it, their hashes and what they refuse."""

from __future__ import annotations

import array
import copy
import pickle
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from example_interfaces.action import Fibonacci
from example_interfaces.srv import AddTwoInts
from geometry_msgs.msg import PoseStamped, Quaternion
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CameraInfo, JointState, NavSatStatus
from std_msgs.msg import ColorRGBA, String, UInt8
from std_srvs.srv import SetBool, Trigger

from embedded_ros.errors import InterfaceError, UnknownInterfaceError
from embedded_ros.interface_text import parse_interface
from embedded_ros.messages import serialize
from embedded_ros.registry import registry

# What rosidl wrote into the install space of a real Jazzy build (share/<pkg>/<kind>/<Name>.json).
JAZZY_HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "std_msgs/msg/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "example_interfaces/srv/AddTwoInts": "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
    "example_interfaces/action/Fibonacci": "9508051da1ea4658de144b09bd0690ff3de52104683d847aed764d2915906f51",
    "rcl_interfaces/msg/Log": "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    "lifecycle_msgs/srv/ChangeState": "356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
    "visualization_msgs/msg/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
}
# rosbags hashes char as its own type; rosidl hashes it as uint8.
WRONG_IN_ROSBAGS = {"std_msgs/msg/Char", "service_msgs/msg/ServiceEventInfo"}


@pytest.mark.parametrize("name", JAZZY_HASHES)
def test_hash_is_that_of_a_jazzy_build(name: str) -> None:
    assert registry().interface(name).DEFINITION.type_hash == f"RIHS01_{JAZZY_HASHES[name]}"


def test_every_shipped_message_has_the_hash_an_independent_implementation_gives() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    compared = 0
    for package in registry().packages():
        for name in registry().names(package, "msg"):
            full = f"{package}/msg/{name}"
            if full in store.fielddefs and full not in WRONG_IN_ROSBAGS:
                assert registry().message(full).DEFINITION.type_hash == store.hash_rihs01(full), full
                compared += 1
    assert compared > 130


def test_a_field_may_have_the_name_of_a_helper() -> None:
    request = registry().service("type_description_interfaces/srv/GetTypeDescription").Request(type_hash="x")
    assert request.type_hash == "x"
    assert request.include_type_sources is True


def test_constructor_takes_fields_by_keyword_and_fills_defaults() -> None:
    assert (Quaternion().w, Quaternion().x) == (1.0, 0.0)
    assert NavSatStatus().status == -2
    assert PoseStamped().pose.orientation.w == 1.0
    assert String(data="a").data == "a"
    with pytest.raises(AssertionError, match=r"wrong.*fields are data"):
        String(wrong=1)


def test_defaults_are_not_shared() -> None:
    first, second = JointState(), JointState()
    first.position.append(1.0)
    first.header.frame_id = "a"
    assert (list(second.position), second.header.frame_id) == ([], "")


def test_arrays_are_stored_as_rosidl_stores_them() -> None:
    state = JointState(position=[1.0, 2.0])
    assert state.position == array.array("d", [1.0, 2.0])
    state.position = np.array([3.0, 4.0])
    assert state.position == array.array("d", [3.0, 4.0])
    info = CameraInfo()
    info.k = [float(i) for i in range(9)]
    assert isinstance(info.k, np.ndarray)
    assert info.k.dtype == np.float64
    assert JointState.get_fields_and_field_types()["position"] == "sequence<double>"
    assert CameraInfo.get_fields_and_field_types()["k"] == "double[9]"
    assert PoseStamped.get_fields_and_field_types() == {"header": "std_msgs/Header", "pose": "geometry_msgs/Pose"}


def test_equality_copy_and_pickle() -> None:
    state = JointState(name=["a"], position=[1.0])
    assert copy.deepcopy(state) == state == pickle.loads(pickle.dumps(state))  # our own bytes
    other = copy.deepcopy(state)
    other.position[0] = 2.0
    assert other != state
    assert state != String()
    assert CameraInfo() == CameraInfo()


def test_constants_are_read_only() -> None:
    assert DiagnosticStatus.WARN == b"\x01"
    with pytest.raises(AttributeError, match="constant"):
        DiagnosticStatus.WARN = b"\x02"


def test_services_and_actions_have_their_parts() -> None:
    assert SetBool.Request(data=True).data is True
    assert Trigger.Response().message == ""
    with pytest.raises(NotImplementedError):
        AddTwoInts()
    assert Fibonacci.Impl.SendGoalService.Request().goal == Fibonacci.Goal()
    assert Fibonacci.Impl.FeedbackMessage().goal_id.uuid.shape == (16,)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (PoseStamped(), r"PoseStamped.pose.position.x: expected float, found builtins.int 1"),
        (String(data=3), r"String.data: expected str, found builtins.int 3"),
        (UInt8(data=256), r"UInt8.data: expected uint8 in \[0, 255\], found 256"),
        (UInt8(data=np.int64(3)), r"UInt8.data: expected int, found numpy.int64"),
        (Time(sec=1.0), r"Time.sec: expected int, found builtins.float 1.0"),
        (ColorRGBA(r=1e39), r"ColorRGBA.r: expected a float32"),
        (JointState(name="ab"), r"JointState.name: expected a sequence of string, found builtins.str 'ab'"),
        (JointState(name=["a", None]), r"JointState.name\[1\]: expected str, found builtins.NoneType None"),
        (DiagnosticStatus(level=1), r"DiagnosticStatus.level: expected bytes of length 1"),
        (PoseStamped(pose=String()), r"PoseStamped.pose: expected geometry_msgs/msg/Pose, found std_msgs.msg.String"),
        (String(data="\ud800"), r"String.data: expected text that UTF-8 can hold"),
    ],
)
def test_what_ros2_would_abort_for_is_refused_by_name(message: object, expected: str) -> None:
    if isinstance(message, PoseStamped) and isinstance(message.pose, type(PoseStamped().pose)):
        message.pose.position.x = 1
    with pytest.raises((TypeError, ValueError), match=expected):
        serialize(message)  # type: ignore[arg-type]  # wrong on purpose


def test_assignment_is_checked_when_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", "1")
    from embedded_ros.messages import make_message  # noqa: PLC0415  the setting is read when a class is made

    path = tmp_path / "Checked.msg"
    path.write_text("float64 x\nuint8[<=2] few\n")
    (text,) = parse_interface(path, "p", "msg")
    checked = make_message(text, registry().message)()
    with pytest.raises(AssertionError, match="'x' field"):
        checked.x = 1  # type: ignore[attr-defined]
    with pytest.raises(AssertionError, match="'few' field"):
        checked.few = [1, 2, 3]  # type: ignore[attr-defined]


def test_bounds_defaults_comments_and_constants_are_parsed(tmp_path: Path) -> None:
    path = tmp_path / "All.msg"
    path.write_text(
        "# head\nstring<=4[<=2] words [\"a#b\", 'c']  # why\nint8[3] three [1, -2, 3]\nString other\n"
        'string TEXT="x # y"\nfloat32 PI=3.14\nwstring wide "ö"\nbool on true\n'
    )
    (text,) = parse_interface(path, "std_msgs", "msg")
    fields = {field.name: field for field in text.fields}
    assert fields["words"].default == ["a#b", "c"]
    assert (fields["words"].type.text_bound, fields["words"].type.size) == (4, 2)
    assert fields["three"].default == [1, -2, 3]
    assert fields["other"].type.base == "std_msgs/msg/String"
    assert text.constants == (("TEXT", "string", "x # y"), ("PI", "float32", 3.14))
    assert fields["on"].default is True


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("float x", "unknown type 'float'"),
        ("int32 Bad", "expected 'type name'"),
        ("int8 x 200", "expected a value of type int8, found '200'"),
        ("int32[2] x [1]", "expected 2 default values, found 1"),
        ("int32<=3 x", "only string and wstring take a bound"),
        ("bool x maybe", "expected a value of type bool"),
        ("int8 x\nint8 x", "field 'x' is there twice"),
    ],
)
def test_text_that_does_not_parse_names_file_and_line(tmp_path: Path, line: str, expected: str) -> None:
    path = tmp_path / "Bad.msg"
    path.write_text("# first\n" + line + "\n")
    with pytest.raises(InterfaceError, match=expected) as error:
        parse_interface(path, "p", "msg")
    assert str(error.value).startswith(f"{path}:")


def test_a_service_needs_its_separator(tmp_path: Path) -> None:
    path = tmp_path / "Bad.srv"
    path.write_text("int8 a\n")
    with pytest.raises(InterfaceError, match="expected 1 line"):
        parse_interface(path, "p", "srv")


def test_a_constant_that_jazzy_would_give_to_the_wrong_part_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "Bad.action"
    path.write_text("uint8 NONE=0\nuint8 mode\n---\nuint8 NONE=1\n---\nuint8 NONE=0\nuint8 phase\n")
    with pytest.raises(InterfaceError, match=r"'NONE' is the same in Bad_Goal and Bad_Feedback.*another name"):
        parse_interface(path, "p", "action")


def test_parts_are_found_where_rosidl_has_them_and_nowhere_else() -> None:
    assert Fibonacci.Result is not Fibonacci.Goal
    with pytest.raises(ImportError):
        from example_interfaces.action import Fibonacci_Result  # noqa: F401, PLC0415
    with pytest.raises(ImportError):
        from std_srvs.srv import Trigger_Request  # noqa: F401, PLC0415


def test_an_unknown_type_says_what_there_is() -> None:
    with pytest.raises(UnknownInterfaceError, match=r"std_msgs/msg has: .*String"):
        registry().interface("std_msgs/msg/Nope")
    with pytest.raises(UnknownInterfaceError, match="no package 'nope'"):
        registry().interface("nope/msg/Nope")
    with pytest.raises(ImportError):
        from std_msgs.msg import Nope  # noqa: F401, PLC0415
