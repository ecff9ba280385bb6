# SPDX-License-Identifier: Apache-2.0
"""What a class lists under "Attributes:" is there, in it or in a base class beside it: renames leave nothing behind."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "ros2_ws/src"
_NAMES = re.compile(r"((?:\w+, )*\w+): ")


def described(docstring: str) -> list[str]:
    """Return the names that a docstring lists under "Attributes:"."""
    lines = docstring.partition("Attributes:\n")[2].partition("\n\n")[0].splitlines()
    found = [_NAMES.match(line.strip()) for line in lines if line[:4].isspace() and not line[4:5].isspace()]
    return [name for match in found if match for name in match[1].split(", ")]


def known(one: ast.ClassDef, module: dict[str, ast.ClassDef]) -> set[str]:
    """Return the names of a class and of its base classes in the same module."""
    own = {node.target.id for node in one.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)}
    own |= {node.name for node in one.body if isinstance(node, ast.FunctionDef)}
    own |= {node.attr for node in ast.walk(one) if isinstance(node, ast.Attribute)}
    bases = [module[base.id] for base in one.bases if isinstance(base, ast.Name) and base.id in module]
    return own.union(*(known(base, module) for base in bases))


def problems(path: Path) -> Iterator[str]:
    """Yield the names that a module describes and does not have."""
    module = {
        node.name: node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ClassDef)
    }
    for one in module.values():
        for name in sorted(set(described(ast.get_docstring(one) or "")) - known(one, module)):
            yield f"{path.name}: {one.name} describes {name}, which it does not have"


@pytest.mark.parametrize("package", sorted(path.parent.name for path in SOURCES.glob("*/package.xml")))
def test_attributes_that_are_described_are_there(package: str) -> None:
    modules = sorted((SOURCES / package / package).rglob("*.py"))
    assert [problem for path in modules for problem in problems(path)] == []


def test_a_name_that_is_gone_is_found(tmp_path: Path) -> None:
    path = tmp_path / "one.py"
    path.write_text('class A:\n    """B.\n\n    Attributes:\n        old, kept: of it.\n    """\n\n    kept: int\n')
    assert list(problems(path)) == ["one.py: A describes old, which it does not have"]
