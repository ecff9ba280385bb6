# SPDX-License-Identifier: Apache-2.0
"""Asks every node for its parameters, and takes along the files that they name."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from softgrip_bag.context import FILE_PARAMETERS, parameter_attachment, parameter_files
from softgrip_bag.mcap_file import Attachment

#: [s] a node that has not answered until then is asked anew.
PATIENCE_S = 5.0


class ParameterSnapshot:
    """Call `look` now and then: every node that has appeared is asked once.

    Args:
        node: whose clients are used.
        found: called with each attachment: a node's parameters, or a file that they name.
    """

    def __init__(self, node: Node, found: Callable[[Attachment], None]) -> None:
        self._node = node
        self._found = found
        self._asked: dict[str, float] = {}
        self._answered: set[str] = set()
        self._clients: dict[str, tuple[Any, Any]] = {}
        self._missing_files: dict[tuple[str, str], str] = {}

    @property
    def nodes(self) -> int:
        """How many nodes have answered."""
        return len(self._answered)

    @property
    def missing(self) -> list[str]:
        """Files that parameters name and that could not be read so far."""
        return [f"{node}: {parameter} = {path}" for (node, parameter), path in self._missing_files.items()]

    def look(self) -> None:
        """Ask nodes that have not answered; try again to read files that were not there."""
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = f"{namespace.rstrip('/')}/{name}"
            if full not in self._answered and full != self._node.get_fully_qualified_name():
                self._ask(full)
        for (node, parameter), path in list(self._missing_files.items()):
            self._take_files(node, parameter, path)

    def add_own(self, values: dict[str, Any]) -> None:
        """Take this node's own parameters."""
        self._take(self._node.get_fully_qualified_name(), values)

    def _ask(self, full: str) -> None:
        now = time.monotonic()
        if now - self._asked.get(full, float("-inf")) < PATIENCE_S:
            return
        if full not in self._clients:
            self._clients[full] = (
                self._node.create_client(ListParameters, f"{full}/list_parameters"),
                self._node.create_client(GetParameters, f"{full}/get_parameters"),
            )
        names, _ = self._clients[full]
        if names.service_is_ready():
            self._asked[full] = now
            names.call_async(ListParameters.Request()).add_done_callback(lambda done: self._on_names(full, done))

    def _on_names(self, full: str, done: Any) -> None:
        if done.exception() is not None or full not in self._clients:
            return
        names = list(done.result().result.names)
        future = self._clients[full][1].call_async(GetParameters.Request(names=names))
        future.add_done_callback(lambda answer: self._on_values(full, names, answer))

    def _on_values(self, full: str, names: list[str], done: Any) -> None:
        if done.exception() is not None or full in self._answered:
            return
        values = [parameter_value_to_python(value) for value in done.result().values]
        self._take(full, dict(zip(names, values, strict=False)))
        for client in self._clients.pop(full, ()):
            self._node.destroy_client(client)

    def _take(self, full: str, values: dict[str, Any]) -> None:
        self._answered.add(full)
        plain = {name: list(v) if hasattr(v, "typecode") else v for name, v in values.items() if v is not None}
        self._found(parameter_attachment(full, plain))
        for parameter in FILE_PARAMETERS & plain.keys():
            if plain[parameter]:
                self._take_files(full, parameter, str(plain[parameter]))

    def _take_files(self, full: str, parameter: str, path: str) -> None:
        try:
            files = parameter_files(full, parameter, Path(path))
        except OSError:
            self._missing_files[full, parameter] = path
            return
        self._missing_files.pop((full, parameter), None)
        for file in files:
            self._found(file)
