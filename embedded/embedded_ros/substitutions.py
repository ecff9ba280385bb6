# SPDX-License-Identifier: Apache-2.0
"""The ``$(...)`` of launch files (https://docs.ros.org/en/jazzy/How-To-Guides/Launch-file-different-formats.html)."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from embedded_ros import workspace
from embedded_ros.errors import LaunchError, WorkspaceError

if TYPE_CHECKING:
    from collections.abc import Callable

_TRUE = {"true", "1", "yes", "on"}
_FALSE = {"false", "0", "no", "off"}
_REFUSED = {
    "anon", "eval", "file-content", "filename", "find-exec", "find-pkg-prefix", "optenv",
    "param",
}  # fmt: skip
_COMPARE = {"equals", "not-equals"}


class Scope:
    """What substitutions can see: launch configurations, the file they stand in, the environment."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.variables: dict[str, str] = {}
        self.environment: dict[str, str] = dict(os.environ)


def truth(text: str) -> bool:
    """Read true/false, 1/0, yes/no, on/off."""
    word = text.strip().lower()
    if word in _TRUE:
        return True
    if word in _FALSE:
        return False
    raise LaunchError(f"expected true or false, found {text!r}")


def substitute(text: str, scope: Scope) -> str:
    """Replace every ``$(...)`` of a text.

    Raises:
        LaunchError: an unknown substitution, a variable that is not set, an unbalanced parenthesis.
    """
    result, rest = [], text
    while (start := rest.find("$(")) >= 0:
        if start and rest[start - 1] == "\\":
            result.append(rest[: start - 1] + "$(")
            rest = rest[start + 2 :]
            continue
        end = _closing(rest, start + 2)
        result.append(rest[:start])
        result.append(_perform(rest[start + 2 : end], scope))
        rest = rest[end + 1 :]
    result.append(rest)
    return "".join(result)


def _closing(text: str, start: int) -> int:
    depth, quote = 1, ""
    for index in range(start, len(text)):
        char = text[index]
        if quote:
            quote = "" if char == quote and text[index - 1] != "\\" else quote
        elif char in "'\"":
            quote = char
        elif char == "(":
            depth += 1
        elif char == ")":
            depth -= 1
            if depth == 0:
                return index
    raise LaunchError(f"expected a closing ')' in {text!r}")


def _perform(inner: str, scope: Scope) -> str:
    name, _, rest = inner.strip().partition(" ")
    if name in _REFUSED:
        raise LaunchError(f"$({name} ...) is not part of embedded/; it needs ROS 2")
    if name not in _FUNCTIONS:
        raise LaunchError(f"unknown substitution $({name} ...); expected one of {', '.join(sorted(_FUNCTIONS))}")
    parts = _split(rest)
    if name in _COMPARE and "" in parts:
        raise LaunchError(
            f"$({inner}): '' compares as the text [] on ROS 2 Jazzy; compare with a variable that is empty: "
            '`let: {name: nothing, value: ""}`, $(var nothing)'
        )
    arguments = [substitute(part, scope) for part in parts]
    function, minimum, maximum = _FUNCTIONS[name]
    if not minimum <= len(arguments) <= maximum:
        raise LaunchError(f"$({inner}): expected {minimum} to {maximum} arguments, found {len(arguments)}")
    return function(scope, *arguments)


def _split(text: str) -> list[str]:
    """Split at blanks outside quotes and parentheses; outer quotes are taken off."""
    parts, current, depth, quote, seen = [], "", 0, "", False
    for index, char in enumerate(text):
        if quote:
            if char == quote and text[index - 1] != "\\":
                quote = ""
                current += char if depth else ""
            else:
                current += char
        elif char in "'\"":
            quote, seen = char, True
            current += char if depth else ""
        elif char.isspace() and depth == 0:
            if current or seen:
                parts.append(current)
            current, seen = "", False
        else:
            depth += {"(": 1, ")": -1}.get(char, 0)
            current += char
    return [*parts, current] if current or seen else parts


def _variable(scope: Scope, name: str, *default: str) -> str:
    if name in scope.variables:
        return scope.variables[name]
    if default:
        return default[0]
    known = ", ".join(sorted(scope.variables)) or "none"
    raise LaunchError(f"$(var {name}): no such launch argument or variable; set are: {known}")


def _environment(scope: Scope, name: str, *default: str) -> str:
    if name in scope.environment:
        return scope.environment[name]
    if default:
        return default[0]
    raise LaunchError(f"$(env {name}): the environment variable is not set and no default is given")


def _share(_: Scope, name: str) -> str:
    return str(workspace.package(name).folder)


def _executable(_: Scope, name: str, package: str) -> str:
    return shlex.join(workspace.executable(package, name))


def _command(scope: Scope, text: str) -> str:
    """Run a command and return what it prints; as upstream has it, one that fails or complains is an error."""
    try:
        done = subprocess.run(
            shlex.split(text), env=scope.environment, capture_output=True, text=True, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        raise LaunchError(f"$(command ...): cannot be run: {error}: {text}") from error
    if done.returncode or done.stderr:
        raise LaunchError(done.stderr.strip() or f"$(command ...): ended with exit code {done.returncode}: {text}")
    return done.stdout


def _boolean(value: bool) -> str:
    return "true" if value else "false"


_FUNCTIONS: dict[str, tuple[Callable[..., str], int, int]] = {
    "var": (_variable, 1, 2),
    "env": (_environment, 1, 2),
    "find-pkg-share": (_share, 1, 1),
    "exec-in-pkg": (_executable, 2, 2),
    "command": (_command, 1, 1),
    "dirname": (lambda scope: str(scope.file.parent), 0, 0),
    "not": (lambda _, value: _boolean(not truth(value)), 1, 1),
    "and": (lambda _, a, b: _boolean(truth(a) and truth(b)), 2, 2),
    "or": (lambda _, a, b: _boolean(truth(a) or truth(b)), 2, 2),
    "equals": (lambda _, a, b: _boolean(a == b), 2, 2),
    "not-equals": (lambda _, a, b: _boolean(a != b), 2, 2),
    "if": (lambda _, condition, a, b="": a if truth(condition) else b, 2, 3),
}

__all__ = ["LaunchError", "Scope", "WorkspaceError", "substitute", "truth"]
