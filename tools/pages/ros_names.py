# SPDX-License-Identifier: Apache-2.0
"""Check what a parsed `ros2` verb names: topics, services, actions, their types, fields, nodes and parameters."""

from __future__ import annotations

import argparse
import functools
import importlib
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import yaml
from generated import interfaces, parameters

from embedded_ros.errors import EmbeddedError
from embedded_ros.registry import registry
from embedded_ros.text_form import fill, parse_values
from softgrip_security.policy import Grant, read_policy

#: Names that pages give to a cell among others.
CELLS = ("left", "right")
#: Of ROS 2 itself, or the reader's own (docs/how-to/own-node.md).
FOREIGN_NODES = ("rviz2", "robot_state_publisher", "controller_manager", "tension_watch")
_GRANTS = {
    "topic": (Grant.PUBLISH, Grant.SUBSCRIBE),
    "service": (Grant.SERVE, Grant.CALL),
    "action": (Grant.SERVE_ACTION, Grant.CALL_ACTION),
}


def problem_of(kind: str, line: argparse.Namespace) -> str:
    """Return what is wrong with the names of a line, empty for nothing.

    Args:
        kind: the word behind ros2.
        line: what ros2's parser makes of the words behind that.
    """
    if kind in {"topic", "service", "action"}:
        return _endpoint_problem(kind, line)
    if kind == "interface":
        return type_problem(getattr(line, "type", ""))
    return _node_problem(line)


def _endpoint_problem(kind: str, line: argparse.Namespace) -> str:
    name = _own(getattr(line, f"{kind}_name", ""))
    type_name = getattr(line, f"{'message' if kind == 'topic' else kind}_type", None) or ""
    if not name:
        return ""
    if name not in _known(kind) and not (kind == "service" and name.endswith("/ping")):  # every node has it
        return f"no {kind} {name}"
    made = interfaces.endpoints().get((kind, name)) or interfaces.endpoints().get((kind, f"/{name}"))
    package, _, rest = type_name.partition("/")
    if type_name and made and f"{package}/{rest.rpartition('/')[2]}" not in made.types:
        return f"{name}: expected {sorted(made.types)}, found {type_name}"
    return type_problem(type_name, getattr(line, "values", None) or getattr(line, "goal", None) or "{}")


def type_problem(type_name: str, values: str = "{}") -> str:
    """Return what is wrong with a type, or with values for it as YAML; empty for nothing."""
    if not type_name:
        return ""
    try:
        found = registry().interface(type_name)
        part = getattr(found, "Request", None) or getattr(found, "Goal", None) or found
        fill(part(), parse_values(values))
    except EmbeddedError as error:
        return str(error)
    return ""


def _node_problem(line: argparse.Namespace) -> str:
    node = _own(getattr(line, "node_name", None) or "")
    if not node or node in FOREIGN_NODES:
        return ""
    if node not in nodes():
        return f"expected a node of {', '.join(sorted(nodes()))}, found {node}"
    asked = [*getattr(line, "parameter_names", []), *filter(None, [getattr(line, "parameter_name", None)])]
    for name in asked:
        if name not in rows_of(node):
            return f"{node}: no parameter {name}"
    value = getattr(line, "value", None)
    return parameter_problem(node, {asked[0]: yaml.safe_load(value)}) if value is not None else ""


def parameter_problem(node: str, values: Mapping[str, Any]) -> str:
    """Return what is wrong with parameters of a node, empty for nothing."""
    if node not in tables():
        return f"expected a node of {sorted(tables())}, found {node}"
    rows = rows_of(node)
    for name, value in values.items():
        if name not in rows:
            return f"{node}: no parameter {name}"
        if type(value) is not type(rows[name].default):
            return f"{node}: expected {name} of type {type(rows[name].default).__name__}, found {value!r}"
        wrong = rows[name].problem(value)
        if wrong:
            return str(wrong)
    return ""


def tables() -> Mapping[str, str]:
    """Return node -> module of its parameters."""
    scripts: ModuleType = parameters.tool("parameters")
    found: Mapping[str, str] = scripts.TABLES
    return found


def rows_of(node: str) -> Mapping[str, Any]:
    """Return name -> row of a node's parameters, empty for a node without a table."""
    module = tables().get(node)
    return {row.name: row for row in importlib.import_module(module).PARAMETERS.rows} if module else {}


def nodes() -> set[str]:
    """Return the names of the cell's nodes."""
    return {one.name for one in read_policy().identities} | set(tables())


def endpoint_problem(name: str) -> str:
    """Return what is wrong with a name that looks like one of the cell's topics, services or actions."""
    known = {one for kind in _GRANTS for one in _known(kind)}
    folders = {one.partition("/")[0] for one in known if "/" in one} - nodes()
    if name.partition("/")[0] not in folders:
        return ""
    return "" if name in known else f"no topic, service or action {name}"


def _own(name: str) -> str:
    """Return a name without the cell before it."""
    parts = name.strip("/").split("/")
    return "/".join(parts[1:] if parts[0] in CELLS else parts)


@functools.cache
def _known(kind: str) -> set[str]:
    """Return the names of a kind, from the access policy and from the nodes."""
    made = {name.strip("/") for one, name in interfaces.endpoints() if one == kind}
    allowed = {
        name.strip("/").replace("~", one.name)
        for one in read_policy().identities
        for grant in _GRANTS[kind]
        for name in one.names(grant)
    }
    return made | allowed
