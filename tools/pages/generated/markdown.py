# SPDX-License-Identifier: Apache-2.0
"""Markdown of tables, and where the repository is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
WORKSPACE = ROOT / "ros2_ws" / "src"


def cell(text: object) -> str:
    """Return a text as it may stand in a cell of a table."""
    parts = str(text).replace("|", "\\|").replace("\n", " ").split("`")
    # what stands between ` is shown as it is
    parts[::2] = [part.replace("<", "&lt;") for part in parts[::2]]
    return "`".join(parts).strip()


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table."""
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    lines += [f"| {' | '.join(cell(one) for one in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def code(text: object) -> str:
    """Return a text as code, empty for none."""
    return f"`{text}`" if str(text) else ""
