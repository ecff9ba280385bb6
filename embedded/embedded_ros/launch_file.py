# SPDX-License-Identifier: Apache-2.0
"""Reads a YAML launch file into the processes it asks for.

Every unknown action, attribute or child is an error that names file and line, as upstream's frontend has it.
"""

from __future__ import annotations

import itertools
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from embedded_ros import workspace
from embedded_ros.errors import EmbeddedError, LaunchError
from embedded_ros.launch_description import (
    Argument,
    Description,
    Frame,
    Loader,
    Mapping,
    Process,
    joined,
    parameter_value,
    plain,
    temporary,
)
from embedded_ros.substitutions import Scope, substitute, truth

if TYPE_CHECKING:
    from collections.abc import Callable

_NODE = {
    "pkg", "exec", "name", "namespace", "param", "remap", "args", "ros_args", "exec_name", "output", "cwd", "env", "if",
    "unless", "launch-prefix", "on_exit",
}  # fmt: skip
_REFUSED = {
    "append_env", "composable_node", "executable", "lifecycle_node", "load_composable_node", "log", "node_container",
    "reset", "reset_env", "ros_timer", "set_parameter", "set_parameters_from_file", "set_remap", "set_ros_log_dir",
    "shutdown", "timer", "unset_env",
}  # fmt: skip


