# SPDX-License-Identifier: Apache-2.0
"""Whom the recorder asks for parameters, and what it does where it may not ask."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from rclpy.node import Node

from softgrip_bag.nodes.parameter_snapshot import ParameterSnapshot


class FakeNode:
    """Sees nodes, and makes clients as a DDS with access control does: for granted names only."""

    def __init__(self, seen: list[str], granted: list[str]) -> None:
        self._seen = seen
        self._granted = granted
        self.asked: list[str] = []
        self.destroyed: list[str] = []
        self.warnings: list[str] = []

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(name, "/") for name in self._seen]

    def get_fully_qualified_name(self) -> str:
        return "/recorder"

    def get_namespace(self) -> str:
        return "/"

    def create_client(self, _: Any, name: str) -> Any:
        self.asked.append(name)
        if name not in self._granted:
            raise RuntimeError("failed to create client: create_client() failed to create response DataReader")
        return SimpleNamespace(name=name, service_is_ready=lambda: False)

    def destroy_client(self, client: Any) -> None:
        self.destroyed.append(client.name)

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warnings.append)


@pytest.fixture
def looked(request: pytest.FixtureRequest) -> Any:
    node = FakeNode(*request.param)
    snapshot = ParameterSnapshot(cast("Node", node), lambda _: None, [])
    snapshot.ask_nodes()
    snapshot.ask_nodes()
    snapshot.close()
    return SimpleNamespace(node=node, snapshot=snapshot)


@pytest.mark.parametrize(
    "looked",
    [(["recorder", "stranger", "camera"], ["/camera/list_parameters", "/camera/get_parameters"])],
    indirect=True,
)
def test_a_node_that_may_not_be_asked_is_named_once_and_the_others_are_asked(looked: Any) -> None:
    assert looked.node.asked == [
        "/stranger/list_parameters",
        "/camera/list_parameters",
        "/camera/get_parameters",
    ]
    assert [warning.partition(":")[0] for warning in looked.node.warnings] == ["/stranger"]
    assert "may not be asked" in looked.snapshot.refused[0]


@pytest.mark.parametrize("looked", [(["camera"], ["/camera/list_parameters"])], indirect=True)
def test_a_client_whose_other_half_is_refused_is_given_back(looked: Any) -> None:
    assert looked.node.destroyed == ["/camera/list_parameters"]


@pytest.mark.parametrize("looked", [(["_ros2cli_2581"], [])], indirect=True)
def test_a_command_that_is_here_for_a_moment_is_not_asked(looked: Any) -> None:
    assert looked.node.asked == []
    assert looked.snapshot.refused == []
