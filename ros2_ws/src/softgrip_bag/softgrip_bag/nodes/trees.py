# SPDX-License-Identifier: Apache-2.0
"""Messages as plain Python values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def tree(message: Any) -> Any:
    """Return a message as nested dicts and lists of plain values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: tree(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)):
        return [tree(item) for item in message]
    return message


def flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (column, value) of every leaf of a tree: ``fingers.0.tip.x``."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from flat(item, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and value and not isinstance(value[0], int | float | str | bytes | bool):
        for index, item in enumerate(value):
            yield from flat(item, f"{path}.{index}")
    elif isinstance(value, list) and len(value) <= _COLUMNS:
        for index, item in enumerate(value):
            yield f"{path}.{index}", item
    elif isinstance(value, (list, bytes)):
        yield f"{path}.length", len(value)
    else:
        yield path, value


#: Longer arrays (images, meshes) are no table columns; their length is.
_COLUMNS = 64
