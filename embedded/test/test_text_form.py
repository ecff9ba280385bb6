# SPDX-License-Identifier: Apache-2.0
"""Messages as text; the expected text is what ros2cli 0.32 prints for the same message."""

from __future__ import annotations

import argparse
import math
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovariance
from sensor_msgs.msg import JointState

from embedded_ros.commands.topic_messages import _shown, add_echo
from embedded_ros.text_form import FieldError, fill, parse_values, to_yaml

HEADER = "header:\n  stamp:\n    sec: 5\n    nanosec: 0\n  frame_id: base\n"


@pytest.fixture
def joints() -> Any:
    message = JointState(name=["a", "b"], position=[0.1, 2.0], velocity=[1e-9, math.inf])
    message.header.frame_id = "base"
    message.header.stamp.sec = 5
    return message


def echoed(message: Any, *options: str) -> str | None:
    parser = argparse.ArgumentParser()
    add_echo(parser)
    return _shown(message, parser.parse_args(["/joints", *options]))


def test_a_message_is_yaml(joints: Any) -> None:
    assert echoed(joints) == (
        f"{HEADER}name:\n- a\n- b\nposition:\n- 0.1\n- 2.0\nvelocity:\n- 1.0e-09\n- .inf\neffort: []\n---\n"
    )


def test_flow_style_keeps_messages_in_lines_of_their_own(joints: Any) -> None:
    assert echoed(joints, "--flow-style") == (
        f"{HEADER}name: [a, b]\nposition: [0.1, 2.0]\nvelocity: [1.0e-09, .inf]\neffort: []\n---\n"
    )


def test_arrays_and_text_by_their_length(joints: Any) -> None:
    assert to_yaml(joints, arrays=False).splitlines()[5:] == [
        "name: '<sequence type: string, length: 2>'",
        "position: '<sequence type: double, length: 2>'",
        "velocity: '<sequence type: double, length: 2>'",
        "effort: '<sequence type: double, length: 0>'",
    ]
    assert to_yaml(PoseWithCovariance(), arrays=False).splitlines()[-1] == "covariance: '<array type: double[36]>'"
    assert to_yaml(joints, strings=False).splitlines()[4:7] == [
        "  frame_id: '<string length: <4>>'",
        "name:",
        "- '<string length: <1>>'",
    ]


def test_csv_and_single_fields(joints: Any) -> None:
    assert echoed(joints, "--csv") == "5,0,base,a,b,0.1,2.0,1e-09,inf,\n"
    assert echoed(joints, "--field", "header.stamp") == "sec: 5\nnanosec: 0\n---\n"
    assert echoed(joints, "--field", "position") == "array('d', [0.1, 2.0])\n---\n"
    assert echoed(joints, "--field", "header.stamp", "--filter", "m.sec > 5") is None
    with pytest.raises(FieldError, match="Invalid field 'nope': 'JointState' object has no attribute 'nope'"):
        echoed(joints, "--field", "nope")


def test_values_of_the_command_line_fill_a_message() -> None:
    message = JointState()
    stamps = fill(message, parse_values("{header: auto, name: [x, 2], position: [1, 2.5]}"))
    assert (message.name, list(message.position), len(stamps)) == (["x", "2"], [1.0, 2.5], 1)
    with pytest.raises(FieldError, match=r"JointState has no field 'names'; it has: header, name"):
        fill(message, {"names": []})
    with pytest.raises(FieldError, match="not valid YAML"):
        parse_values("[1, 2")
    with pytest.raises(FieldError, match="needs to be a dictionary"):
        parse_values("auto")
