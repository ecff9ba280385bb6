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
from softgrip_panel.model import acts, explain
from softgrip_panel.model.orders import read_orders
from softgrip_panel.texts import Texts, speak

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
    "warnings.",
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


#: Errors that a person at a page, at the log-in or at `users` is told.
SHOWN_ERRORS = {"PanelError", "ActRefusedError", "AccessError"}
#: The catalogue itself cannot say that it is missing.
NOT_IN_THE_CATALOGUE = {"texts/__init__.py"}


def words_beside_the_catalogue(code: str) -> list[str]:
    """Return the texts with which code raises an error that a person is told."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in SHOWN_ERRORS:
            found += [ast.unparse(one) for one in node.args if isinstance(one, (ast.Constant, ast.JoinedStr))]
    return found


@pytest.mark.parametrize("path", [str(one.relative_to(PACKAGE)) for one in PACKAGE.rglob("*.py")])
def test_what_people_are_told_stands_in_the_catalogue(path: str) -> None:
    found = words_beside_the_catalogue((PACKAGE / path).read_text())
    assert bool(found) is (path in NOT_IN_THE_CATALOGUE), found


def test_words_beside_the_catalogue_are_found() -> None:
    assert words_beside_the_catalogue("raise PanelError(f'expected {x}') from error") == ["f'expected {x}'"]
    assert words_beside_the_catalogue("raise AccessError(say('error.name', limit=4))") == []


def test_every_known_warning_has_a_cause_and_a_remedy() -> None:
    texts, keys = Texts(), {row.key for row in explain._WARNINGS}
    assert {key.split(".")[1] for key in texts.keys if key.startswith("warnings.")} == keys
    assert [key for key in keys for part in ("cause", "remedy") if not texts.has(f"warnings.{key}.{part}")] == []


def test_a_panel_in_another_language_refuses_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "xx.yaml").write_text("error:\n  orders_none: 'nul'\n  order: 'ligne {number}: {found}'\n")
    monkeypatch.setattr("softgrip_panel.texts.FOLDER", tmp_path)
    try:
        speak(Texts("xx"))
        with pytest.raises(PanelError, match="ligne 1: a, b, c"):
            read_orders("a, b, c")
    finally:
        monkeypatch.undo()
        speak(Texts())
    with pytest.raises(PanelError, match="order list, line 1: expected a product and a number"):
        read_orders("a, b, c")


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
