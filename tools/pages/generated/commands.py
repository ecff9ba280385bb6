# SPDX-License-Identifier: Apache-2.0
"""Command lines: every executable's own --help, every launch file's arguments, every target of make."""

from __future__ import annotations

import configparser
import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Iterator
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
    found = {}
    for path in sorted((WORKSPACE / "softgrip_bringup/launch").glob("*.launch.yaml")):
        actions = yaml.safe_load(path.read_text(encoding="utf-8"))["launch"]
        given = [action["arg"] for action in actions if "arg" in action]
        found[path.name] = [
            (code(one["name"]), code(one.get("default", "")), one.get("description", "")) for one in given
        ]
    return found


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
    return ".nodes." in module and ".commands." not in module and not module.endswith("controller_client")


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
