# SPDX-License-Identifier: Apache-2.0
"""Reads ``--ros-args``: remaps, parameters, parameter files, log levels (https://design.ros2.org/articles/ros_command_line_arguments)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from embedded_ros.errors import ArgumentsError, UnknownArgumentsError
from embedded_ros.names import Remap, parse_remap

if TYPE_CHECKING:
    from collections.abc import Callable

_IGNORED = {"--enable-rosout-logs", "--enable-stdout-logs", "--disable-stdout-logs", "--enable-external-lib-logs",
            "--disable-external-lib-logs"}  # fmt: skip
LEVELS = {"UNSET": 0, "DEBUG": 10, "INFO": 20, "WARN": 30, "WARNING": 30, "ERROR": 40, "FATAL": 50}


class _Loader(yaml.SafeLoader):
    """YAML 1.1, with ROS 2's reading of ``1e3`` as a float."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:\d+\.\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)


def load_yaml(text: str, source: str) -> Any:
    """Parse YAML; ArgumentsError with source, line and reason when it does not parse."""
    return _yaml(lambda loader: loader.get_single_data(), text, source)


def _yaml(read: Callable[[_Loader], Any], text: str, source: str) -> Any:
    loader = _Loader(text)
    try:
        return read(loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"{source}:{mark.line + 1}:{mark.column + 1}" if mark else source
        raise ArgumentsError(f"{place}: not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise ArgumentsError(f"{source}: not valid YAML: {error}") from error
    finally:
        loader.dispose()


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
    source = f"-p {text}"
    parsed = parameter_value(load_yaml(value, source), f"{source}: {name}")
    return node, {name: parsed}, source


def parameter_value(value: Any, where: str) -> Any:
    """Check that a YAML value is one of the parameter types; ArgumentsError when it is not."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list):
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if len(kinds) <= 1 and kinds <= {bool, int, float, str}:
            return value
    raise ArgumentsError(
        f"{where}: expected true/false, a number, text or a list of these, found {type(value).__name__} {value!r}"
    )


def load_parameter_file(path: Path) -> list[tuple[str, dict[str, Any], str]]:
    """Read a parameter file into (node pattern, values by dotted name, source).

    Raises:
        ArgumentsError: the file is missing or not of the form ``node: {ros__parameters: {name: value}}``.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ArgumentsError(f"--params-file {path}: cannot be read: {error.strerror}") from error
    found: list[tuple[str, dict[str, Any], str]] = []

    def read(loader: _Loader) -> None:
        root = loader.get_single_node()
        if root is not None:
            _ParameterFile(loader, path, found).nodes(root, "")

    _yaml(read, text, str(path))
    return found


class _ParameterFile:
    """Walks the YAML nodes of a parameter file: a node name may stand there twice, a parameter may not."""

    def __init__(self, loader: _Loader, path: Path, found: list[tuple[str, dict[str, Any], str]]) -> None:
        self._loader = loader
        self._path = path
        self._found = found

    def _place(self, node: yaml.Node) -> str:
        return f"{self._path}:{node.start_mark.line + 1}"

    def _pairs(self, node: yaml.Node, expected: str) -> list[tuple[str, yaml.Node]]:
        if not isinstance(node, yaml.MappingNode):
            raise ArgumentsError(f"{self._place(node)}: expected {expected}, found {node.value!r}")
        return [(str(key.value), value) for key, value in node.value]

    def nodes(self, node: yaml.Node, prefix: str) -> None:
        """Take in a mapping of namespaces and node names."""
        for key, value in self._pairs(
            node, f"'node_name: {{ros__parameters: {{...}}}}' under '{prefix or 'top level'}'"
        ):
            if key == "ros__parameters":
                if not prefix:
                    raise ArgumentsError(
                        f"{self._place(value)}: ros__parameters: expected a node name (or /**) above it"
                    )
                flat: dict[str, Any] = {}
                self.parameters(value, "", flat)
                self._found.append((prefix, flat, str(self._path)))
            else:
                self.nodes(value, f"{prefix.rstrip('/')}/{key.lstrip('/')}" if prefix else key)

    def parameters(self, node: yaml.Node, prefix: str, flat: dict[str, Any]) -> None:
        """Take in a mapping of parameters, nested ones with dotted names."""
        for key, value in self._pairs(node, "'name: value' pairs"):
            name = f"{prefix}{key}"
            if isinstance(value, yaml.MappingNode):
                self.parameters(value, f"{name}.", flat)
                continue
            if name in flat:
                raise ArgumentsError(f"{self._place(value)}: parameter '{name}' is there twice; keep one")
            plain = self._loader.construct_object(value, deep=True)
            flat[name] = parameter_value(plain, f"{self._place(value)}: {name}")
