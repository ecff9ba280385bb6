# SPDX-License-Identifier: Apache-2.0
"""CDR: the bytes of a real Jazzy rclpy, an independent implementation, and garbage."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import ParameterValue
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Empty, String

from embedded_ros.errors import CdrError
from embedded_ros.messages import Message, deserialize, serialize
from embedded_ros.registry import registry


def joints() -> JointState:
    message = JointState(name=["a", "bc"], position=[1.5, -2.0], velocity=[], effort=[0.25])
    message.header.stamp.sec, message.header.stamp.nanosec = 7, 9
    message.header.frame_id = "tendon"
    return message


def pose() -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "ab"
    message.pose.position.x = 1.0
    return message


# serialize_message of rclpy 7.1.9 on a Jazzy build, rmw_cyclonedds_cpp.
JAZZY_BYTES: list[tuple[Any, str]] = [
    (
        joints(),
        (
            "0001000007000000090000000700000074656e646f6e000002000000020000006100000003000000626300000200000000000000"
            "000000000000f83f00000000000000c00000000001000000000000000000d03f"
        ),
    ),
    (
        DiagnosticStatus(level=b"\x02", name="n", message="µ", values=[KeyValue(key="k", value="v")]),
        "0001000002000000020000006e00000003000000c2b50000010000000000000001000000020000006b000000020000007600",
    ),
    (Empty(), "0001000000"),
    (
        ParameterValue(
            type=9,
            string_array_value=["x", "yz"],
            bool_array_value=[True, False],
            byte_array_value=[b"\x01"],
            integer_array_value=[1, -1],
        ),
        (
            "0001000009000000000000000000000000000000000000000000000001000000000000000100000001000000020000000100000002"
            "000000000000000100000000000000ffffffffffffffff0000000002000000020000007800000003000000797a00"
        ),
    ),
    (
        pose(),
        "0001000000000000000000000300000061620000000000000000f03f" + "00" * 40 + "000000000000f03f",
    ),
]


@pytest.mark.parametrize(("message", "expected"), JAZZY_BYTES, ids=lambda item: type(item).__name__)
def test_bytes_are_those_of_jazzy(message: Message, expected: str) -> None:
    assert serialize(message).hex() == expected
    assert deserialize(bytes.fromhex(expected), type(message)) == message


def test_every_shipped_message_goes_there_and_back_and_rosbags_agrees() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for package in registry().packages():
        for name in registry().names(package, "msg"):
            kind = registry().message(f"{package}/msg/{name}")
            data = bytes(serialize(kind()))
            assert deserialize(data, kind) == kind()
            if f"{package}/msg/{name}" in store.fielddefs:
                theirs = store.deserialize_cdr(data, f"{package}/msg/{name}")
                assert bytes(store.serialize_cdr(theirs, f"{package}/msg/{name}")) == data


@settings(max_examples=100, deadline=None)
@given(
    names=st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))),
    values=st.lists(st.floats(allow_nan=False)),
    frame=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")),
)
def test_any_content_goes_there_and_back(names: list[str], values: list[float], frame: str) -> None:
    message = JointState(name=names, position=values, effort=values[:1])
    message.header.frame_id = frame
    assert deserialize(bytes(serialize(message)), JointState) == message


def test_wide_text_is_one_uint32_per_utf16_unit(tmp_path: Any) -> None:
    from embedded_ros.interface_text import parse_interface  # noqa: PLC0415
    from embedded_ros.messages import make_message  # noqa: PLC0415

    path = tmp_path / "Wide.msg"
    path.write_text("wstring text\n")
    kind = make_message(parse_interface(path, "p", "msg")[0], registry().message)
    data = bytes(serialize(kind(text="aö€")))
    assert data == b"\x00\x01\x00\x00" + b"".join(n.to_bytes(4, "little") for n in (3, 0x61, 0xF6, 0x20AC))
    assert deserialize(data, kind).text == "aö€"  # type: ignore[attr-defined]


def test_long_arrays_are_arrays_whoever_asks_first() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, 200_000, np.uint8)
    image = Image(height=1, width=200_000, encoding="mono8", step=200_000, data=pixels)
    data = bytes(serialize(image))
    received = deserialize(data, Image)
    assert bytes(serialize(received)) == data
    assert np.array_equal(np.frombuffer(received.data, np.uint8), pixels)
    received.data[0] = 1 - received.data[0] % 2
    assert received != image


@pytest.mark.parametrize("cut", [0, 3, 4, 5, 11, 30, 60])
def test_short_data_is_refused(cut: int) -> None:
    with pytest.raises(CdrError):
        deserialize(bytes(serialize(joints()))[:cut], JointState)


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\x00\x00\x00" + b"\0" * 8,
        b"\x00\x01\x00\x00\xff\xff\xff\xff",
        b"\x00\x01\x00\x00\x02\x00\x00\x00\xff\x00",
    ],
    ids=["big-endian", "length beyond the end", "no UTF-8"],
)
def test_garbage_is_refused(data: bytes) -> None:
    with pytest.raises(CdrError, match="String"):
        deserialize(data, String)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=120))
def test_random_bytes_never_do_worse_than_an_error(data: bytes) -> None:
    for kind in (JointState, DiagnosticStatus, CameraInfo):
        try:
            deserialize(b"\x00\x01\x00\x00" + data, kind)
        except CdrError:
            continue


def test_remembered_strings_are_those_of_this_message() -> None:
    one, two = joints(), joints()
    two.name = ["a", "bd"]
    first, second = bytes(serialize(one)), bytes(serialize(two))
    assert first.replace(b"bc\0", b"bd\0") == second
    assert [bytes(serialize(message)) for message in (one, two, two, one)] == [first, second, second, first]
    one.name.append("late")
    assert deserialize(bytes(serialize(one)), JointState).name == ["a", "bc", "late"]
    received = deserialize(first, JointState)
    received.name.append("own")
    assert deserialize(first, JointState).name == ["a", "bc"]
    assert deserialize(second, JointState).name == ["a", "bd"]
    with pytest.raises(TypeError, match=r"JointState.name\[1\]"):
        serialize(JointState(name=["a", 1]))
