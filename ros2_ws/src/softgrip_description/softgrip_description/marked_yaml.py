# SPDX-License-Identifier: Apache-2.0
"""YAML whose values know the line they stand in, and whose keys stand there once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

#: way to a value: keys and indices
Place = tuple[str | int, ...]


@dataclass(frozen=True)
class MarkedDocument:
    """A document and where its values stand.

    Attributes:
        value: plain mappings, lists and scalars.
        lines: [-] of each value, counted from 1.
    """

    value: Any
    lines: Mapping[Place, int]

    def line_of(self, place: Place) -> int:
        """Return the line of a value; of a missing one, that of what it is missing in."""
        return next((self.lines[place[:end]] for end in range(len(place), -1, -1) if place[:end] in self.lines), 1)


def read_marked(text: str, name: str, error: type[ValueError]) -> MarkedDocument:
    """Return a document.

    Args:
        text: YAML.
        name: of its file, for messages.
        error: what is raised.

    Raises:
        ValueError: `error`; not YAML, a key twice, or a tag beyond plain values.
    """
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        lines = dict(_walk(root, (), name, error)) if root is not None else {}
        value = None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as found:
        line = found.problem_mark.line + 1 if found.problem_mark else 1
        raise error(f"{name}:{line}: expected YAML, found: {found.problem}; correct the line") from found
    except error:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as found:
        raise error(f"{name}: expected YAML, found: {found}") from found
    return MarkedDocument(value, lines)


def _walk(node: yaml.Node, place: Place, name: str, error: type[ValueError]) -> Iterator[tuple[Place, int]]:
    yield place, node.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            yield from _walk(child, (*place, index), name, error)
    elif isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, child in node.value:
            if key.value in seen:
                raise error(f"{name}:{key.start_mark.line + 1}: expected each key once, found {key.value} again")
            seen.add(str(key.value))
            yield from _walk(child, (*place, str(key.value)), name, error)


def place_text(place: Place) -> str:
    """Return a place as people write it: servos.chain[0].id."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".") or "the file"
