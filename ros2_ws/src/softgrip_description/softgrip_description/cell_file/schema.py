# SPDX-License-Identifier: Apache-2.0
"""What a value breaks of a JSON schema (2020-12), in words: the keywords that cell.schema.json uses, and no others.

The schema is the one truth of the format: editors complete and check a cell file with it, and so does `find_problems`.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from softgrip_description.cell_file.marked_yaml import Place

_SHIPPED = Path(__file__).parents[1] / "data" / "cell.schema.json"
_KINDS: Mapping[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "integer": (int,), "number": (int, float),
}  # fmt: skip
#: keywords that say something to people only
_NOTES = {"$schema", "$id", "title", "description"}

#: where, and what is wrong there
Problem = tuple[Place, str]


@cache
def cell_schema() -> Mapping[str, Any]:
    """Return the shipped schema of a cell file."""
    schema: Mapping[str, Any] = json.loads(_SHIPPED.read_text(encoding="utf-8"))
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


def _is_of_kind(value: Any, kind: str) -> bool:
    if isinstance(value, bool) or (isinstance(value, float) and not math.isfinite(value)):
        return False
    return isinstance(value, _KINDS[kind])


def _named(kind: str) -> str:
    names = {"object": "keys with values", "array": "a list", "string": "text", "integer": "a whole number"}
    return names.get(kind, f"a {kind}")


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _hint(schema: Mapping[str, Any]) -> str:
    return f" ({schema['description']})" if "description" in schema else ""


def _check_const(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if value != argument or isinstance(value, bool):
        yield place, f"expected {_shown(argument)}, found {_shown(value)}{_hint(schema)}"


def _check_enum(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if value not in argument or isinstance(value, bool):
        choices = ", ".join(_shown(choice) for choice in argument)
        yield place, f"expected one of {choices}, found {_shown(value)}{_hint(schema)}"


def _check_minimum(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if value < argument:
        yield place, f"expected at least {argument:g}, found {value:g}{_hint(schema)}"


def _check_maximum(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if value > argument:
        yield place, f"expected at most {argument:g}, found {value:g}{_hint(schema)}"


def _check_min_length(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if len(value) < argument:
        yield place, f"expected some text, found none{_hint(schema)}"


def _check_pattern(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    if re.search(argument, value) is None:
        yield place, f"expected letters, digits and _, a letter first, found {_shown(value)}{_hint(schema)}"


def _check_required(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    for name in argument:
        if name not in value:
            yield (*place, name), f"expected it, found nothing{_hint(schema['properties'][name])}"


def _check_properties(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
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


def _check_items(value: Any, argument: Any, schema: Mapping[str, Any], place: Place) -> Iterator[Problem]:
    del schema
    for index, item in enumerate(value):
        yield from find_problems(item, argument, (*place, index))


def guess(name: str, known: Iterator[str] | Mapping[str, Any] | set[str]) -> str:
    """Return the known name that was probably meant, as the end of a message; empty where none is close."""
    close = difflib.get_close_matches(name, [*known], 1)
    return f"; did you mean {close[0]}?" if close else ""


_CHECKS: Mapping[str, Callable[[Any, Any, Mapping[str, Any], Place], Iterator[Problem]]] = {
    "const": _check_const,
    "enum": _check_enum,
    "minimum": _check_minimum,
    "maximum": _check_maximum,
    "minLength": _check_min_length,
    "pattern": _check_pattern,
    "required": _check_required,
    "properties": _check_properties,
    "additionalProperties": _check_others,
    "items": _check_items,
}
