# SPDX-License-Identifier: Apache-2.0
"""The layouts for Lichtblick / Foxglove, PlotJuggler and RViz show topics and fields that exist."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from softgrip_bag.nodes.messages import message_class
from softgrip_bag.reader import topic_summaries

ROOT = Path(__file__).resolve().parents[2]
LAYOUTS = ROOT / "ros2_ws/src/softgrip_bag/layouts"
RVIZ = ROOT / "ros2_ws/src/softgrip_description/rviz/hand.rviz"
#: `foo`, `foo[0]`, `foo[:]{finger=="index"}`
_STEP = re.compile(r"(?P<name>[a-z_]\w*)(?P<index>\[(?:\d+|:)\])?(?:\{(?P<key>\w+)==[^}]+\})?")
#: PlotJuggler names a joint's values by its name.
_JOINT_STATE = "sensor_msgs/msg/JointState"
_JOINT_VALUES = {"position", "velocity", "effort"}
#: What a display of rviz_default_plugins subscribes to. Source: its plugins_description.xml in ros2/rviz;
#: Image goes through image_transport, which takes the last part of the name for its transport
#: (src/rviz_default_plugins/displays/image/get_transport_from_topic.cpp).
_SHOWS = {
    "RobotModel": "std_msgs/msg/String",
    "Marker": "visualization_msgs/msg/Marker",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
}
_TRANSPORTS = {"raw": "sensor_msgs/msg/Image", "compressed": "sensor_msgs/msg/CompressedImage"}


#: Too large for a small bag, or younger than the shipped ones.
NOT_RECORDED = {
    "/shape/marker": "visualization_msgs/msg/Marker",
    "/hand/markers": "visualization_msgs/msg/MarkerArray",
    "/robot_description": "std_msgs/msg/String",
}


def recorded_types() -> dict[str, str]:
    return NOT_RECORDED | {
        topic.name: topic.type_name
        for bag in (ROOT / "tests/replay/bags").iterdir()
        if bag.is_dir()
        for topic in topic_summaries(bag)
    }


def field_problem(type_name: str, steps: list[str]) -> str:
    """Return what is wrong with a path of fields, empty when nothing."""
    kind = type_name
    for step in steps:
        found = _STEP.fullmatch(step)
        if found is None:
            return f"{step!r} is no field"
        fields = message_class(kind).get_fields_and_field_types()
        if found["name"] not in fields:
            return f"{kind} has no field {found['name']!r}"
        kind = fields[found["name"]]
        several = kind.startswith("sequence<") or "[" in kind
        if several != bool(found["index"]):
            return f"{step!r} is {kind}"
        kind = re.sub(r"^sequence<(.+?)(?:, \d+)?>$|\[\d+\]$", lambda m: m[1] or "", kind)
        package, _, name = kind.partition("/")
        kind = f"{package}/msg/{name}" if name else kind
        if found["key"] and found["key"] not in message_class(kind).get_fields_and_field_types():
            return f"{kind} has no field {found['key']!r}"
    return "" if "/" not in kind else f"{'.'.join(steps)} is a whole {kind}"


def lichtblick() -> Iterator[tuple[str, list[str]]]:
    """Yield topic and fields of everything that the Lichtblick layout shows."""

    def walk(value: Any) -> Iterator[str]:
        if isinstance(value, dict):
            if isinstance(value.get("value"), str):
                yield value["value"]
            for item in value.values():
                yield from walk(item)
        elif isinstance(value, list):
            for item in value:
                yield from walk(item)

    panels = json.loads((LAYOUTS / "softgrip.lichtblick.json").read_text())["configById"]
    for path in walk(panels):
        topic, *steps = path.split(".")
        yield topic, steps
    for panel in panels.values():
        for topic in panel.get("topics", {}):
            yield topic, []
        layers = [layer["topic"] for layer in panel.get("layers", {}).values() if layer.get("sourceType") == "topic"]
        for topic in (panel.get("imageMode", {}).get("imageTopic"), panel.get("topicToRender"), *layers):
            if topic:
                yield topic, []


def plotjuggler() -> Iterator[tuple[str, list[str]]]:
    """Yield topic and fields of everything that the PlotJuggler layout shows."""
    types = recorded_types()
    tree = ET.parse(LAYOUTS / "softgrip.plotjuggler.xml")
    for curve in tree.iter("curve"):
        name = curve.attrib["name"]
        topic = max((topic for topic in types if name.startswith(f"{topic}/")), key=len, default=name)
        steps = name.removeprefix(topic).strip("/").split("/")
        if types.get(topic) == _JOINT_STATE:
            assert steps[-1] in _JOINT_VALUES
            steps = [f"{steps[-1]}[0]"]
        yield topic, steps


@pytest.mark.parametrize("layout", [lichtblick, plotjuggler])
def test_everything_shown_exists(layout: Any) -> None:
    types = recorded_types()
    shown = list(layout())
    assert len(shown) > 15
    for topic, steps in shown:
        assert topic in types, f"{topic} is in no recorded bag"
        if steps:
            assert field_problem(types[topic], steps) == "", topic


def rviz_displays() -> list[dict[str, Any]]:
    """Return the displays of the RViz configuration that have a topic."""
    displays = yaml.safe_load(RVIZ.read_text())["Visualization Manager"]["Displays"]
    return [one for one in displays if "Topic" in one or "Description Topic" in one]


def test_rviz_shows_topics_that_exist_with_the_type_that_it_expects() -> None:
    types = recorded_types()
    shown = rviz_displays()
    assert len(shown) == 4
    for display in shown:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        topic = display.get("Topic") or display["Description Topic"]
        assert not topic["Value"].startswith("/"), "a cell's topics are in its namespace"
        expected = _SHOWS.get(kind) or _TRANSPORTS.get(topic["Value"].rpartition("/")[2], _TRANSPORTS["raw"])
        assert types.get(f"/{topic['Value']}") == expected, display["Name"]


def test_rviz_has_a_tool_that_turns_the_view() -> None:
    """Without tools of its configuration RViz has none, and the mouse does nothing (rviz_common, ToolManager::load)."""
    tools = yaml.safe_load(RVIZ.read_text())["Visualization Manager"]["Tools"]
    assert "rviz_default_plugins/MoveCamera" in {tool["Class"] for tool in tools}


def test_every_panel_has_its_place() -> None:
    layout = json.loads((LAYOUTS / "softgrip.lichtblick.json").read_text())

    def placed(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])

    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])


def test_a_wrong_field_is_found() -> None:
    kind = "softgrip_interfaces/msg/FingerStates"
    assert field_problem(kind, ["fingers[0]", "tip", "x"]) == ""
    assert field_problem(kind, ['fingers[:]{finger=="index"}', "joint_angles[2]"]) == ""
    assert "no field" in field_problem(kind, ["fingers[0]", "tips", "x"])
    assert "sequence" in field_problem(kind, ["fingers", "tip", "x"])
    assert "whole" in field_problem(kind, ["fingers[0]", "tip"])
    assert "no field 'name'" in field_problem(kind, ['fingers[:]{name=="index"}', "tension"])
