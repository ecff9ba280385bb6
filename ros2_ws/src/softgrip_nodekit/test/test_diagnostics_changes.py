# SPDX-License-Identifier: Apache-2.0
"""When the health of a component is published and logged, and that no number that is none is a parameter."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from builtin_interfaces.msg import Time

from softgrip_nodekit import Diagnostics, Health, Parameter


class Recorder:
    """Stands where a node does, and keeps what it published and logged."""

    def __init__(self) -> None:
        self.published: list[Any] = []
        self.logged: list[str] = []
        self.context = SimpleNamespace(ok=lambda: True)

    def create_publisher(self, *_: object) -> Any:
        return SimpleNamespace(publish=self.published.append)

    def create_timer(self, *_: object, **__: object) -> Any:
        return SimpleNamespace(cancel=lambda: None)

    def get_logger(self) -> Any:
        return SimpleNamespace(
            error=lambda text: self.logged.append(f"error {text}"),
            warning=lambda text: self.logged.append(f"warning {text}"),
            info=lambda text: self.logged.append(f"info {text}"),
        )

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=Time))

    def get_fully_qualified_name(self) -> str:
        return "/left/driver"

    def get_namespace(self) -> str:
        return "/left"


def test_a_change_of_level_is_published_at_once_and_logged_and_the_same_level_is_not() -> None:
    node = Recorder()
    diagnostics = Diagnostics(node)
    published = []
    for health in (Health.OK, Health.OK, Health.ERROR, Health.ERROR, Health.WARN, Health.OK):
        before = len(node.published)
        diagnostics.set("bus", health, "text")
        published.append(len(node.published) - before)
    assert published == [1, 0, 1, 0, 1, 1]
    assert node.logged == ["error bus: text", "warning bus: text"]
    assert [message.status[0].level for message in node.published] == [b"\x00", b"\x02", b"\x01", b"\x00"]


@pytest.mark.parametrize("value", [math.nan, [1.0, math.nan]])
def test_no_number_is_a_parameter_that_is_none(value: Any) -> None:
    assert "found nan" in str(Parameter("offset", 0.0, "without bounds").problem(value))


def test_the_name_of_a_component_says_which_cell_it_is_of() -> None:
    """/diagnostics is one topic for all cells; REP-107 asks for a hardware id."""
    node = Recorder()
    Diagnostics(node).set("bus", Health.OK, "text")
    Diagnostics(node, "serial-7").set("bus", Health.OK, "text")
    found = [(status.name, status.hardware_id) for message in node.published for status in message.status]
    assert ("left/driver: bus", "left") in found
    assert ("left/driver: bus", "serial-7") in found
