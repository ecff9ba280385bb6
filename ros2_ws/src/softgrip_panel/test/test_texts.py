# SPDX-License-Identifier: Apache-2.0
"""Every text that pages use is in the catalogue, and none is there that nobody uses."""

from __future__ import annotations

import ast
import functools
import re
import string
from pathlib import Path

import pytest

from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.texts import Texts

PACKAGE = Path(__file__).resolve().parents[1] / "softgrip_panel"
#: Keys that are put together from a value: all that begin so are used.
PREFIXES = (
    "mode.",
    "role.",
    "act.",
    "counters.",
    "alarms.",
    "nav.",
    "step.",
    "work.phase_",
    "bags.make_",
    "friction.plan_",
    "fingers.limits_",
    "setup.phase_",
    "setup.free_",
    "setup.take_",
    "setup.do_",
    "setup.why_",
    "setup.bus_",
)

#: Names of files that look like keys.
FILES = {"cell.yaml", "grasps.csv", "swap.json", "work.json", "friction.json"}


@functools.cache
def used() -> frozenset[str]:
    """Return every string of the package that could be a key."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)
    return frozenset(found)


def test_no_text_is_there_that_nobody_uses() -> None:
    unused = [key for key in Texts().keys if key not in used() and not key.startswith(PREFIXES)]
    assert unused == []


def test_every_key_that_pages_name_is_there() -> None:
    texts = Texts()
    groups = {key.partition(".")[0] for key in texts.keys if "." in key}
    named = {value for value in used() if value.partition(".")[0] in groups and re.fullmatch(r"[a-z]+\.[a-z_]+", value)}
    missing = [value for value in named if not texts.has(value) and value not in FILES and value not in PREFIXES]
    assert missing == []


def test_every_act_has_a_name() -> None:
    texts = Texts()
    assert [act.name for act in acts.EXAMPLES if not texts.has(f"act.{act.name}")] == []


def test_every_text_can_be_filled_in() -> None:
    texts = Texts()
    for key in texts.keys:
        fields = {name for _, name, _, _ in string.Formatter().parse(texts(key)) if name}
        assert texts(key, **dict.fromkeys(fields, 1.0))


def test_a_language_that_is_not_there_is_refused() -> None:
    with pytest.raises(PanelError, match="expected one of en"):
        Texts("../../etc/passwd")
