# SPDX-License-Identifier: Apache-2.0
"""What is true in the emulated cell is computed without the predictor's code."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import softgrip_emulator

PACKAGE = Path(softgrip_emulator.__file__).parent
SOURCES = Path(__file__).parents[1]  # the package may be installed elsewhere

#: Of softgrip_model the emulator may read the drawing that a finger is printed from, and nothing that computes.
DRAWING = "softgrip_model.profile"


def imported(text: str) -> set[str]:
    """Modules of softgrip_model that a source names."""
    names = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.split(".")[0] == "softgrip_model"}


def forbidden(names: set[str]) -> set[str]:
    return {name for name in names if name != DRAWING and not name.startswith(DRAWING + ".")}


def test_no_source_of_the_emulator_names_predictor_code() -> None:
    found = {(path.name, name) for path in PACKAGE.rglob("*.py") for name in forbidden(imported(path.read_text()))}
    found |= {(p.name, n) for p in PACKAGE.rglob("*.pyi") for n in forbidden(imported(p.read_text()))}
    assert found == set()


def test_the_walk_sees_predictor_code() -> None:
    assert forbidden(imported("def f():\n    from softgrip_model.friction.laws import GRAVITY\n"))
    assert forbidden(imported("from softgrip_model import finger\n"))
    assert not forbidden(imported("from softgrip_model.profile import load_directory\n"))


def test_nothing_of_the_predictor_is_loaded_with_the_emulator() -> None:
    """Through other packages neither: a process that has imported all of the emulator's pure code."""
    names = [m.name for m in pkgutil.walk_packages([str(PACKAGE)], "softgrip_emulator.") if ".nodes" not in m.name]
    code = "import importlib, sys\n"
    code += f"for name in {names!r}:\n    importlib.import_module(name)\n"
    code += "print('\\n'.join(name for name in sys.modules if name.startswith('softgrip_model.')))\n"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    computing = {name for name in run.stdout.split() if name.split(".")[1] in {"finger", "friction", "gdfe"}}
    assert computing == set()


def test_the_core_includes_nothing_of_the_predictor() -> None:
    headers = [*(SOURCES / "src").rglob("*.cpp"), *(SOURCES / "include").rglob("*.hpp")]
    assert headers
    included = {line for path in headers for line in path.read_text().splitlines() if line.startswith("#include")}
    assert not [line for line in included if "softgrip/" in line and "softgrip/plant/" not in line]
