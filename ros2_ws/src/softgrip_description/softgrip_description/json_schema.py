# SPDX-License-Identifier: Apache-2.0
"""What a value breaks of a JSON schema (2020-12), in words: the keywords that the schemas in data use, and no others.

A schema is the one truth of its format: editors complete and check a file with it, and so does `find_problems`.
"""

from __future__ import annotations

import difflib
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from softgrip_description.marked_yaml import Place

_DATA = Path(__file__).parent / "data"
_KINDS: Mapping[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "integer": (int,), "number": (int, float),
}  # fmt: skip
#: pattern -> what it asks for, where that is not a name with a letter first
_PATTERNS = {"^[A-Za-z0-9_]+$": "letters, digits and _", "^[A-Za-z0-9_-]+$": "letters, digits, _ and -"}
#: keywords that say something to people only
_NOTES = {"$schema", "$id", "title", "description"}

#: where, and what is wrong there
Problem = tuple[Place, str]


def schema_path(kind: str) -> Path:
    """Return the shipped schema of a kind of file: "cell" or "hand"."""
    return _DATA / f"{kind}.schema.json"


@cache
def shipped_schema(kind: str) -> Mapping[str, object]:
    """Return the shipped schema of a kind of file: "cell" or "hand"."""
    schema: Mapping[str, object] = json.loads(schema_path(kind).read_text(encoding="utf-8"))
    return schema


def find_problems(value: Any, schema: Mapping[str, Any], place: Place = ()) -> Iterator[Problem]:
    """Yield every problem of a value.

    Raises:
        KeyError: the schema has a keyword that is not known here.
    """
    kind = schema.get("type")
    if kind is not None and not _is_of_kind(value, kind):
        yield place, f"expected {_named(kind)}, found {_shown(value)}{_hint(schema)}"
        return
    for keyword, argument in schema.items():
        if keyword not in _NOTES and keyword != "type":
            yield from _CHECKS[keyword](value, argument, schema, place)


def _is_of_kind(value: object, kind: str) -> bool:
    if isinstance(value, bool) or (isinstance(value, int | float) and not abs(value) <= sys.float_info.max):
        return False
    return isinstance(value, _KINDS[kind])


def _named(kind: str) -> str:
    names = {"object": "keys with values", "array": "a list", "string": "text", "integer": "a whole number"}
    return names.get(kind, f"a {kind}")


def _shown(value: object) -> str:
    text = "nothing" if value is None else json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _hint(schema: Mapping[str, object]) -> str:
    return f" ({schema['description']})" if "description" in schema else ""


def _check_const(value: object, argument: object, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if value != argument or isinstance(value, bool):
        yield place, f"expected {_shown(argument)}, found {_shown(value)}{_hint(schema)}"


def _check_enum(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if value not in argument or isinstance(value, bool):
        choices = ", ".join(_shown(choice) for choice in argument)
        yield place, f"expected one of {choices}, found {_shown(value)}{_hint(schema)}"


def _check_minimum(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if value < argument:
        yield place, f"expected at least {argument:g}, found {value:g}{_hint(schema)}"


def _check_above(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if value <= argument:
        yield place, f"expected more than {argument:g}, found {value:g}{_hint(schema)}"


def _check_maximum(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if value > argument:
        yield place, f"expected at most {argument:g}, found {value:g}{_hint(schema)}"


def _check_min_length(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if len(value) < argument:
        yield place, f"expected some text, found none{_hint(schema)}"


def _check_pattern(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if re.search(argument, value) is None:
        words = _PATTERNS.get(argument, "letters, digits and _, a letter first")
        yield place, f"expected {words}, found {_shown(value)}{_hint(schema)}"


def _check_required(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    for name in argument:
        if name not in value:
            yield (*place, name), f"expected it, found nothing{_hint(schema['properties'][name])}"


def _check_properties(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    del schema
    for name, inner in argument.items():
        if name in value:
            yield from find_problems(value[name], inner, (*place, name))


def _check_others(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    known = schema.get("properties", {})
    for name in value:
        if name in known:
            continue
        if argument is False:
            yield (*place, str(name)), f"expected one of {', '.join(known)}, found {name}{guess(str(name), known)}"
        else:
            yield from find_problems(value[name], argument, (*place, str(name)))


def _check_names(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    del schema
    for name in value:
        yield from find_problems(name, argument, (*place, str(name)))


def _check_min(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if len(value) < argument:
        yield place, f"expected at least {argument}, found {len(value) or 'none'}{_hint(schema)}"


def _check_max(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    if len(value) > argument:
        yield place, f"expected at most {argument}, found {len(value)}{_hint(schema)}"


def _check_items(value: Any, argument: Any, schema: Mapping[str, object], place: Place) -> Iterator[Problem]:
    del schema
    for index, item in enumerate(value):
        yield from find_problems(item, argument, (*place, index))


def guess(name: str, known: Iterator[str] | Mapping[str, object] | set[str]) -> str:
    """Return the known name that was probably meant, as the end of a message; empty where none is close."""
    close = difflib.get_close_matches(name, [*known], 1)
    return f"; did you mean {close[0]}?" if close else ""


_CHECKS: Mapping[str, Callable[[object, object, Mapping[str, object], Place], Iterator[Problem]]] = {
    "const": _check_const,
    "enum": _check_enum,
    "minimum": _check_minimum,
    "exclusiveMinimum": _check_above,
    "maximum": _check_maximum,
    "minLength": _check_min_length,
    "pattern": _check_pattern,
    "required": _check_required,
    "properties": _check_properties,
    "additionalProperties": _check_others,
    "propertyNames": _check_names,
    "minProperties": _check_min,
    "minItems": _check_min,
    "maxItems": _check_max,
    "items": _check_items,
}
