# SPDX-License-Identifier: Apache-2.0
"""Check that what a command line names exists, without running it: commands, options, arguments, fields, parameters."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

sys.path.insert(0, str(Path(__file__).parent))

from generated import commands, interfaces, parameters
from generated.markdown import WORKSPACE


def problem_of(words: list[str]) -> str:
    """Return what is wrong with a command line, empty for nothing."""
    checks = {
        ("ros2", "run"): _executable,
        ("ros2", "launch"): _launch_file,
        ("ros2", "service"): _service,
        ("ros2", "topic"): _topic,
    }
    if words[:1] == ["make"]:
        return _target(words)
    check = checks.get(tuple(words[:2]))
    return check(words) if check else ""


def parameter_problem(document: Any) -> str:
    """Return what is wrong with a parameter file, empty for nothing or where it is none."""
    if not isinstance(document, Mapping):
        return ""
    for key, body in document.items():
        if isinstance(body, Mapping) and "ros__parameters" in body:
            found = _parameters(str(key).rpartition("/")[2], body["ros__parameters"])
            if found:
                return found
    return ""


def _parameters(node: str, values: Mapping[str, Any]) -> str:
    tables = parameters.tool("parameters").TABLES
    if node not in tables:
        return f"expected a node of {sorted(tables)}, found {node}"
    rows = {row.name: row for row in importlib.import_module(tables[node]).PARAMETERS.rows}
    for name, value in values.items():
        if name not in rows:
            return f"{node}: no parameter {name}"
        if type(value) is not type(rows[name].default):
            return f"{node}: expected {name} of type {type(rows[name].default).__name__}, found {value!r}"
        wrong = rows[name].problem(value)
        if wrong:
            return str(wrong)
    return ""


def _executable(words: list[str]) -> str:
    package, name = words[2:4]
    known = commands.executables()
    module = known.get(package, {}).get(name)
    if module is None:
        return f"expected one of {', '.join(known.get(package, known))}, found {package} {name}"
    if commands.is_node(module):
        return ""
    words = words[: words.index("--ros-args")] if "--ros-args" in words else words
    text = commands.help_of(name, module)
    options = [word.partition("=")[0] for word in words[4:] if word.startswith("--")]
    has_steps = re.search(r"^  (STEP|COMMAND)$", text, re.MULTILINE) is not None
    missing = [option for option in options if option not in text]
    return f"{name}: expected options of its --help, found {missing}" if missing and not has_steps else ""


def _launch_file(words: list[str]) -> str:
    given = {word.partition(":=")[0] for word in words[4:] if ":=" in word}
    known = {row[0].strip("`") for row in commands.launch_arguments()[words[3]]}
    return f"{words[3]}: no argument {sorted(given - known)}" if given - known else ""


def _service(words: list[str]) -> str:
    name, kind = words[3].strip("/"), words[4]
    package, _, type_name = kind.split("/")
    known = interfaces.endpoints()
    if ("service", name) not in known and not name.endswith("/ping"):
        return f"no service {name}"
    if ("service", name) in known and f"{package}/{type_name}" not in known["service", name].types:
        return f"{name}: expected {sorted(known['service', name].types)}, found {kind}"
    file = WORKSPACE / package / "srv" / f"{type_name}.srv"
    if not file.exists():
        return ""
    declared = re.findall(r"^\S+\s+(\w+)\s*(?:#.*)?$", file.read_text().partition("\n---")[0], re.MULTILINE)
    given = yaml.safe_load(words[5]) if len(words) > 5 else {}
    missing = sorted(set(given) - set(declared))
    return f"{kind}: no field {missing}; it has {declared}" if missing else ""


def _topic(words: list[str]) -> str:
    names = {name for kind, name in interfaces.endpoints() if kind == "topic"} | set(interfaces.OF_EVERY_NODE)
    required = next((word for word in words[3:] if word.startswith("/")), "")
    known = any(required.endswith(f"/{name.strip('/')}") for name in names)
    return "" if known or not required else f"no topic {required}"


def _target(words: list[str]) -> str:
    known = {target.strip("`").split()[1] for target, _ in commands.targets()}
    asked = {word for word in words[1:] if "=" not in word}
    return f"make: no target {sorted(asked - known)}" if asked - known else ""