class LaunchReader:
    """Walks a launch file and those it includes."""

    def __init__(self, arguments: dict[str, str]) -> None:
        self._given = arguments
        self._counter = itertools.count(1)
        self.description = Description()
        self._actions: dict[str, Callable[[Any, Frame, str], None]] = {
            "arg": self._arg, "let": self._let, "node": self._node, "include": self._include, "group": self._group,
            "push_ros_namespace": self._push_namespace, "push-ros-namespace": self._push_namespace,
            "set_env": self._set_env, "set_use_sim_time": self._set_use_sim_time,
        }  # fmt: skip

    def read(self, path: Path) -> Description:
        """Read the file.

        Raises:
            LaunchError: something in it is wrong; file and line are in the message.
        """
        scope = Scope(path)
        scope.variables = dict(self._given)
        self._file(path, Frame(scope))
        unknown = set(self._given) - {argument.name for argument in self.description.arguments}
        if unknown:
            known = ", ".join(argument.name for argument in self.description.arguments) or "none"
            raise LaunchError(
                f"{path}: launch argument(s) {', '.join(sorted(unknown))} not declared; declared are: {known}"
            )
        return self.description

    def _file(self, path: Path, frame: Frame) -> None:
        if path.suffix not in {".yaml", ".yml"}:
            raise LaunchError(f"{path}: expected a YAML launch file; XML and Python launch files need ROS 2")
        try:
            root = yaml.load(path.read_text(encoding="utf-8"), Loader)  # noqa: S506  a SafeLoader
        except OSError as error:
            raise LaunchError(f"{path}: cannot be read: {error.strerror}") from error
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 0
            raise LaunchError(f"{path}:{line}: not valid YAML: {error.problem}") from error
        if not isinstance(root, Mapping) or list(root) != ["launch"]:
            raise LaunchError(f"{path}:1: expected one top-level key 'launch' with a list of actions")
        self._children(root["launch"], frame, f"{path}:{root.line}")

    def _children(self, children: Any, frame: Frame, where: str) -> None:
        if not isinstance(children, list):
            raise LaunchError(f"{where}: expected a list of actions, found {type(children).__name__}")
        for child in children:
            if not isinstance(child, Mapping) or len(child) != 1:
                raise LaunchError(f"{where}: expected '- action: {{...}}' with one action each, found {child!r}")
            ((name, body),) = child.items()
            here = f"{frame.scope.file}:{child.line}"
            if name in _REFUSED:
                raise LaunchError(f"{here}: '{name}' is not part of embedded/; it needs ROS 2")
            if name not in self._actions:
                raise LaunchError(
                    f"{here}: unknown action '{name}'; expected one of {', '.join(sorted(self._actions))}"
                )
            try:
                self._actions[name](body, frame, here)
            except LaunchError as error:
                text = str(error)
                raise (
                    error
                    if text.startswith(str(frame.scope.file)) or ".yaml:" in text.split(" ", maxsplit=1)[0]
                    else LaunchError(f"{here}: {name}: {error}")
                ) from error
            except EmbeddedError as error:
                raise LaunchError(f"{here}: {name}: {error}") from error

    # -- attributes -------------------------------------------------------------------------------------------

    @staticmethod
    def _checked(body: Any, allowed: set[str], required: set[str], where: str) -> Mapping:
        if not isinstance(body, Mapping):
            raise LaunchError(f"{where}: expected attributes {', '.join(sorted(allowed))}, found {body!r}")
        unknown = set(body) - allowed
        if unknown:
            raise LaunchError(
                f"{where}: unknown attribute(s) {', '.join(sorted(unknown))}; expected {', '.join(sorted(allowed))}"
            )
        missing = required - set(body)
        if missing:
            raise LaunchError(f"{where}: attribute(s) {', '.join(sorted(missing))} missing")
        return body

    @staticmethod
    def _text(body: Mapping, key: str, frame: Frame, default: str | None = None) -> str:
        if key not in body:
            if default is None:
                raise LaunchError(f"attribute '{key}' missing")
            return default
        return substitute(plain(body[key]), frame.scope)

    @staticmethod
    def _requested(body: Any, frame: Frame) -> bool:
        if not isinstance(body, Mapping):
            return True
        if "if" in body and "unless" in body:
            raise LaunchError("'if' and 'unless' cannot both be given")
        if "if" in body:
            return truth(substitute(plain(body["if"]), frame.scope))
        return "unless" not in body or not truth(substitute(plain(body["unless"]), frame.scope))

    # -- actions ----------------------------------------------------------------------------------------------

    def _arg(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"name", "default", "description", "choice"}, {"name"}, where)
        name = self._text(body, "name", frame)
        choices = tuple(substitute(plain(item["value"]), frame.scope) for item in body.get("choice", []))
        default = self._text(body, "default", frame) if "default" in body else None
        argument = Argument(name, default, self._text(body, "description", frame, ""), choices, where)
        if all(known.name != name for known in self.description.arguments):
            self.description.arguments.append(argument)
        if name not in frame.scope.variables:
            if default is None:
                raise LaunchError(f"{where}: launch argument '{name}' is required: give {name}:=value")
            frame.scope.variables[name] = default
        if choices and frame.scope.variables[name] not in choices:
            raise LaunchError(
                f"{where}: {name}: expected {' or '.join(choices)}, found {frame.scope.variables[name]!r}"
            )

    def _let(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"name", "value", "if", "unless"}, {"name", "value"}, where)
        if self._requested(body, frame):
            frame.scope.variables[self._text(body, "name", frame)] = self._text(body, "value", frame)

    def _include(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"file", "arg", "let", "if", "unless"}, {"file"}, where)
        if not self._requested(body, frame):
            return
        path = Path(self._text(body, "file", frame))
        for item in [*body.get("arg", []), *body.get("let", [])]:
            item = self._checked(item, {"name", "value"}, {"name", "value"}, where)  # noqa: PLW2901  checked form
            frame.scope.variables[self._text(item, "name", frame)] = self._text(item, "value", frame)
        outer, frame.scope.file = frame.scope.file, path
        try:
            self._file(path, frame)
        finally:
            frame.scope.file = outer

    def _group(self, body: Any, frame: Frame, where: str) -> None:
        if isinstance(body, list):
            self._children(body, frame.child(), where)
            return
        body = self._checked(body, {"scoped", "forwarding", "keep", "children", "if", "unless"}, {"children"}, where)
        if not self._requested(body, frame):
            return
        inner = frame.child() if truth(self._text(body, "scoped", frame, "true")) else frame
        if not truth(self._text(body, "forwarding", frame, "true")):
            inner.scope.variables = {}
        for item in body.get("keep", []):
            inner.scope.variables[self._text(item, "name", frame)] = self._text(item, "value", frame)
        self._children(body["children"], inner, where)

    def _push_namespace(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"namespace", "if", "unless"}, {"namespace"}, where)
        if self._requested(body, frame):
            frame.namespace = joined(frame.namespace, self._text(body, "namespace", frame))

    def _set_env(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"name", "value", "if", "unless"}, {"name", "value"}, where)
        if self._requested(body, frame):
            frame.scope.environment[self._text(body, "name", frame)] = self._text(body, "value", frame)

    def _set_use_sim_time(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, {"value", "if", "unless"}, {"value"}, where)
        if self._requested(body, frame):
            frame.parameters.append(("use_sim_time", truth(self._text(body, "value", frame))))

    # -- processes --------------------------------------------------------------------------------------------

    def _process(self, body: Mapping, frame: Frame, label: str, command: list[str], where: str) -> Process:
        prefix = shlex.split(self._text(body, "launch-prefix", frame, ""))
        environment = dict(frame.scope.environment)
        for item in body.get("env", []):
            item = self._checked(item, {"name", "value"}, {"name", "value"}, where)  # noqa: PLW2901  checked form
            environment[self._text(item, "name", frame)] = self._text(item, "value", frame)
        output = self._text(body, "output", frame, "log")
        if output not in {"log", "screen", "both", "own_log", "full"}:
            raise LaunchError(f"{where}: output: expected log, screen, both, own_log or full, found {output!r}")
        on_exit = body.get("on_exit")
        if on_exit not in {None, "shutdown"} and not (isinstance(on_exit, list) and [*on_exit] == [{"shutdown": {}}]):
            raise LaunchError(f"{where}: on_exit: expected 'shutdown', found {on_exit!r}")
        return Process(
            label=f"{label}-{next(self._counter)}",
            command=[*prefix, *command],
            environment=environment,
            cwd=self._text(body, "cwd", frame) if "cwd" in body else None,
            output=output,
            on_exit_shutdown=on_exit is not None,
        )

    def _node(self, body: Any, frame: Frame, where: str) -> None:
        body = self._checked(body, _NODE, {"pkg", "exec"}, where)
        if not self._requested(body, frame):
            return
        package, executable = self._text(body, "pkg", frame), self._text(body, "exec", frame)
        command = workspace.executable(package, executable)
        command += shlex.split(self._text(body, "args", frame, ""))
        command += ["--ros-args", *shlex.split(self._text(body, "ros_args", frame, ""))]
        name = self._text(body, "name", frame, "")
        if name:
            command += ["-r", f"__node:={name}"]
        namespace = joined(frame.namespace, self._text(body, "namespace", frame, ""))
        if namespace:
            command += ["-r", f"__ns:={namespace}"]
        for key, value in frame.parameters:
            command += ["-p", f"{key}:={yaml.safe_dump(value, default_flow_style=True).splitlines()[0]}"]
        for item in body.get("param", []):
            command += ["--params-file", self._parameters(item, frame, name, namespace, where)]
        for item in body.get("remap", []):
            item = self._checked(item, {"from", "to"}, {"from", "to"}, where)  # noqa: PLW2901  checked form
            command += ["-r", f"{self._text(item, 'from', frame)}:={self._text(item, 'to', frame)}"]
        label = self._text(body, "exec_name", frame, name or executable)
        self.description.processes.append(self._process(body, frame, label, command, where))

    def _parameters(self, item: Any, frame: Frame, name: str, namespace: str, where: str) -> str:
        """Return the path of a parameter file: the given one, or one written with the values."""
        item = self._checked(item, {"name", "value", "type", "sep", "from", "allow_substs", "param"}, set(), where)
        if "from" in item:
            path = Path(self._text(item, "from", frame))
            if not path.is_file():
                raise LaunchError(f"{where}: param: expected a parameter file, found nothing at {path}")
            if not truth(self._text(item, "allow_substs", frame, "false")):
                return str(path)
            return temporary(substitute(path.read_text(encoding="utf-8"), frame.scope))
        values = self._nested(item, frame, where)
        key = f"{namespace.rstrip('/')}/{name}" if name else "/**"
        return temporary(yaml.safe_dump({key: {"ros__parameters": values}}, sort_keys=False))

    def _nested(self, item: Mapping, frame: Frame, where: str) -> dict[str, Any]:
        if "name" not in item:
            raise LaunchError(f"{where}: param: expected 'name' with 'value', or 'from' with a file")
        name = self._text(item, "name", frame)
        if "param" in item:
            inner: dict[str, Any] = {}
            for child in item["param"]:
                inner.update(self._nested(child, frame, where))
            return {name: inner}
        if "value" not in item:
            raise LaunchError(f"{where}: param '{name}': expected 'value'")
        return {name: parameter_value(item["value"], item.get("type"), frame)}
