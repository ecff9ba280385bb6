# SPDX-License-Identifier: Apache-2.0
"""Pages of the C++ cores: every header's own words, and what it declares; private parts are left out."""

from __future__ import annotations

import re
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[3] / "ros2_ws/src"
#: Page -> (title, what for, package, headers below include/softgrip).
PAGES = {
    "finger": (
        "Friction and finger kernel",
        "softgrip_model.friction, softgrip_model.finger",
        "softgrip_model",
        "*.hpp",
    ),
    "gdfe": ("GDFE", "softgrip_model.gdfe", "softgrip_model", "gdfe/*.hpp"),
    "plant": ("The emulated cell's plant", "softgrip_emulator.plant", "softgrip_emulator", "**/*.hpp"),
    "tracker": ("Marker tracker", "softgrip_vision", "softgrip_vision", "**/*.hpp"),
}
#: Compiled again for every instruction set: not for callers.
INTERNAL = "-inl.hpp"
_PRIVATE = re.compile(r"^ (?:private|protected):\n.*?(?=^(?: public:|\};))", re.DOTALL | re.MULTILINE)


def headers(package: str, pattern: str) -> list[Path]:
    """Return the headers of a page."""
    found = (SOURCES / package / "include/softgrip").glob(pattern)
    return sorted(path for path in found if not path.name.endswith(INTERNAL))


def section(path: Path) -> str:
    """Return a header: its leading comment as text, its declarations as code."""
    _, _, text = path.read_text(encoding="utf-8").partition("\n")  # the licence
    comment, _, code = text.partition("#pragma once")
    prose = "\n".join(line.removeprefix("//").strip() for line in comment.strip().splitlines())
    code = "\n".join(line for line in code.splitlines() if not line.startswith("#include"))
    code = re.sub(r"\n{3,}", "\n\n", _PRIVATE.sub("", code + "\n")).strip()
    name = path.relative_to(path.parents[[p.name for p in path.parents].index("include")]).as_posix()
    return f"## {name}\n\n{_as_text(prose)}\n\n```cpp\n{code}\n```\n"


def _as_text(prose: str) -> str:
    """Return a comment as Markdown that shows it as it is."""
    return re.sub(r"([\\`*_{}\[\]<>#|~$^])", r"\\\1", prose)


def pages() -> dict[str, str]:
    """Return name -> text: an index and one page for each core."""
    made = {
        f"cpp/{name}.md": f"# {title}\n\nThe core behind `{use}`.\n\n"
        + "\n".join(section(path) for path in headers(package, pattern))
        for name, (title, use, package, pattern) in PAGES.items()
    }
    rows = "\n".join(f"| [{title}]({name}.md) | `{use}` |" for name, (title, use, _, _) in PAGES.items())
    made["cpp/index.md"] = (
        "# C++ cores\n\nPrivate to their packages: the typed [Python API](../api/index.md) is the public face, and no "
        "header is installed.\nThese pages are for those who change a core, or take a header into a program of their "
        f"own.\n\n| core | behind |\n|---|---|\n{rows}\n\n```{{toctree}}\n:hidden:\n\n" + "\n".join(PAGES) + "\n```\n"
    )
    return made
