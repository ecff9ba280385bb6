# SPDX-License-Identifier: Apache-2.0
"""What a launch file is made of and comes to: YAML with line numbers, scopes, values; processes and arguments."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from embedded_ros.errors import LaunchError
from embedded_ros.substitutions import Scope, substitute, truth

if TYPE_CHECKING:
    from collections.abc import Callable


class Mapping(dict[str, Any]):
    """A YAML mapping that knows its line."""

    line = 0


class Loader(yaml.SafeLoader):
    """Reads every mapping as a `Mapping`."""


def _construct(loader: Loader, node: yaml.MappingNode) -> Mapping:
    result = Mapping()
    result.line = node.start_mark.line + 1
    for key_node, value_node in node.value:
        key = str(loader.construct_object(key_node, deep=True))
        if key in result:
            raise yaml.constructor.ConstructorError(None, None, f"key '{key}' is there twice", key_node.start_mark)
        result[key] = loader.construct_object(value_node, deep=True)
    return result


Loader.add_constructor("tag:yaml.org,2002:map", _construct)


@dataclass
class Process:
    """A process to start: its label, command line, environment and what happens when it ends."""

    label: str
    command: list[str]
    environment: dict[str, str]
    cwd: str | None = None
    output: str = "log"
    on_exit_shutdown: bool = False


@dataclass(frozen=True)
class Argument:
    """A declared launch argument."""

    name: str
    default: str | None
    description: str
    choices: tuple[str, ...]
    where: str


@dataclass
class Description:
    """What a launch file comes to."""

    processes: list[Process] = field(default_factory=list)
    arguments: list[Argument] = field(default_factory=list)


@dataclass
class Frame:
    """State that groups and includes scope."""

    scope: Scope
    namespace: str = ""
    parameters: list[tuple[str, Any]] = field(default_factory=list)

    def child(self) -> Frame:
        """Return a copy whose changes stay in it."""
        twin = copy(self)
        twin.scope = copy(self.scope)
        twin.scope.variables = dict(self.scope.variables)
        twin.scope.environment = dict(self.scope.environment)
        twin.parameters = list(self.parameters)
        return twin


def plain(value: Any) -> str:
    """Return a YAML scalar as the text it was meant as."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | dict):
        raise LaunchError(f"expected text or a number, found {value!r}")
    return "" if value is None else str(value)


def parameter_value(value: Any, kind: str | None, frame: Frame) -> Any:
    """Return the value of a parameter; text is read as YAML after substitution unless its type is given as str."""
    if isinstance(value, list):
        return [parameter_value(item, kind, frame) for item in value]
    if not isinstance(value, str):
        return value
    text = substitute(value, frame.scope)
    if kind == "str":
        return text
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise LaunchError(f"value {text!r} is not valid YAML: {error}") from error
    converters: dict[str, Callable[[Any], Any]] = {"int": int, "float": float, "bool": lambda item: truth(str(item))}
    if kind in converters:
        try:
            return converters[kind](found)
        except (TypeError, ValueError) as error:
            raise LaunchError(f"expected a value of type {kind}, found {text!r}") from error
    return "" if found is None else found


def joined(base: str, name: str) -> str:
    """Return a namespace within another; an absolute one stands alone."""
    if not name:
        return base
    return name if name.startswith("/") else f"{base.rstrip('/')}/{name}"


def temporary(text: str) -> str:
    """Return the path of a new file with this text, which is there until this process ends."""
    with tempfile.NamedTemporaryFile("w", suffix=".yaml", dir=_folder(), delete=False, encoding="utf-8") as file:
        file.write(text)
    return file.name


def _folder() -> str:
    if not Path(_new_folder()).is_dir():  # somebody has tidied up
        _new_folder.cache_clear()
    return _new_folder()


@functools.cache
def _new_folder() -> str:
    folder = tempfile.mkdtemp(prefix="launch_params_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
