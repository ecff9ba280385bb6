# SPDX-License-Identifier: Apache-2.0
"""Parameter values and files in YAML; every error names file and line."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import yaml

from embedded_ros.errors import ArgumentsError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


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
