# SPDX-License-Identifier: Apache-2.0
"""What `looking_at_calls` sees of a module, and that nothing of it stays."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from softgrip_testing.failing_calls import looking_at_calls
from softgrip_testing.scripts import load_script

MODULE = """
from contextlib import contextmanager


class Thing:
    @property
    def size(self):
        return len("ab")

    @staticmethod
    def fixed():
        return abs(-1)

    @classmethod
    def made(cls):
        return cls()

    def close(self):
        return None

    def own(self):
        return [self.fixed() for _ in (1, 2)]


@contextmanager
def held():
    yield Thing.made()


def work():
    with held() as thing:
        thing.own()
        thing.size
        thing.close()
    return "done"
"""


@pytest.fixture
def module(tmp_path: Path) -> ModuleType:
    path = tmp_path / "made_for_looks.py"
    path.write_text(MODULE)
    return load_script(path)


def test_every_call_is_seen_in_its_order_with_its_line(module: ModuleType) -> None:
    seen: list[tuple[str, int]] = []
    before = module.work.__code__
    with looking_at_calls([module], lambda _, line, name: seen.append((name, line))):
        assert module.work() == "done"
    at = {text.strip(): number for number, text in enumerate(MODULE.splitlines(), 1)}
    block = at["with held() as thing:"]
    assert seen == [
        ("held", block),
        ("__enter__", block),
        ("made", at["yield Thing.made()"]),
        ("cls", at["return cls()"]),
        ("own", at["thing.own()"]),
        *[("fixed", at["return [self.fixed() for _ in (1, 2)]"]), ("abs", at["return abs(-1)"])] * 2,
        ("len", at['return len("ab")']),
        ("close", at["thing.close()"]),
        ("__exit__", block),
    ]
    assert module.work.__code__ is before
    assert not [name for name in vars(module) if name.startswith("_looked_at")]


def test_what_a_look_raises_the_call_raises_and_what_is_closed_is_closed(module: ModuleType) -> None:
    closed: list[str] = []
    module.Thing.close = lambda _: closed.append("closed")

    def look(_: str, __: int, name: str) -> None:
        if name == "close":
            raise OSError(name)

    with looking_at_calls([module], look), pytest.raises(OSError, match="close"):
        module.work()
    assert closed == ["closed"]
    assert module.work() == "done"
