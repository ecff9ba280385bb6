# SPDX-License-Identifier: Apache-2.0
"""A user's node class shares its namespace with Node: no name that rclpy leaves free may be taken here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from std_msgs.msg import String

# The private names that Node and LifecycleNode of rclpy 7.1 have (rclpy/node.py, lifecycle/node.py), too.
TAKEN = {
    "_allow_undeclared_parameters", "_clients", "_clock", "_context", "_default_callback_group", "_descriptors",
    "_guards", "_logger", "_logger_service", "_managed_entities", "_on_set_parameters_callbacks",
    "_parameter_event_publisher", "_parameter_overrides", "_parameter_service", "_parameters",
    "_post_set_parameters_callbacks", "_pre_set_parameters_callbacks", "_publishers", "_services",
    "_set_parameters_atomically_common", "_state_machine", "_subscriptions", "_time_source", "_timers",
    "_type_description_service", "_wake_executor",
}  # fmt: skip


def test_private_names_are_rclpys_or_marked(context: Context) -> None:
    node = LifecycleNode("n", context=context)
    names = {*vars(node), *(name for kind in LifecycleNode.__mro__[:-1] for name in vars(kind))}
    private = {name for name in names if name.startswith("_") and not name.startswith("__")}
    assert {name for name in private - TAKEN if not name.startswith("_rcl_")} == set()
    node.destroy_node()


def test_a_node_may_use_any_other_name_for_itself(context: Context, spin_until: Callable[..., bool]) -> None:
    class Own(Node):
        def __init__(self) -> None:
            super().__init__("own", context=context)
            self._name = self._link = self._arguments = self._token = self._namespace = self._executor = "mine"
            self._entities = self._entity_list = self._waitables = self._rates = self._destroyed = ["mine"]
            self.heard: list[str] = []
            self.create_subscription(String, "t", self._store, 10)

        def _store(self, message: Any) -> None:
            self.heard.append(message.data)

        def _wake(self) -> None:
            raise AssertionError("not rclpy's")

        _changed = _adopt = _remapped = _profile = _group = _problem = _declare = _wake

        def destroy(self) -> None:
            raise AssertionError("not rclpy's")

    node = Own()
    publisher = node.create_publisher(String, "t", 10)
    node.declare_parameter("p", 1)
    publisher.publish(String(data="a"))
    assert spin_until(lambda: node.heard == ["a"], node)
    assert (node.get_name(), node.get_parameter("p").value) == ("own", 1)
    node.destroy_node()
