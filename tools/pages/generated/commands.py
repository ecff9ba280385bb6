# SPDX-License-Identifier: Apache-2.0
"""Command lines: every executable's own --help, every launch file's arguments, every target of make."""

from __future__ import annotations

import configparser
import contextlib
import functools
import importlib
import importlib.util
import io
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import yaml

from generated.markdown import ROOT, WORKSPACE, code, table


def page() -> str:
    """Return the page."""
    parts = [
        "# Command lines\n",
        "## make\n",
        table(("target", "what it does"), sorted(targets())),
        "\n## ros2 launch softgrip_bringup\n",
    ]
    for name, arguments in launch_arguments().items():
        parts += [f"### {name}\n", table(("argument", "default", "meaning"), arguments), ""]
    parts.append("## ros2 run\n")
    for package, names in executables().items():
        parts.append(f"### {package}\n")
        nodes = sorted(name for name, module in names.items() if is_node(module))
        if nodes:
            listed = ", ".join(code(name) for name in nodes)
            parts.append(f"Nodes, whose options are their [parameters](parameters.md): {listed}.\n")
        for name, module in sorted(names.items()):
            if not is_node(module):
                parts += [f"#### {name}\n", f"```text\n{help_of(name, module)}\n```\n"]
    return "\n".join(parts)


def targets() -> Iterator[tuple[str, str]]:
    """Yield the targets of make that explain themselves."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name, meaning in re.findall(r"^([a-z0-9-]+):.*?## +(.*)$", text, re.MULTILINE):
        yield code(f"make {name}"), meaning


def launch_arguments() -> dict[str, list[tuple[str, str, str]]]:
    """Return launch file -> its arguments."""
    return {
        path.name: [
            (code(one["name"]), code(one.get("default", "")), one.get("description", "")) for one in arguments_of(path)
        ]
        for path in sorted((WORKSPACE / "softgrip_bringup/launch").glob("*.launch.yaml"))
    }


def arguments_of(launch_file: Path) -> list[dict[str, Any]]:
    """Return the arguments that a launch file declares, as it declares them."""
    actions = yaml.safe_load(launch_file.read_text(encoding="utf-8"))["launch"]
    return [action["arg"] for action in actions if "arg" in action]


@functools.cache
def executables() -> dict[str, dict[str, str]]:
    """Return package -> executable -> module, of those that the packages install."""
    found: dict[str, dict[str, str]] = {}
    for path in sorted(WORKSPACE.glob("*/setup.cfg")):
        setup = configparser.ConfigParser()
        setup.read(path, encoding="utf-8")
        scripts = setup.get("options.entry_points", "console_scripts", fallback="")
        names = dict(re.findall(r"^\s*(\w+) = ([\w.]+):main$", scripts, re.MULTILINE))
        if names:
            found[path.parent.name] = names
    return found


def is_node(module: str) -> bool:
    """Return whether an executable is a node that takes parameters instead of options."""
    if ".nodes." not in module or ".commands." in module:
        return False
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return "ArgumentParser(" not in Path(spec.origin).read_text(encoding="utf-8")


def help_of(name: str, module: str) -> str:
    """Return what a command prints with --help, 100 columns wide.

    Raises:
        RuntimeError: it prints nothing.
    """
    main = importlib.import_module(module).main
    out = io.StringIO()
    with (
        mock.patch.dict(os.environ, {"COLUMNS": "100"}),
        mock.patch.object(sys, "argv", [name, "--help"]),
        contextlib.redirect_stdout(out),
        contextlib.suppress(SystemExit),
    ):
        main()
    if not out.getvalue():
        raise RuntimeError(f"{module}: expected the text of --help, found nothing")
    return out.getvalue().replace(str(ROOT), "...").rstrip()
