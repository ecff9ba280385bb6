# SPDX-License-Identifier: Apache-2.0
"""YAML files that people write, read by their schema: every problem is named at once, with its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from softgrip_description.json_schema import Problem, find_problems, shipped_schema
from softgrip_description.marked_yaml import MarkedDocument, place_text, read_marked

_MAX_BYTES = 1_000_000


@dataclass(frozen=True)
class FileKind:
    """A kind of file with a schema in data/.

    Attributes:
        name: of kind and schema: "cell" or "hand".
        error: what is raised where a file cannot be used.
        remedy: how to come by such a file.
    """

    name: str
    error: type[ValueError]
    remedy: str

    def read(self, path: Path) -> str:
        """Return the text of a file; raises `error` where it cannot be read or is far too large."""
        try:
            with path.open("rb") as file:
                data = file.read(_MAX_BYTES + 1)
            text = data.decode("utf-8")
        except (OSError, UnicodeDecodeError) as found:
            raise self.error(f"{path}: expected a {self.name} file, found: {found}; {self.remedy}") from found
        if len(data) > _MAX_BYTES:
            raise self.error(f"{path}: expected a {self.name} file, found more than {_MAX_BYTES} bytes")
        return text

    def parse(self, text: str, path: Path) -> MarkedDocument:
        """Return the document of a text; raises `error` where it is not YAML or has a key twice."""
        return read_marked(text, str(path), self.error)

    def check(self, document: MarkedDocument, path: Path) -> None:
        """Raise `error` where the schema finds problems."""
        self.refuse(list(find_problems(document.value, shipped_schema(self.name))), document, path)

    def refuse(self, problems: Sequence[Problem], document: MarkedDocument, path: Path) -> None:
        """Raise `error` with all problems in the order of their lines, where there are any."""
        if problems:
            found = sorted((document.line_of(place), place_text(place), text) for place, text in problems)
            raise self.error("\n".join(f"{path}:{line}: {place}: {text}" for line, place, text in found))
