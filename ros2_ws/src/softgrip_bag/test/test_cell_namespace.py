# SPDX-License-Identifier: Apache-2.0
"""Which cell a bag is of, and what of the shared topics belongs to it."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import Log, ParameterEvent
from tf2_msgs.msg import TFMessage

from softgrip_bag.cell_namespace import cell_namespace, is_below, is_of_cell, is_shared
from softgrip_bag.errors import BagError


@pytest.mark.parametrize(
    ("topics", "namespace"),
    [
        (["/tendon/state", "/cell/state", "/rosout"], ""),
        (["/cell_2/tendon/state", "/cell_2/finger/predicted", "/diagnostics"], "/cell_2"),
        (["/hall/cell_2/grasp_mix_manager/trace"], "/hall/cell_2"),
        (["/rosout", "/something"], ""),
    ],
)
def test_the_namespace_of_a_bag_is_that_of_its_topics(topics: list[str], namespace: str) -> None:
    assert cell_namespace(topics) == namespace


def test_a_bag_of_two_cells_is_refused_by_their_names() -> None:
    with pytest.raises(BagError, match="found /, /cell_2"):
        cell_namespace(["/tendon/state", "/cell_2/tendon/state"])


def test_a_name_that_only_begins_alike_is_not_below() -> None:
    assert is_below("/cell_1/tendon/state", "/cell_1")
    assert not is_below("/cell_10/tendon/state", "/cell_1")
    assert is_below("/anything", "/")


def test_what_all_cells_share_stands_at_the_root() -> None:
    assert is_shared("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    assert is_shared("/clock", "rosgraph_msgs/msg/Clock")
    assert not is_shared("/cell_2/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    assert not is_shared("/joint_states", "sensor_msgs/msg/JointState")


def test_messages_on_shared_topics_belong_to_whom_they_name() -> None:
    def diagnosed(*names: str) -> DiagnosticArray:
        return DiagnosticArray(status=[DiagnosticStatus(name=f"{name}: bus") for name in names])

    def moved(*frames: str) -> TFMessage:
        return TFMessage(transforms=[TransformStamped(child_frame_id=frame) for frame in frames])

    own = {
        "diagnostic_msgs/msg/DiagnosticArray": diagnosed("a/tendon_driver"),
        "rcl_interfaces/msg/Log": Log(name="a.tendon_driver"),
        "rcl_interfaces/msg/ParameterEvent": ParameterEvent(node="/a/tendon_driver"),
        "tf2_msgs/msg/TFMessage": moved("a/palm", "a/tcp"),
    }
    foreign = {
        "diagnostic_msgs/msg/DiagnosticArray": diagnosed("a/tendon_driver", "ab/tendon_driver"),
        "rcl_interfaces/msg/Log": Log(name="ab.tendon_driver"),
        "rcl_interfaces/msg/ParameterEvent": ParameterEvent(node="/ab/tendon_driver"),
        "tf2_msgs/msg/TFMessage": moved("a/palm", "palm"),
    }
    for kind, message in own.items():
        assert is_of_cell(kind, message, "/a"), kind
    for kind, message in foreign.items():
        assert not is_of_cell(kind, message, "/a"), kind
