# SPDX-License-Identifier: Apache-2.0
"""Check that identifiers use the field's words (docs/glossary.md): `python tools/vocabulary.py`, part of `make lint`.

Three rules. A word of daily life where the field has a term is no part of an identifier. A public class name stands for
one class in the workspace. No method is a verb that says nothing without its object (`see`, `take`). What is still to
be renamed stands in tools/vocabulary_pending.txt, which may only become shorter: an entry that no longer occurs is an
error, too.
"""

from __future__ import annotations

import argparse
import ast
import collections
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PENDING = ROOT / "tools/vocabulary_pending.txt"
FOLDERS = ("ros2_ws/src", "embedded", "benchmarks", "tools", "tests")

#: word in an identifier -> the field's words
FORBIDDEN = {
    "anew": "again, new",
    "doors": "node_io",
    "escaped": "lost_contact",
    "excess": "contact_tension",
    "farewell": "shutdown",
    "felt": "peak_contact",
    "fewest": "min",
    "haste": "speed_factor",
    "hooked": "is_hooked_on",
    "leaning": "tip_deflected",
    "leans": "tip_deflected",
    "least": "min",
    "looks": "appearance",
    "mend": "repair, fix",
    "mended": "repaired, fixed",
    "mind": "check, propagate",
    "most": "max",
    "nap": "sleep",
    "passport": "finger_record",
    "passports": "finger_records",
    "patience": "timeout",
    "praise": "summary",
    "remember": "persist",
    "shake": "dynamic_load_factor",
    "told": "sent, commanded, reported",
    "untold": "pending",
    "wall": "end_stop",
    "wanted": "requested, required",
    "witness": "blocked",
    "witnessed": "blocked",
}
#: The field's own words, although they hold a forbidden one.
ALLOWED = {
    "is_hooked_on",
    "most_common",
    "least_squares",
    "wall_clock",
    "almost",
    "at_least",
    "at_most",
    "utmost",
    "topmost",
}

#: Verbs that say nothing alone: a method has an object behind them, so that a search finds it and no other.
BARE_VERBS = frozenset({"answer", "begin", "keep", "look", "note", "say", "see", "take", "tell"})


def words(identifier: str) -> list[str]:
    """Return the words of an identifier in lower case: snake_case and CamelCase taken apart."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", identifier)
    return [word for word in parted.lower().split("_") if word]


def forbidden_word(identifier: str) -> str:
    """Return the forbidden word that an identifier holds, empty for none."""
    plain = "_".join(words(identifier))
    if any(allowed in plain for allowed in ALLOWED):
        return ""
    return next((word for word in words(identifier) if word in FORBIDDEN), "")


def python_files() -> Iterator[Path]:
    """Give every Python file that is checked."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "build" not in path.parts:
                yield path


def cpp_files() -> Iterator[Path]:
    """Give every C++ file of the cores and of their tests."""
    for path in sorted((ROOT / "ros2_ws/src").rglob("*.[ch]pp")):
        if "build" not in path.parts:
            yield path


#: what a C++ file says without naming anything: comments and text
_CPP_PROSE = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', re.DOTALL)


def identifiers(path: Path) -> set[str]:
    """Return every name that a Python or C++ file uses."""
    if path.suffix != ".py":
        return set(re.findall(r"\b[A-Za-z_]\w*", _CPP_PROSE.sub(" ", path.read_text(encoding="utf-8"))))
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    # The names of tests are sentences.
    return {token.string for token in tokens if token.type == tokenize.NAME and not token.string.startswith("test_")}


def classes() -> Iterator[tuple[str, ast.ClassDef]]:
    """Give file and definition of every class of the workspace's packages, tests left out."""
    for path in python_files():
        parts = path.relative_to(ROOT).parts
        if parts[:2] == ("ros2_ws", "src") and "test" not in parts:
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef):
                    yield "/".join(parts[2:]), node


def public_classes() -> dict[str, list[str]]:
    """Return where each public class is defined."""
    found: dict[str, list[str]] = collections.defaultdict(list)
    for where, node in classes():
        if not node.name.startswith("_"):
            found[node.name].append(where)
    return found


def bare_methods(node: ast.ClassDef) -> list[str]:
    """Return the methods of a class that are a bare verb; a file's `tell` is Python's own."""
    names = [one.name for one in node.body if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)]
    return [name for name in names if name in BARE_VERBS and not (name == "tell" and "write" in names)]


def found_problems() -> dict[str, str]:
    """Return entry -> explanation of everything that breaks a rule, pending or not."""
    problems: dict[str, str] = {}
    for path in (*python_files(), *cpp_files()):
        for name in identifiers(path):
            word = forbidden_word(name)
            if word:
                where = path.relative_to(ROOT)
                problems.setdefault(name, f"{where}: '{name}': expected {FORBIDDEN[word]} for '{word}'")
    for name, places in public_classes().items():
        if len(places) > 1:
            problems[f"class {name}"] = f"class {name}: expected one, found {len(places)}: {', '.join(places)}"
    for where, node in classes():
        for name in bare_methods(node):
            text = f"{where}: {node.name}.{name}: expected a verb with its object, found the verb alone"
            problems[f"{node.name}.{name}"] = text
    return problems


def pending() -> set[str]:
    """Return what is known to be still to be renamed."""
    lines = PENDING.read_text(encoding="utf-8").splitlines()
    return {line for line in lines if line and not line.startswith("#")}


def main() -> int:
    """Check; exit code 1 where a rule is broken or an entry is out of date."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write-pending", action="store_true", help="write down what is there now; review the change")
    options = parser.parse_args()
    problems = found_problems()
    if options.write_pending:
        head = "# Identifiers that are still to be renamed (see tools/vocabulary.py). This list only shrinks.\n"
        PENDING.write_text(head + "".join(f"{name}\n" for name in sorted(problems)), encoding="utf-8")
        return 0
    known = pending()
    broken = [text for name, text in sorted(problems.items()) if name not in known]
    broken += [f"{PENDING.name}: '{name}' is gone: take its line out" for name in sorted(known - set(problems))]
    for line in broken:
        print(line)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
