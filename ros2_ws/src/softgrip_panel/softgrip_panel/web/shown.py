# SPDX-License-Identifier: Apache-2.0
"""Keeps what a page shows up to date: one timer reads everything, and only what has changed is sent."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any


class ShownParts:
    """The changing parts of one page."""

    def __init__(self) -> None:
        self._parts: list[tuple[Callable[[], Any], Callable[[Any], None], list[Any]]] = []

    def follow_value(self, read: Callable[[], Any], write: Callable[[Any], None]) -> None:
        """Write a value whenever it differs from the one before; the first time now."""
        value = read()
        write(value)
        self._parts.append((read, write, [value]))

    def parts(self, holder: Any, read: Callable[[], Any], make: Callable[[Any], None]) -> None:
        """Empty an element and make its parts again whenever a value differs; the first time now."""

        def write(value: Any) -> None:
            holder.clear()
            with holder:
                make(value)

        self.follow_value(read, write)

    def rows(
        self,
        holder: Any,
        read: Callable[[], Any],
        list_rows: Callable[[Any], Sequence[Hashable]],
        make: Callable[[Any], Any],
    ) -> None:
        """Keep one element a row, in their order: new rows are made, gone ones deleted, all others stay as they are.

        A long list that were made again for each of its changes would fill the browser of a page left open for hours.

        Args:
            holder: of the rows and nothing else.
            read: returns what the list depends on, cheaply.
            list_rows: returns the rows for that, each once.
            make: makes a row and returns its element.
        """
        made: dict[Hashable, Any] = {}

        def write(value: Any) -> None:
            current = dict.fromkeys(list_rows(value))
            for gone in [row for row in made if row not in current]:
                made.pop(gone).delete()
            for place, row in enumerate(current):
                if row not in made:
                    with holder:
                        made[row] = make(row)
                if holder.default_slot.children[place] is not made[row]:
                    made[row].move(holder, place)

        self.follow_value(read, write)

    def text(self, element: Any, read: Callable[[], str]) -> Any:
        """Keep the text of an element."""
        self.follow_value(read, element.set_text)
        return element

    def visible(self, element: Any, read: Callable[[], bool]) -> Any:
        """Show an element or not."""
        self.follow_value(read, element.set_visibility)
        return element

    def enabled(self, element: Any, read: Callable[[], bool]) -> Any:
        """Let a button be pressed or not."""
        self.follow_value(read, element.set_enabled)
        return element

    def state(self, element: Any, read: Callable[[], str], name: str = "data-state") -> Any:
        """Keep an attribute that the style sheet colours by."""

        def write(value: str) -> None:
            element._props[name] = value  # noqa: SLF001  the string form of props() would have to be quoted
            element.update()

        self.follow_value(read, write)
        return element

    def refresh(self) -> None:
        """Look at everything once."""
        for read, write, last in self._parts:
            value = read()
            if value != last[0]:
                last[0] = value
                write(value)
