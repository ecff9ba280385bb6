# SPDX-License-Identifier: Apache-2.0
"""Count words and sentences of pages: `python tools/pages/word_counts.py [--at COMMIT] [--limit] PAGE...`.

Tables, code, pictures and headings are left out. A point of a list is a paragraph, too; a sentence ends with . : ? or !
before a space or the end. The aims are a mean of 18 words a sentence and paragraphs of at most 90 words.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
MAX_MEAN_WORDS, MAX_PARAGRAPH_WORDS = 18.0, 90
_PARSER = MarkdownIt("commonmark").enable("table")
_END = re.compile(r"[.:?!](?=\s|$)")
#: What ends with a point and is no sentence.
_SHORT = re.compile(r"\b(?:e\.g|i\.e|Eqs?|Figs?|No|Sci|Comput|vs|cf|al)\.")


@dataclass(frozen=True)
class PageStatistics:
    """Of one page.

    Attributes:
        words, sentences: of its running text.
        longest: words of its longest paragraph.
        figures, table_rows: what stands instead of text.
    """

    words: int
    sentences: int
    longest: int
    figures: int
    table_rows: int

    @property
    def mean(self) -> float:
        """Words a sentence."""
        return self.words / max(1, self.sentences)


def statistics_of(text: str) -> PageStatistics:
    """Return the statistics of a page's text."""
    depth, rows, figures, paragraphs = 0, 0, 0, []
    for token in _PARSER.parse(text):
        depth += {"table_open": 1, "table_close": -1, "heading_open": 1, "heading_close": -1}.get(token.type, 0)
        rows += token.type == "tr_open"
        if token.type != "inline":
            continue
        figures += sum(child.type == "image" for child in token.children or [])
        if depth == 0:
            words = "".join(
                child.content if child.type in {"text", "code_inline"} else " " for child in token.children or []
            )
            paragraphs.append(_SHORT.sub("short", words))
    counts = [len(re.findall(r"\S*\w\S*", one)) for one in paragraphs]
    ends = sum(max(1, len(_END.findall(one))) for one, count in zip(paragraphs, counts, strict=True) if count)
    return PageStatistics(sum(counts), ends, max(counts, default=0), figures, rows)


def text_of(page: Path, commit: str) -> str:
    """Return a page as it is, or as it was at a commit."""
    if not commit:
        return page.read_text(encoding="utf-8")
    name = page.resolve().relative_to(ROOT)
    command = ("git", "show", f"{commit}:{name}")
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def main() -> int:
    """Print a table; with --limit 1 when a page is beyond the aims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", metavar="PAGE", nargs="+", type=Path)
    parser.add_argument("--at", metavar="COMMIT", default="", help="as they were then")
    parser.add_argument("--limit", action="store_true", help="end with 1 where a page is beyond the aims")
    options = parser.parse_args()
    print(
        "| page | words | words a sentence | longest paragraph | figures | rows of tables |\n|---|---|---|---|---|---|"
    )
    beyond = False
    for page in options.pages:
        found = statistics_of(text_of(page, options.at))
        cells = (page.name, found.words, f"{found.mean:.1f}", found.longest, found.figures, found.table_rows)
        print(f"| {' | '.join(map(str, cells))} |")
        beyond |= found.mean > MAX_MEAN_WORDS or found.longest > MAX_PARAGRAPH_WORDS
    return 1 if beyond and options.limit else 0


if __name__ == "__main__":
    sys.exit(main())
