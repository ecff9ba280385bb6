# SPDX-License-Identifier: Apache-2.0
"""Parameters of every node, from the nodes' own tables."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from generated.markdown import ROOT, code, table
from softgrip_testing.scripts import load_script


def tool(name: str) -> ModuleType:
    """Return a script of tools/ as a module."""
    return load_script(ROOT / "tools" / f"{name}.py")


def page() -> str:
    """Return the page."""
    scripts = tool("parameters")
    parts = [
        "# Parameters\n",
        "A value outside its bounds is refused, with what was expected and what was found. *Live*: may be set",
        "while the node runs (`ros2 param set`). Your own values go into the [cell file](../../cell_file.md).\n",
    ]
    for node, module in scripts.TABLES.items():
        rows = importlib.import_module(module).PARAMETERS.rows
        parts += [
            f"## {node}\n",
            table(("name", "default", "bounds", "meaning"), [_row(row, scripts) for row in rows]),
        ]
    return "\n".join(parts)


def _row(row: Any, scripts: ModuleType) -> tuple[str, ...]:
    low = "" if row.minimum is None else f"{row.minimum:g}"
    high = "" if row.maximum is None else f"{row.maximum:g}"
    bounds = f"{low} .. {high}" if low or high else ", ".join(map(str, row.choices))
    former = f" Former name: `{row.former}`." if row.former else ""
    live = " *Live.*" if row.changeable else ""
    default = f"{code(scripts.yaml_value(row.default))} {row.unit}".rstrip()
    return code(row.name), default, bounds, row.description + former + live
