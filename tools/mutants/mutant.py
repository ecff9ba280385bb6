# SPDX-License-Identifier: Apache-2.0
"""The list of mutants: deliberate errors that a test has to notice, read from the TOML files in `list/`."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

#: keys of an area's file, and of one mutant in it
_AREA_KEYS = {"area", "file", "tests", "suite", "pending", "mutant"}
_MUTANT_KEYS = {"id", "file", "old", "new", "tests", "suite", "why", "equivalent"}
#: tests that run by the machine's clock: nothing runs beside them, and a failure has to repeat
REAL_TIME = (
    "tests/system",
    "tests/faults",
    "ros2_ws/src/softgrip_driver/test/real_time",
    "ros2_ws/src/softgrip_cell/test/manager",
    "ros2_ws/src/softgrip_bag/test/test_recorder_process.py",
)


class ListError(Exception):
    """The list of mutants is wrong: a key is missing, a text is stale, an id occurs twice."""


@dataclass(frozen=True)
class Mutant:
    """One deliberate error.

    Attributes:
        area: name of the group whose score it counts for.
        id: unique; lower case with dashes.
        file: path in the repository.
        old: exact text that occurs once in the file.
        new: text that takes its place.
        tests: pytest arguments (paths, node ids) of the tests that must notice it; run first.
        suite: pytest arguments of everything that is run before it counts as survived.
        why: what the error would do to a person, a product or a record.
        equivalent: argument why nobody could notice it; such a mutant is not counted. Empty for all others.
        pending: what has to be merged before the mutant applies; empty for those in force.
    """

    area: str
    id: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    suite: tuple[str, ...]
    why: str
    equivalent: str = ""
    pending: str = ""

    @property
    def is_real_time(self) -> bool:
        """Whether its tests need the machine to themselves."""
        return any(path.startswith(REAL_TIME) for path in (*self.tests, *self.suite))

    @property
    def _paths(self) -> tuple[str, ...]:
        """The tests without pytest's options."""
        return tuple(test for test in (*self.tests, *self.suite) if not test.startswith("-"))

    def apply(self, source: str) -> str:
        """Return the source with the error in it.

        Raises:
            ListError: the old text does not occur exactly once, or nothing changes.
        """
        found = source.count(self.old)
        if found != 1:
            raise ListError(
                f"{self.area}/{self.id}: expected its old text once in {self.file}, found it {found} times; "
                "the code has changed: write the mutant for what stands there now, or remove it"
            )
        mutated = source.replace(self.old, self.new)
        if mutated == source:
            raise ListError(f"{self.area}/{self.id}: expected old and new texts that differ, found the same")
        return mutated

    def check(self, root: Path) -> None:
        """Raise ListError unless the mutant applies to the sources under ``root``, still compiles, and has tests."""
        path = root / self.file
        if not path.is_file():
            raise ListError(f"{self.area}/{self.id}: expected the file {self.file}, found none")
        mutated = self.apply(path.read_text(encoding="utf-8"))
        try:
            compile(mutated, self.file, "exec")
        except SyntaxError as error:
            raise ListError(f"{self.area}/{self.id}: expected Python, found: {error}") from error
        for test in self._paths:
            if not (root / test.partition("::")[0]).exists():
                raise ListError(f"{self.area}/{self.id}: expected the test {test}, found none")

    def digest(self, root: Path) -> str:
        """Return what a result depends on as a hash: the mutant, its file and the tests that are run first."""
        parts = [self.id, self.old, self.new, (root / self.file).read_text(encoding="utf-8")]
        for test in self._paths:
            path = root / test.partition("::")[0]
            parts += [one.read_text(encoding="utf-8") for one in sorted(path.rglob("*.py"))] if path.is_dir() else []
            parts += [path.read_text(encoding="utf-8")] if path.is_file() else []
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def read_list(folder: Path) -> list[Mutant]:
    """Return the mutants of every file in a folder, in the order of files and entries.

    Raises:
        ListError: a file is no TOML, a key is unknown or missing, or an id occurs twice.
    """
    mutants = [mutant for path in sorted(folder.glob("*.toml")) for mutant in _read_area(path)]
    ids = [mutant.id for mutant in mutants]
    twice = sorted({one for one in ids if ids.count(one) > 1})
    if twice:
        raise ListError(f"expected every id once, found twice: {', '.join(twice)}")
    return mutants


def check_list(mutants: Iterable[Mutant], root: Path) -> list[str]:
    """Return what is wrong with mutants in force, one line each; empty when all apply."""
    problems = []
    for mutant in mutants:
        try:
            if not mutant.pending:
                mutant.check(root)
        except ListError as error:
            problems.append(str(error))
    return problems


def find_ripe(mutants: Sequence[Mutant], root: Path) -> list[str]:
    """Return the ids of pending mutants that apply by now: their ``pending`` has to go."""
    ripe = []
    for mutant in mutants:
        try:
            if mutant.pending:
                mutant.check(root)
                ripe.append(mutant.id)
        except ListError:
            continue
    return ripe


def _read_area(path: Path) -> list[Mutant]:
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        unknown = set(document) - _AREA_KEYS
        if unknown:
            raise ListError(f"{path.name}: expected the keys {sorted(_AREA_KEYS)}, found also {sorted(unknown)}")
        return [_read_mutant(path, document, entry) for entry in document["mutant"]]
    except (tomllib.TOMLDecodeError, KeyError) as error:
        raise ListError(f"{path.name}: expected area, suite and [[mutant]] entries, found: {error!r}") from error


def _read_mutant(path: Path, area: dict[str, object], entry: dict[str, object]) -> Mutant:
    unknown = set(entry) - _MUTANT_KEYS
    if unknown:
        raise ListError(f"{path.name}: mutant {entry.get('id')}: expected the keys {sorted(_MUTANT_KEYS)}, "
                        f"found also {sorted(unknown)}")  # fmt: skip
    merged = {key: value for key, value in area.items() if key != "mutant"} | entry
    missing = {"id", "file", "old", "new", "tests", "suite", "why"} - set(merged)
    if missing:
        raise ListError(f"{path.name}: mutant {entry.get('id')}: expected also {sorted(missing)}")
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in merged.items()}
    return Mutant(**values)  # type: ignore[arg-type]  # the keys were checked above
