# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.nodes.parameter_snapshot import without_secrets
from softgrip_bag.redaction import redact


@pytest.mark.parametrize(
    ("name", "value", "clean"),
    [
        ("database_url", "postgresql://me:hunter2@host:5432/cell", "postgresql://me:***@host:5432/cell"),
        ("database_url", "postgresql://me:a@b@host/cell", "postgresql://me:***@host/cell"),
        ("camera", "rtsp://:hunter2@10.0.0.1/live", "rtsp://:***@10.0.0.1/live"),
        (
            "database_url",
            "postgresql://host/cell?user=me&password=hunter2&x=1",
            "postgresql://host/cell?user=me&password=***&x=1",
        ),
        ("conninfo", "host=h password='two words' dbname=c", "host=h password=*** dbname=c"),
        ("mqtt_password", "hunter2", "***"),
        ("api_key", ["one", "two"], ["***", "***"]),
        ("urls", ["http://a:b@c", "plain"], ["http://a:***@c", "plain"]),
    ],
)
def test_a_secret_is_taken_out_and_named(name: str, value: object, clean: object) -> None:
    assert redact({name: value, "rate_hz": 5.0}) == ({name: clean, "rate_hz": 5.0}, [name])


@pytest.mark.parametrize(
    "value",
    ["sqlite:////var/lib/softgrip/cell.db", "postgresql://me@host/cell", "@/tmp/camera.url", 3, 2.5, True, [1, 2], ""],
)
def test_what_is_no_secret_stays(value: object) -> None:
    assert redact({"database_url": value}) == ({"database_url": value}, [])


def test_parameter_events_go_into_a_bag_without_secrets() -> None:
    def parameter(name: str, text: str) -> Parameter:
        return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text))

    plain = bytes(serialize_message(ParameterEvent(node="/n", new_parameters=[parameter("a", "b")])))
    assert without_secrets(plain) == plain
    event = ParameterEvent(
        node="/n",
        new_parameters=[parameter("url", "postgresql://me:hunter2@h/c"), parameter("a", "b")],
        changed_parameters=[parameter("token", "hunter2")],
    )
    clean = without_secrets(bytes(serialize_message(event)))
    assert b"hunter2" not in clean
    read = deserialize_message(clean, ParameterEvent)
    assert [p.value.string_value for p in read.new_parameters] == ["postgresql://me:***@h/c", "b"]
    assert without_secrets(b"\0\1\0\0\xff\xff") == b"\0\1\0\0\xff\xff"
