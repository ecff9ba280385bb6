# SPDX-License-Identifier: Apache-2.0
"""Check what a page names without running it: command lines, parameter files, modules and files in running text.

A command of this project goes through its own parser. Programs of others are listed with the reason why nothing is
checked of them but the files of this repository that they name; a program that is not listed is an error.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import itertools
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

sys.path.insert(0, str(Path(__file__).parent))

import parsed
import ros_names
import shell_lines
from generated import commands
from generated.markdown import ROOT, WORKSPACE

#: Program -> why its options are not checked.
OTHERS = {
    "apt-get": "Debian's",
    "cd": "the shell's",
    "colcon": "ROS 2's, not here",
    "cp": "the system's",
    "docker": "not here",
    "echo": "the shell's",
    "export": "the shell's",
    "git": "the system's",
    "kill": "the shell's",
    "openssl": "the system's",
    "pip": "Python's",
    "python": "modules and scripts are looked for",
    "rerun": "rerun-sdk's viewer, which opens a window",
    "rosdep": "ROS 2's, not here",
    "source": "the shell's",
    "tee": "the system's",
    "wait": "the shell's",
    "xacro": "of ROS 2, and on PyPI (docs/dependencies.md)",
}
#: Package that is not in this workspace -> whose it is.
OTHER_PACKAGES = {
    "camera_calibration": "ROS 2's calibration of a lens",
    "rmw_zenoh_cpp": "ROS 2's middleware",
    "tf2_ros": "ROS 2's tf",
    "controller_manager": "ros2_control's",
}
#: Command of ros2 that embedded/ does not have -> what stands behind it.
OTHER_COMMANDS = {"security": "sros2", "control": "ros2controlcli"}
#: A path below one of these is a file of this repository.
_FOLDERS = "benchmarks|docker|docs|embedded|examples|ros2_ws|rosdep|tests|tools"
_PATH = re.compile(rf"(?:{_FOLDERS})/[\w./-]*\w|requirements[\w.-]*\.(?:in|lock)")
#: Made on the way, and not there before.
_MADE = re.compile(r"(?:ros2_ws/(?:install|build|log)|docs/reference/generated)\b")
_MODULE = re.compile(r"softgrip_\w+(?:\.\w+)+")
_ENDPOINT = re.compile(r"/?[a-z_]+(?:/[a-z_]+)+")


def problem_of(words: list[str], *, whole: bool = True) -> str:
    """Return what is wrong with a simple command, empty for nothing.

    Args:
        words: the command.
        whole: False where required parts may be left out, as in running text.
    """
    words = [word.removeprefix(".venv/bin/") if at == 0 else word for at, word in enumerate(words)]
    program = words[0] if words[0] not in {"python3", "pip3"} else words[0][:-1]
    try:
        if program == "make":
            return _target(words)
        if program == "ros2":
            return _ros2(words[1:], whole=whole)
        if program == "python":
            return _python(words[1:], whole=whole) or _paths(words[1:])
    except parsed.RefusedLineError as error:
        return str(error)
    if program not in OTHERS:
        return f"expected make, ros2 or one of {', '.join(OTHERS)}, found {program}"
    return _paths(words[1:])


def text_problem(text: str) -> str:
    """Return what is wrong with code in running text: a command, module, file or topic; empty for nothing."""
    if re.match(r"make |ros2 (?:\w+ )?+(?![A-Z])", text):
        for words in shell_lines.commands_of(re.sub(r"\[[^]']*\]|\.\.\.", "", text)):
            if words[0] in {"make", "ros2"} and (found := problem_of(words, whole=False)):
                return found
    elif _MODULE.fullmatch(text):
        return _dotted(text)
    elif _PATH.fullmatch(text):
        return _paths([text])
    elif _ENDPOINT.fullmatch(text):
        return ros_names.endpoint_problem(text.strip("/"))
    return ""


def parameter_problem(document: Any) -> str:
    """Return what is wrong with the parameters of a cell file or a parameter file, empty where it is neither."""
    if not isinstance(document, Mapping):
        return ""
    of_cell = document.get("parameters") or {}
    of_nodes = {key: body["ros__parameters"] for key, body in document.items() if _has_parameters(body)}
    for key, values in (of_cell | of_nodes).items():
        if found := ros_names.parameter_problem(str(key).rpartition("/")[2], values):
            return found
    return ""


def _has_parameters(body: Any) -> bool:
    return isinstance(body, Mapping) and "ros__parameters" in body


def _ros2(words: list[str], *, whole: bool) -> str:
    kind = words[0] if words else ""
    if kind in OTHER_COMMANDS or (not whole and len(words) < 2):
        return ""
    own = {"run": _executable, "launch": _launch_file, "bag": _bag}
    return own[kind](words[1:], whole=whole) if kind in own else _verb(kind, words[1:], whole=whole)


def _verb(kind: str, words: list[str], *, whole: bool) -> str:
    try:
        verb = importlib.import_module(f"embedded_ros.commands.{kind}")
    except ModuleNotFoundError:
        return f"ros2: no command {kind}"
    line = parsed.parse(functools.partial(verb.run, words), words, whole=whole)
    if kind != "pkg":
        return ros_names.problem_of(kind, line)
    package = getattr(line, "package_name", None)
    return "" if package is None or (WORKSPACE / package / "package.xml").exists() else f"no package {package}"


def _bag(words: list[str], *, whole: bool) -> str:
    return _executable(["softgrip_bag", *words], whole=whole)


def _executable(words: list[str], *, whole: bool) -> str:
    if words[0] in OTHER_PACKAGES:
        return ""
    known = commands.executables()
    if words[0] not in known:
        return f"expected a package of {', '.join(known)}, found {words[0]}"
    if len(words) < 2:
        return "" if not whole else f"expected an executable of {words[0]}"
    module = known[words[0]].get(words[1])
    if module is None:
        return f"expected one of {', '.join(known[words[0]])}, found {words[0]} {words[1]}"
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    if not commands.is_node(module):
        parsed.parse(importlib.import_module(module).main, words[2:at], whole=whole)
    elif words[2:at]:
        return f"{words[1]}: a node's options stand behind --ros-args, found {words[2:at]}"
    return _given_parameters(words[1], words[at:])


def _given_parameters(node: str, words: list[str]) -> str:
    given = [after for before, after in itertools.pairwise(words) if before in {"-p", "--param"}]
    values = {one.partition(":=")[0]: yaml.safe_load(one.partition(":=")[2]) for one in given}
    return ros_names.parameter_problem(node, values) if values else ""


def _launch_file(words: list[str], *, whole: bool) -> str:
    if words[0] in OTHER_PACKAGES or (len(words) < 2 and not whole):
        return ""
    folder = WORKSPACE / words[0]
    files = {path.name: path for path in folder.rglob("*.launch.yaml")}
    if len(words) < 2 or words[1] not in files:
        return f"expected a launch file of {words[0]}: {', '.join(sorted(files)) or 'none'}, found {words[1:2]}"
    arguments = {one["name"]: one for one in commands.arguments_of(files[words[1]])}
    for word in words[2:]:
        name, equals, value = word.partition(":=")
        if not equals or name not in arguments:
            return f"{words[1]}: no argument {word}"
        choices = [str(one["value"]) for one in arguments[name].get("choice", [])]
        if arguments[name].get("default") in {"true", "false"}:
            choices = ["true", "false"]
        if choices and value not in choices:
            return f"{words[1]}: expected {name} of {choices}, found {value}"
    return ""


def _target(words: list[str]) -> str:
    known = {target.strip("`").split()[1] for target, _ in commands.targets()}
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = [word for word in words[1:] if "=" not in word]
    variables = [word.partition("=")[0] for word in words[1:] if "=" in word]
    missing = [one for one in targets if one not in known and not re.search(rf"^{re.escape(one)}:", text, re.MULTILINE)]
    missing += [one for one in variables if f"$({one})" not in text and f"$({one}," not in text]
    return f"make: no {missing}" if missing else ""


def _python(words: list[str], *, whole: bool) -> str:
    if words[:1] == ["-m"]:
        name, words = words[1], words[2:]
        if importlib.util.find_spec(name) is None:
            return f"no module {name}"
        main = getattr(importlib.import_module(name), "main", None) if name.startswith("softgrip_") else None
        if main is not None:
            parsed.parse(main, words, whole=whole)
        return ""
    script = ROOT / words[0] if words else None
    if script is None or not script.is_file():
        return ""  # a file of the reader's own; one of the repository is looked for as a path
    text = script.read_text(encoding="utf-8")
    missing = [word for word in words[1:] if word.startswith("--") and f'"{word.partition("=")[0]}"' not in text]
    return f"{words[0]}: no option {missing}" if missing else ""


def _paths(words: list[str]) -> str:
    for word in words:
        path = word.partition("::")[0]
        if _PATH.fullmatch(path) and not _MADE.match(path) and not (ROOT / path).exists():
            return f"no file {path}"
    return ""


def _dotted(name: str) -> str:
    """Return what is wrong with the name of a module or of what one has."""
    module, rest = name, []
    while True:
        try:
            found: Any = importlib.import_module(module)
            break
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            rest.insert(0, last)
            if not module:
                return f"no module {name}"
    for part in rest:
        if not hasattr(found, part):
            return f"no {part} in {module}"
        found = getattr(found, part)
    return ""
