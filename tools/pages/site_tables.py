# SPDX-License-Identifier: Apache-2.0
"""Lets long names in the site's tables break behind `/`, `_` and `.`: a table of names is else wider than its page.

A <wbr> is no character: what is copied or searched for stays as it is. The first column names what its row is
about, and breaks last.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

_ROW = re.compile(r"<tr\b.*?</tr>", re.DOTALL)
_CELL = re.compile(r"<td\b.*?</td>", re.DOTALL)
#: A tag, which stays as it is, or a word between tags.
_PIECE = re.compile(r"(<[^>]*>)|([^\s<>]+)")
#: Words as long as that break.
FIRST_COLUMN, OTHERS = 25, 12
_BREAK = re.compile(r"([/_.,=](?=\w))")


def breakable(body: str) -> str:
    """Return a page's HTML with places to break in the long words of its tables."""
    return _ROW.sub(lambda row: _breakable_row(row[0]), body)


def _breakable_row(row: str) -> str:
    limits = itertools.chain([FIRST_COLUMN], itertools.repeat(OTHERS))
    return _CELL.sub(lambda cell: _breakable_cell(cell[0], next(limits)), row)


def _breakable_cell(cell: str, limit: int) -> str:
    def piece(found: re.Match[str]) -> str:
        return found[1] or (_BREAK.sub(r"\1<wbr>", found[2]) if len(found[2]) >= limit else found[2])

    return _PIECE.sub(piece, cell)


def _break(_app: Any, _page: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    if "body" in context:
        context["body"] = breakable(context["body"])


def setup(app: Any) -> dict[str, bool]:
    """Connect with Sphinx."""
    app.connect("html-page-context", _break)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
