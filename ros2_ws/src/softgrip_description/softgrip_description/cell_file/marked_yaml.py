# SPDX-License-Identifier: Apache-2.0
"""YAML whose values know the line they stand in, and whose keys stand there once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from softgrip_description.errors import CellFileError

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


def read_marked(text: str, name: str) -> MarkedDocument:
    """Return a document.

    Raises:
        CellFileError: not YAML, a key twice, or a tag beyond plain values.
    """
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        lines = dict(_walk(root, (), name)) if root is not None else {}
        value = None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise CellFileError(f"{name}:{line}: expected YAML, found: {error.problem}; correct the line") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CellFileError(f"{name}: expected YAML, found: {error}") from error
    return MarkedDocument(value, lines)


def _walk(node: yaml.Node, place: Place, name: str) -> Iterator[tuple[Place, int]]:
    yield place, node.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            yield from _walk(child, (*place, index), name)
    elif isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, child in node.value:
            if key.value in seen:
                raise CellFileError(
                    f"{name}:{key.start_mark.line + 1}: expected each key once, found {key.value} again"
                )
            seen.add(str(key.value))
            yield from _walk(child, (*place, str(key.value)), name)


def place_text(place: Place) -> str:
    """Return a place as people write it: servos.chain[0].id."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".") or "the file"
