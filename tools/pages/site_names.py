# SPDX-License-Identifier: Apache-2.0
"""Names in docstrings: a link where the site has them, plain code where they exist without a page, else a warning.

Sphinx looks for a name as it is written. Docstrings name what they need as the code does: by its last part, or where it
is defined, though a package's page shows it. Types of numpy, rclpy and the standard library have no page here; without
a network nothing can be linked to them. That they exist is looked up in the modules that the site's build has imported.
"""

from __future__ import annotations

import builtins
import contextlib
import functools
import importlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.util.nodes import make_refnode

#: What has to be there: a dotted name, or one in CamelCase. Another word is a field, a parameter or prose.
_NAME = re.compile(r"(?:[A-Za-z_]\w*\.)+[A-Za-z_]\w*|_?[A-Z][A-Za-z0-9]*[a-z][A-Za-z0-9]*")
_WRITTEN = re.compile(r"^(?:class | *)(_?[A-Z]\w+)(?:\(|:|\[| = )", re.MULTILINE)
#: What a part of a service or an action calls itself: `Swap_Goal`, and it is `Swap.Goal`.
_PART = re.compile(r"_(Request|Response|Goal|Result|Feedback)$")
ROOT = Path(__file__).resolve().parents[2]
#: Ends of dotted words that are no names of Python.
_FILES = (".csv", ".json", ".npz", ".toml", ".url", ".xml", ".yaml")
OWN = ("softgrip_", "embedded_ros", "rclpy")


def is_name(text: str) -> bool:
    """Return whether a reference is to something of Python that has to be there."""
    return _NAME.fullmatch(text) is not None and not text.endswith(_FILES)


def on_a_page(target: str, shown: Iterable[str]) -> str | None:
    """Return the only name of the site with the last part of a target; None for none or several."""
    last = target.rpartition(".")[2]
    same = [name for name in shown if name.rpartition(".")[2] == last]
    return same[0] if len(same) == 1 else None


def exists(target: str, modules: Iterable[ModuleType]) -> bool:
    """Return whether a name can be imported, or is known in one of some modules."""
    target = _PART.sub(r".\1", target)
    if _imported(target):
        return True
    first, *rest = target.split(".")
    for module in (builtins, *modules):
        found: Any = module
        for part in (first, *rest):
            found = getattr(found, part, None)
        if found is not None:
            return True
    return False


def _imported(target: str) -> bool:
    module, rest = target, list[str]()
    while module:
        try:
            found: Any = importlib.import_module(module)
        except Exception:  # noqa: BLE001  whatever a module says that is none
            module, _, last = module.rpartition(".")
            rest.insert(0, last)
            continue
        for part in rest:
            found = getattr(found, part, None)
        return found is not None
    return False


def own_modules() -> list[ModuleType]:
    """Return the project's modules that are imported, and where names for type checkers alone come from."""
    own = [module for name, module in list(sys.modules.items()) if name.startswith(OWN) and module is not None]
    return [*own, contextlib]


@functools.cache
def written() -> frozenset[str]:
    """Return every class and alias of a type in the sources: some are imported for type checkers alone."""
    found = (path.read_text(encoding="utf-8") for path in (ROOT / "ros2_ws/src").glob("*/softgrip_*/**/*.py"))
    return frozenset(name for text in found for name in _WRITTEN.findall(text))


def _missing(app: Any, environment: Any, node: Any, text: Any) -> Any:
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    if not is_name(target):
        return text
    objects = environment.domains["py"].objects
    name = on_a_page(target, (one for one, entry in objects.items() if entry.objtype != "module"))
    if name is not None:
        entry = objects[name]
        return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, text, name)
    return text if target in written() or exists(target, own_modules()) else None


def _whole(_app: Any, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Keep napoleon from taking the first words of a constant's text for its type, up to a colon in its first line."""
    if what in {"attribute", "data", "property"} and lines:
        lines[:1] = without_type(lines[0])


def without_type(line: str) -> list[str]:
    """Return the same text as lines of which the first has no colon, where there is a word before that of the colon."""
    before, space, _ = line.partition(":")[0].rpartition(" ")
    return [before, line[len(before + space) :]] if ":" in line and space else [line]


def setup(app: Any) -> dict[str, bool]:
    """Connect."""
    app.connect("missing-reference", _missing)
    app.connect("autodoc-process-docstring", _whole, priority=450)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
