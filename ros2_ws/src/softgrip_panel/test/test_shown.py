# SPDX-License-Identifier: Apache-2.0
"""What a page makes again when something changes, and what it leaves alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from softgrip_panel.web.shown import ShownParts


class Holder:
    """As much of a NiceGUI element as a list of rows needs."""

    def __init__(self) -> None:
        self.default_slot = SimpleNamespace(children=[])

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


class RowElement:
    """A row in a holder; `calls` is what is asked of all of them."""

    def __init__(self, holder: Holder, text: str, calls: list[str]) -> None:
        self.holder, self.text, self.calls = holder, text, calls
        holder.default_slot.children.append(self)
        calls.append(f"make {text}")

    def delete(self) -> None:
        self.holder.default_slot.children.remove(self)
        self.calls.append(f"delete {self.text}")

    def move(self, holder: Holder, place: int) -> None:
        holder.default_slot.children.remove(self)
        holder.default_slot.children.insert(place, self)
        self.calls.append(f"move {self.text}")


def test_of_a_list_only_what_is_new_is_made() -> None:
    holder, calls, seen = Holder(), list[str](), ["b", "a"]
    parts = ShownParts()
    parts.rows(holder, lambda: tuple(seen), lambda value: value, lambda text: RowElement(holder, text, calls))

    def shown() -> list[Any]:
        return [row.text for row in holder.default_slot.children]

    assert shown() == ["b", "a"]
    calls.clear()
    seen[:] = ["c", "b", "a"]
    parts.refresh()
    assert (shown(), calls) == (["c", "b", "a"], ["make c", "move c"])
    calls.clear()
    seen[:] = ["d", "c", "b"]  # the list is full: the oldest goes
    parts.refresh()
    assert (shown(), sorted(calls)) == (["d", "c", "b"], ["delete a", "make d", "move d"])
    calls.clear()
    seen[:] = ["b", "c", "d"]
    parts.refresh()
    assert shown() == ["b", "c", "d"]
    assert not [call for call in calls if call.startswith(("make", "delete"))]
    calls.clear()
    parts.refresh()
    assert calls == []
