# SPDX-License-Identifier: Apache-2.0
"""Every code block of the tutorials and how-to guides is run; those that take long by `make docs-test`."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
LONG = bool(os.environ.get("SOFTGRIP_LONG_BLOCKS"))


#: Pages whose language is held to the aims of tools/pages/word_counts.py, besides the tutorials and guides.
WRITTEN = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs/build").glob("*.md")]


def tool(name: str) -> ModuleType:
    return load_script(ROOT / "tools/pages" / f"{name}.py")


blocks = tool("blocks")
links = tool("links")
word_counts = tool("word_counts")
PAGES = list(blocks.pages())


@pytest.mark.timeout(1200 if LONG else 120)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_what_a_page_says_to_type_works(page: Path, tmp_path: Path) -> None:
    blocks.Reader(tmp_path, long=LONG).run(page)


@pytest.mark.parametrize("page", sorted({*WRITTEN, *PAGES}), ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_sentences_and_paragraphs_are_short(page: Path) -> None:
    found = word_counts.statistics_of(page.read_text(encoding="utf-8"))
    assert found.mean <= word_counts.MAX_MEAN_WORDS
    assert found.longest <= word_counts.MAX_PARAGRAPH_WORDS


def test_words_and_sentences_are_counted_without_tables_and_code() -> None:
    running = "One two three. Four: five, e.g. six?\n\n* seven `eight`"  # nine words, four ends, seven in the first
    text = f"# A b c\n\n    code is left out\n\n|a|b|\n|---|---|\n|c d|e|\n\n![p](p.png)\n\n{running}\n"
    found = word_counts.statistics_of(text)
    assert (found.words, found.sentences, found.longest, found.figures, found.table_rows) == (9, 4, 7, 1, 2)


def test_every_link_leads_somewhere() -> None:
    assert [str(problem) for problem in links.check()] == []


def test_a_broken_link_and_a_page_in_no_contents_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/index.md").write_text("# Top\n\n```{toctree}\nthere\nnowhere\n```\n\n[a](there.md#good-news)\n")
    (tmp_path / "docs/there.md").write_text(
        "# Good news\n\n[b](gone.md) [c](index.md#no) ![d](no.png) [e](https://x.y)\n"
    )
    (tmp_path / "docs/lost.md").write_text("# Lost\n")
    monkeypatch.setattr(links, "ROOT", tmp_path)
    monkeypatch.setattr(links, "ROOT_PAGE", tmp_path / "docs/index.md")
    monkeypatch.setattr(links, "pages", lambda: sorted(tmp_path.rglob("*.md")))
    found = [str(problem) for problem in links.check()]
    assert [line.partition(":")[0] for line in found] == ["docs/there.md"] * 3 + ["docs/index.md", "docs/lost.md"]


@pytest.mark.parametrize(
    ("expected", "printed", "same"),
    [
        ("tip at 12.3 mm", "tip at 12.4 mm", True),
        ("tip at 12.3 mm", "tip at 12.6 mm", False),
        ("tip at 12.3 mm", "top at 12.3 mm", False),
        ("found in ... s", "found in 0.11 s", True),
        ("found in ... s", "lost in 0.11 s", False),
    ],
)
def test_output_is_compared_by_words_and_numbers(expected: str, printed: str, *, same: bool) -> None:
    assert blocks.alike(expected, printed) is same


def test_a_page_that_says_something_else_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n<!-- output -->\n```text\n4\n```\n")
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    monkeypatch.setattr(blocks, "TOP", ())
    with pytest.raises(blocks.BlockError, match="expected the line"):
        blocks.Reader(tmp_path).run(page)


@pytest.mark.parametrize(
    "line", ["ros2 run softgrip_model predicts", "ros2 launch softgrip_bringup cell.launch.yaml cells:=2", "make cofee"]
)
def test_a_command_that_does_not_exist_is_found_without_running_it(line: str, tmp_path: Path) -> None:
    block = blocks.Block(ROOT / "docs/index.md", 1, "sh", line)
    with pytest.raises(blocks.BlockError):
        blocks.check_names(block)
