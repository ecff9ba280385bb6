# SPDX-License-Identifier: Apache-2.0
"""Check every link of the pages: `python tools/pages/links.py`, part of `make lint`.

A link has to lead to a file of the repository, a heading or another site; a picture has to be there; every page has to
be in a table of contents. Nothing is built and no network is used: Sphinx with warnings as errors
(`make site`, also part of `make lint`) finds the rest, such as a name in a docstring that is nowhere.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

sys.path.append(str(Path(__file__).parent))

from generated import api

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ROOT / "docs/reference/generated"
#: Written by scripts when the site is built.
GENERATED_PAGES = {"topics", "interfaces", "parameters", "faults", "commands", "file-formats", "api/index", "cpp/index"}
GENERATED_PAGES |= {f"api/{name}" for name in api.PAGES}
ROOT_PAGE = ROOT / "docs/index.md"
_EXTERNAL = re.compile(r"[a-z][a-z0-9+.-]*:")
_TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)
_PARSER = MarkdownIt("commonmark").enable("table")


@dataclass(frozen=True)
class Problem:
    """What is wrong, where."""

    page: Path
    line: int
    text: str

    def __str__(self) -> str:
        """Return it as a compiler would."""
        return f"{self.page.relative_to(ROOT)}:{self.line}: {self.text}"


def pages() -> list[Path]:
    """Return every Markdown file of the repository, those that are not committed yet as well."""
    command = ("git", "ls-files", "-co", "--exclude-standard", "-z", "--", "*.md")
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.split("\0") if name and (ROOT / name).is_file()]


def anchor(heading: str) -> str:
    """Return the anchor of a heading, as forges and MyST make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page."""
    tokens = _PARSER.parse(page.read_text(encoding="utf-8"))
    found: set[str] = set()
    for before, token in pairwise(tokens):
        if before.type == "heading_open":
            plain = "".join(child.content for child in token.children or [] if child.type in {"text", "code_inline"})
            name, count = anchor(plain), 0
            while (name if not count else f"{name}-{count}") in found:
                count += 1
            found.add(name if not count else f"{name}-{count}")
    return found


def links(page: Path) -> Iterator[tuple[int, str]]:
    """Yield line and target of each link and picture."""
    for block in _PARSER.parse(page.read_text(encoding="utf-8")):
        line = (block.map or [0])[0] + 1
        for token in _flat(block.children or []):
            target = token.attrGet("href") if token.type == "link_open" else None
            target = token.attrGet("src") if token.type == "image" else target
            if target:
                yield line, str(target)


def _flat(tokens: list[Token]) -> Iterator[Token]:
    for token in tokens:
        yield token
        yield from _flat(token.children or [])


def is_written_by_build(file: Path) -> bool:
    """Return whether `make site` writes a page, which is there on the site and nowhere else."""
    return file.suffix == ".md" and str(file.with_suffix("")).removeprefix(f"{GENERATED}/") in GENERATED_PAGES


def problems_of(page: Path, known: dict[Path, set[str]]) -> Iterator[Problem]:
    """Yield what is wrong with the links of a page."""
    for line, target in links(page):
        if _EXTERNAL.match(target):
            continue
        path, _, fragment = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if is_written_by_build(file):
            continue
        is_on_site = page.is_relative_to(ROOT / "docs")  # where Sphinx finds no folder
        if not file.is_relative_to(ROOT) or not (file.is_file() if is_on_site else file.exists()):
            yield Problem(page, line, f"expected a file at {target}, found none")
        elif fragment and file.suffix == ".md" and fragment not in known.setdefault(file, anchors(file)):
            yield Problem(page, line, f"expected the heading #{fragment} in {path or page.name}, found none")


def toctree_problems(everything: list[Path]) -> Iterator[Problem]:
    """Yield entries of tables of contents that lead nowhere, and pages of the site that stand in none."""
    listed: set[Path] = {ROOT_PAGE}
    for page in everything:
        text = page.read_text(encoding="utf-8")
        for found in _TOCTREE.finditer(text):
            for entry in found[1].splitlines():
                if not entry.strip() or entry.startswith(":"):
                    continue
                matching = set(page.parent.glob(f"{entry}.md"))
                listed |= {path.resolve() for path in matching}
                name = str((page.parent / entry).resolve())
                if not matching and name.removeprefix(f"{GENERATED}/") not in GENERATED_PAGES:
                    line = text.count("\n", 0, text.index(f"\n{entry}", found.start())) + 2
                    yield Problem(page, line, f"expected a page {entry}.md, found none")
    for page in everything:
        if page.is_relative_to(ROOT / "docs") and not page.is_relative_to(GENERATED) and page not in listed:
            yield Problem(page, 1, "stands in no table of contents: add it to a toctree (docs/explanation.md, ...)")


def check() -> list[Problem]:
    """Return everything that is wrong."""
    everything, known = pages(), {}
    found = [problem for page in everything for problem in problems_of(page, known)]
    return found + list(toctree_problems(everything))


def main() -> int:
    """Print what is wrong; 1 when there is something."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    found = check()
    for problem in found:
        print(problem)
    print(f"links of {len(pages())} pages: {len(found) or 'no'} problems")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
