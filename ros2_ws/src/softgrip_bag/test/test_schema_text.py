# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from rclpy.serialization import serialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import interface_text, message_class
from softgrip_bag.schema_text import SEPARATOR, referenced, schema_text

pytest.importorskip("rosbags")
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FILES = {
    (
        "a_msgs",
        "msg",
        "Top",
    ): "std_msgs/Header header\nInner[] parts  # a comment with Word word\nfloat64 x\nuint8 K=1\n",
    ("a_msgs", "msg", "Inner"): "string<=8 name 'x'\ngeometry_msgs/Point[2] corners\nwstring other\n",
    ("std_msgs", "msg", "Header"): "builtin_interfaces/Time stamp\nstring frame_id\n",
    ("builtin_interfaces", "msg", "Time"): "int32 sec\nuint32 nanosec\n",
    ("geometry_msgs", "msg", "Point"): "float64 x\nfloat64 y\nfloat64 z\n",
    ("a_msgs", "action", "Go"): "int32 goal\n---\nbool done\n---\nInner now\n",
    ("unique_identifier_msgs", "msg", "UUID"): "uint8[16] uuid\n",
}


def find(package: str, kind: str, name: str) -> str:
    return FILES[package, kind, name]


def test_everything_that_a_type_contains_follows_it_once() -> None:
    text = schema_text("a_msgs/msg/Top", find)
    headings = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert headings == [
        "MSG: std_msgs/Header",
        "MSG: a_msgs/Inner",
        "MSG: builtin_interfaces/Time",
        "MSG: geometry_msgs/Point",
    ]
    assert text.count(SEPARATOR) == 4
    assert text.startswith("std_msgs/Header header\n")


def test_an_independent_parser_reads_the_schema() -> None:
    types = get_types_from_msg(schema_text("a_msgs/msg/Top", find), "a_msgs/msg/Top")
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    assert {"a_msgs/msg/Top", "a_msgs/msg/Inner", "std_msgs/msg/Header"} <= set(types)


def test_feedback_topics_of_actions_get_the_message_rosidl_derives() -> None:
    text = schema_text("a_msgs/action/Go_FeedbackMessage", find)
    assert text.startswith("unique_identifier_msgs/UUID goal_id\na_msgs/action/Go_Feedback feedback")
    assert "MSG: a_msgs/action/Go_Feedback\na_msgs/Inner now" in text
    assert "MSG: geometry_msgs/Point" in text


def test_a_message_of_the_same_package_in_a_feedback_is_found_by_an_independent_parser() -> None:
    name = "a_msgs/action/Go_FeedbackMessage"
    types = get_types_from_msg(schema_text(name, find), name)
    (_, (_, inner)) = types["a_msgs/action/Go_Feedback"][1][0]
    assert inner in types


def test_the_feedback_type_has_the_hash_that_rosidl_gave_it() -> None:
    """example_interfaces/action/Fibonacci in a ROS 2 Jazzy installation."""
    files = {
        ("example_interfaces", "action", "Fibonacci"): "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n",
        ("unique_identifier_msgs", "msg", "UUID"): "uint8[16] uuid\n",
    }
    name = "example_interfaces/action/Fibonacci_FeedbackMessage"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(name, lambda *key: files[key]), name))
    assert store.hash_rihs01(name) == "RIHS01_c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2"


def test_constants_comments_and_primitives_are_no_references() -> None:
    text = "uint8 A=1\nfloat64[3] v\n# Point p\nstring s 'Point q'\nPoint p\n"
    assert list(referenced(text, "m")) == [("m", "Point")]


@pytest.mark.parametrize("name", ["String", "std_msgs/String", "a/b/c/d"])
def test_a_type_name_of_another_form_is_refused(name: str) -> None:
    with pytest.raises(BagError, match="expected a type like"):
        schema_text(name, find)


def test_the_events_of_a_service_are_read_by_others_from_their_schema() -> None:
    from std_srvs.srv import SetBool  # noqa: PLC0415  as the recorder meets it

    name = "std_srvs/srv/SetBool_Event"
    event = SetBool.Event(request=[SetBool.Request(data=True)])
    event.info.sequence_number = 7
    assert message_class(name) is SetBool.Event
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(name, interface_text), name))
    found = store.deserialize_cdr(serialize_message(event), "std_srvs/srv/msg/SetBool_Event")  # rosbags' name for it
    assert found.info.sequence_number == 7
    assert [request.data for request in found.request] == [True]
    assert list(found.response) == []
