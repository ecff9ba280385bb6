# SPDX-License-Identifier: Apache-2.0
"""Links names in the site's code blocks to the reference: each name that a page's Python blocks import.

A page imports `close` from `softgrip_model.finger`; wherever its blocks say `close`, a click shows its signature.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Any

from docutils import nodes

_BLOCK = re.compile(r'<div class="highlight-python.*?</pre>', re.DOTALL)
#: A name as Pygments writes it; what follows a point is a member of something else.
_NAME = re.compile(r'(?<!<span class="o">\.</span>)<span class="n[nc]?">(\w+)</span>')


def imported(source: str) -> Iterator[tuple[str, str]]:
    """Yield each name that a block imports from somewhere, and its full name; nothing of a block that is no Python."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for one in node.names:
                yield one.asname or one.name, f"{node.module}.{one.name}"


def linked(body: str, targets: dict[str, str]) -> str:
    """Return a page's HTML with the names of its Python blocks linked; targets: name -> address."""

    def link(found: re.Match[str]) -> str:
        address = targets.get(found[1])
        return f'<a class="in-code" href="{address}">{found[0]}</a>' if address else found[0]

    return _BLOCK.sub(lambda block: _NAME.sub(link, block[0]), body)


def _link(app: Any, page: str, _template: str, context: dict[str, Any], doctree: nodes.document | None) -> None:
    """Link the names of one page."""
    if doctree is None:
        return
    objects = app.env.get_domain("py").objects
    targets = {}
    for block in doctree.findall(nodes.literal_block):
        if block.get("language") == "python":
            for name, full in imported(block.astext()):
                if full in objects:
                    entry = objects[full]
                    targets[name] = f"{app.builder.get_relative_uri(page, entry.docname)}#{entry.node_id}"
    context["body"] = linked(context["body"], targets)


def setup(app: Any) -> dict[str, bool]:
    """Connect with Sphinx."""
    app.connect("html-page-context", _link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
