# SPDX-License-Identifier: Apache-2.0
"""Pages of the C++ cores: every header's own words, and each declaration under its name with the comment before it.

Private parts of classes and bodies of free functions are left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
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


_NAMES = (
    re.compile(r"\b(?:class|struct|enum(?:\s+class)?)\s+(\w+)"),
    re.compile(r"\b(?:using|concept)\s+(\w+)"),
    re.compile(r"^(?:inline |static )*constexpr\s[\w:<>, ]*?(\w+)\s*(?:=|\{[^}]*\};)"),  # a constant
    re.compile(r"([\w~]+(?:\s*[-+*/=<>&|!^]+)?)\s*\("),  # a function, an operator
    re.compile(r"(\w+)\s*(?:\{|=|;|\[)"),  # a constant
)


@dataclass(frozen=True)
class Declaration:
    """What a header declares: its name, the comment before it, and the code."""

    name: str
    comment: str
    code: str


def headers(package: str, pattern: str) -> list[Path]:
    """Return the headers of a page."""
    found = (SOURCES / package / "include/softgrip").glob(pattern)
    return sorted(path for path in found if not path.name.endswith(INTERNAL))


def declarations(code: str) -> list[Declaration]:
    """Return what a header declares at the level of its namespaces.

    Args:
        code: without includes; formatted by clang-format, so that a line ends what it closes.
    """
    found: list[Declaration] = []
    comment: list[str] = []
    lines: list[str] = []
    depth = 0
    for line in code.splitlines():
        bare = re.sub(r"//.*|\"(?:\\.|[^\"])*\"|'(?:\\.|[^'])'", "", line)
        if not lines and depth == 0:
            if line.startswith("//"):
                comment.append(line.removeprefix("//").strip())
                continue
            if not bare.strip() or re.match(r"(?:inline )?namespace\b|\}|#", bare):
                comment = comment if line.startswith("#") else []
                continue
        lines.append(line)
        depth += bare.count("{") - bare.count("}") + bare.count("(") - bare.count(")")
        if depth == 0 and bare.rstrip().endswith((";", "}")):
            found.append(_declaration("\n".join(lines), "\n".join(comment)))
            comment, lines = [], []
    return found


def _declaration(code: str, comment: str) -> Declaration:
    head = re.sub(r"^template\s*<[^>]*(?:<[^>]*>[^>]*)*>\s*", "", code)
    is_type = re.match(r"(?:class|struct|enum|union)\b", head) is not None
    patterns = _NAMES[:1] if is_type else _NAMES[1:]
    name = next(found[1] for pattern in patterns if (found := pattern.search(head)))
    if not is_type and re.search(r"\)[^;{]*\{\n", code):
        code = re.sub(r"\s*\{\n.*", ";", code, flags=re.DOTALL)  # the body of a function
    return Declaration(re.sub(r"\s", "", name), comment, code)


def section(path: Path) -> str:
    """Return a header: its leading comment, then each declaration with its own."""
    _, _, text = path.read_text(encoding="utf-8").partition("\n")  # the licence
    comment, _, code = text.partition("#pragma once")
    prose = "\n".join(line.removeprefix("//").strip() for line in comment.strip().splitlines())
    code = "\n".join(line for line in code.splitlines() if not line.startswith("#include"))
    code = re.sub(r"\n{3,}", "\n\n", _PRIVATE.sub("", code + "\n")).strip()
    name = path.relative_to(path.parents[[p.name for p in path.parents].index("include")]).as_posix()
    parts = [f"## {name}\n\n{_as_text(prose)}\n"]
    shown = ""
    for one in declarations(code):
        if one.name != shown:  # overloads stand together
            parts.append(f"### `{one.name}`\n")
        shown = one.name
        parts += [f"{_as_text(one.comment)}\n"] if one.comment else []
        parts.append(f"```cpp\n{one.code}\n```\n")
    return "\n".join(parts)


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
