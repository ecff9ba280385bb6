# SPDX-License-Identifier: Apache-2.0
"""Parts that several pages are made of: a card, lines of facts, a table, a command to copy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from softgrip_panel.web.shell import Page, element, text_element


def card(page: Page, key: str, name: str = "") -> Any:
    """Return a section with its heading; its parts are made inside `with`."""
    section = element("section", classes="card", aria_label=page.t(key), **({"id": name} if name else {}))
    with section:
        text_element("h2", page.t(key))
    return section


def row(page: Page, key: str, read: Any, name: str = "") -> None:
    """Make a line of a list of facts."""
    text_element("dt", page.t(key))
    page.shown.text(text_element("dd", "", **({"id": name} if name else {})), read)


def table(page: Page, *heads: str, is_whole: bool = False) -> Any:
    """Return the body of a plain table; a whole one is as long as its rows, others scroll."""
    with (
        element(
            "div",
            classes="scroll whole" if is_whole else "scroll",
            tabindex="0",
            role="group",
            aria_label=page.t(heads[0]),
        ),
        element("table", classes="plain"),
    ):
        with element("thead"), element("tr"):
            for key in heads:
                text_element("th", page.t(key), scope="col")
        return element("tbody")


def fill(rows: Iterable[Sequence[str]]) -> None:
    """Make rows of texts in a table, the first of each as its heading."""
    for head, *rest in rows:
        with element("tr"):
            text_element("th", head, scope="row")
            for text in rest:
                text_element("td", text)


def verdict_cell(verdict: str, reason: str, *, is_good: bool) -> None:
    """Make a cell with a verdict, which stays one word, and its reason, which may take several lines."""
    with element("td"):
        text_element("span", verdict, "good" if is_good else "whole")
        if reason:
            text_element("span", f" {reason}")


def command(page: Page, line: str) -> None:
    """Show a command with a button that copies it."""
    with element("div", classes="command"):
        text_element("code", line)
        text_element("button", page.t("setup.copy"), "small copy", type="button", data_copied=page.t("setup.copied"))
