# SPDX-License-Identifier: Apache-2.0
"""Type descriptions and their RIHS01 hashes (REP-2011, REP-2016)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

# hashlib would load OpenSSL, 3.5 MB in each process, for the same function.
try:
    from _sha256 import sha256
except ImportError:
    try:
        from _sha2 import sha256  # Python 3.12 and later
    except ImportError:
        from hashlib import sha256

if TYPE_CHECKING:
    from collections.abc import Callable

    from embedded_ros.interface_text import FieldType, MessageText

_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "char": 3, "bool": 15, "byte": 16, "string": 17, "wstring": 18,
}  # fmt: skip
_BOUNDED_TEXT = {"string": 21, "wstring": 22}
_ARRAY_OFFSET = {"": 0, "fixed": 48, "bounded": 96, "unbounded": 144}
_PLACEHOLDER = "structure_needs_at_least_one_member"


def description(text: MessageText) -> dict[str, Any]:
    """Return the type description of one message, as REP-2016 lays it out."""
    fields = [{"name": field.name, "type": _field_type(field.type)} for field in text.fields]
    if not fields:
        fields = [{"name": _PLACEHOLDER, "type": _field_type(None)}]
    return {"type_name": text.name, "fields": fields}


def _field_type(kind: FieldType | None) -> dict[str, Any]:
    if kind is None:
        return {"type_id": 3, "capacity": 0, "string_capacity": 0, "nested_type_name": ""}
    identifier = _IDS.get(kind.base, 1)
    if kind.text_bound:
        identifier = _BOUNDED_TEXT[kind.base]
    return {
        "type_id": identifier + _ARRAY_OFFSET[kind.array],
        "capacity": kind.size,
        "string_capacity": kind.text_bound,
        "nested_type_name": "" if kind.primitive else kind.base,
    }


def full_description(text: MessageText, lookup: Callable[[str], MessageText]) -> dict[str, Any]:
    """Return the description with all types it refers to, sorted by name.

    Args:
        text: the type.
        lookup: gives the parsed text of ``pkg/msg/Name``.
    """
    seen: dict[str, dict[str, Any]] = {}
    todo = [text]
    while todo:
        for field in todo.pop().fields:
            if not field.type.primitive and field.type.base not in seen:
                nested = lookup(field.type.base)
                seen[field.type.base] = description(nested)
                todo.append(nested)
    return {
        "type_description": description(text),
        "referenced_type_descriptions": [seen[name] for name in sorted(seen)],
    }


def type_hash(text: MessageText, lookup: Callable[[str], MessageText]) -> str:
    """Return ``RIHS01_<sha256>`` of a type."""
    digest: str = sha256(json.dumps(full_description(text, lookup)).encode()).hexdigest()
    return "RIHS01_" + digest
