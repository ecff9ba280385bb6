# SPDX-License-Identifier: Apache-2.0
"""No module needs, on any way, what needs it; imports for types alone count, too."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = ROOT / "ros2_ws" / "src"
PACKAGES = sorted(path.parent for path in WORKSPACE.glob("*/*/__init__.py") if path.parent.name == path.parents[1].name)

#: importer, what it imports: a message pickles itself as the name under which the registry finds its class again, and
#: messages, their encoding and its checks name one another as types
ALLOWED = {
    ("embedded_ros.messages", "embedded_ros.registry"),
    ("embedded_ros.cdr", "embedded_ros.messages"),
    ("embedded_ros.field_check", "embedded_ros.messages"),
}


def modules(package: Path) -> dict[str, Path]:
    """Return the modules of a package; a package itself, whose __init__ only passes names on, is none."""
    names = {}
    for path in package.rglob("*.py"):
        if path.name != "__init__.py":
            names[".".join((package.name, *path.relative_to(package).with_suffix("").parts))] = path
    return names


def imports(path: Path, known: Mapping[str, Path]) -> set[str]:
    """Return which of the known modules a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found & set(known)


def circle(package: Path) -> list[str]:
    """Return one circle of imports in a package, empty for none."""
    known = modules(package)
    graph = {
        name: {needed for needed in imports(path, known) if (name, needed) not in ALLOWED}
        for name, path in known.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


# rclpy has upstream's own shape, in which a node, its executor and its entities know one another.
@pytest.mark.parametrize("package", [*PACKAGES, ROOT / "embedded" / "embedded_ros"], ids=lambda path: path.name)
def test_no_modules_import_one_another(package: Path) -> None:
    assert circle(package) == []


def test_a_circle_is_found_also_where_it_is_for_types_alone(tmp_path: Path) -> None:
    package = tmp_path / "one"
    package.mkdir()
    (package / "first.py").write_text("from one import second\n")
    (package / "second.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from one.first import x\n"
    )
    assert set(circle(package)) == {"one.first", "one.second"}
