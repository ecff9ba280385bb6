# SPDX-License-Identifier: Apache-2.0
"""Reads ``--ros-args``: remaps, parameters, parameter files, log levels (https://design.ros2.org/articles/ros_command_line_arguments)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from embedded_ros.errors import ArgumentsError, UnknownArgumentsError
from embedded_ros.names import Remap, parse_remap

_IGNORED = {"--enable-rosout-logs", "--enable-stdout-logs", "--disable-stdout-logs", "--enable-external-lib-logs",
            "--disable-external-lib-logs"}  # fmt: skip
LEVELS = {"UNSET": 0, "DEBUG": 10, "INFO": 20, "WARN": 30, "WARNING": 30, "ERROR": 40, "FATAL": 50}


@dataclass
class Arguments:
    """What ``--ros-args`` said, and the arguments it left alone."""

    remaps: list[Remap] = field(default_factory=list)
    parameters: list[tuple[str, dict[str, Any], str]] = field(default_factory=list)
    log_levels: dict[str, int] = field(default_factory=dict)
    rosout: bool = True
    enclave: str = "/"
    rest: list[str] = field(default_factory=list)

    def node_name(self, name: str) -> str:
        """Return the name a node of this name gets."""
        for rule in self.remaps:
            if rule.kind == "node" and rule.node in {"", name}:
                return rule.target
        return name

    def namespace(self, name: str, namespace: str) -> str:
        """Return the namespace a node gets."""
        for rule in self.remaps:
            if rule.kind == "namespace" and rule.node in {"", name}:
                return rule.target
        return namespace

    def parameters_of(self, full_node_name: str) -> dict[str, tuple[Any, str]]:
        """Return parameter overrides of a node: name -> (value, source); later ones win."""
        found: dict[str, tuple[Any, str]] = {}
        for pattern, values, source in self.parameters:
            if matches(pattern, full_node_name):
                found.update({name: (value, source) for name, value in values.items()})
        return found


def matches(pattern: str, full_node_name: str) -> bool:
    """Whether a node key of a parameter file names a node; ``*`` is one token, ``**`` any number of them."""
    pattern = "/" + pattern.lstrip("/")
    expression = ""
    for part in pattern.split("/")[1:]:
        if part == "**":
            expression += r"(?:/\w+)*"
        else:
            expression += "/" + re.escape(part).replace(r"\*", r"\w+")
    return re.fullmatch(expression, full_node_name) is not None


def parse(argv: list[str]) -> Arguments:
    """Split a command line.

    Raises:
        ArgumentsError: an argument between ``--ros-args`` and ``--`` is wrong; names it and what was expected.
    """
    result = Arguments()
    items = iter(argv)
    inside = False
    for item in items:
        if item == "--ros-args":
            inside = True
        elif inside and item == "--":
            inside = False
        elif inside:
            _parse_one(item, items, result)
        else:
            result.rest.append(item)
    return result


def _parse_one(item: str, items: Any, result: Arguments) -> None:
    def value() -> str:
        found = next(items, None)
        if found is None:
            raise ArgumentsError(f"--ros-args {item}: expected a value after it, found the end of the command line")
        return str(found)

    if item in {"-r", "--remap"}:
        text = value()
        try:
            result.remaps.append(parse_remap(text))
        except ValueError as error:
            raise ArgumentsError(f"--ros-args {item} {text}: {error}") from None
    elif item in {"-p", "--param"}:
        result.parameters.append(_parse_parameter(value()))
    elif item == "--params-file":
        from embedded_ros.parameter_files import load_parameter_file  # noqa: PLC0415  YAML costs start-up

        result.parameters += load_parameter_file(Path(value()))
    elif item == "--log-level":
        _parse_log_level(value(), result)
    elif item in {"-e", "--enclave"}:
        result.enclave = value()
    elif item == "--disable-rosout-logs":
        result.rosout = False
    elif item == "--log-config-file":
        raise ArgumentsError("--ros-args --log-config-file is not part of embedded/; it needs ROS 2")
    elif item not in _IGNORED:
        raise UnknownArgumentsError(
            f"{[item]}: unknown after --ros-args; expected -r, -p, --params-file, --log-level, --enclave, "
            "--disable-rosout-logs"
        )


def _parse_log_level(text: str, result: Arguments) -> None:
    name, separator, level = text.rpartition(":=")
    if level.upper() not in LEVELS:
        raise ArgumentsError(f"--log-level {text}: expected [logger:=]debug|info|warn|error|fatal")
    result.log_levels[name if separator else ""] = LEVELS[level.upper()]


def _parse_parameter(text: str) -> tuple[str, dict[str, Any], str]:
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise ArgumentsError(f"--ros-args -p {text}: expected name:=value")
    node = "/**"
    if match := re.match(r"([\w/*]+):(.+)$", name):
        node, name = match[1], match[2]
    from embedded_ros.parameter_files import load_yaml, parameter_value  # noqa: PLC0415  YAML costs start-up

    source = f"-p {text}"
    parsed = parameter_value(load_yaml(value, source), f"{source}: {name}")
    return node, {name: parsed}, source
