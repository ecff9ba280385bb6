# SPDX-License-Identifier: Apache-2.0
"""Reads .msg, .srv and .action text into plain values (https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html)."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from embedded_ros.errors import InterfaceError

if TYPE_CHECKING:
    from pathlib import Path

INTEGER_RANGES = {
    **{f"int{n}": (-(1 << n - 1), (1 << n - 1) - 1) for n in (8, 16, 32, 64)},
    **{f"uint{n}": (0, (1 << n) - 1) for n in (8, 16, 32, 64)},
}
PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string", "wstring", *INTEGER_RANGES}

_TYPE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=(?P<text_bound>\d+))?"
    r"(?P<array>\[(?P<upto><=)?(?P<size>\d+)?\])?$"
)
_CONSTANT = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Z][A-Z0-9_]*)\s*=\s*(?P<value>.*)$")
_FIELD = re.compile(r"(?P<type>\S+)\s+(?P<name>[a-z](?:_?[a-z0-9])*)(?:\s+(?P<default>.*))?$")


@dataclass(frozen=True)
class FieldType:
    """Type of a field: a primitive name or ``pkg/msg/Name``, its text bound, and whether it is an array."""

    base: str
    text_bound: int = 0
    array: str = ""
    size: int = 0

    @property
    def primitive(self) -> bool:
        """Whether the element is a primitive."""
        return self.base in PRIMITIVES

    @property
    def text(self) -> bool:
        """Whether the element is text."""
        return self.base in {"string", "wstring"}

    @property
    def element(self) -> FieldType:
        """Type of one element of an array."""
        return FieldType(self.base, self.text_bound)

    def __str__(self) -> str:
        """Return the type as ``get_fields_and_field_types`` of rosidl prints it."""
        name = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}.get(
            self.base, self.base.replace("/msg/", "/")
        )
        if self.text_bound:
            name += f"<{self.text_bound}>"
        if self.array == "fixed":
            return f"{name}[{self.size}]"
        if self.array == "bounded":
            return f"sequence<{name}, {self.size}>"
        return f"sequence<{name}>" if self.array else name


@dataclass(frozen=True)
class Field:
    """One field of a message; ``default`` is None when the text gives none."""

    name: str
    type: FieldType
    default: object = None


@dataclass(frozen=True)
class MessageText:
    """A parsed message: full name ``pkg/msg/Name``, fields in order, constants with their types."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, str, object], ...] = ()


def parse_interface(path: Path, package: str, kind: str) -> list[MessageText]:
    """Parse a file into its one (msg), two (srv) or three (action) parts, named like rosidl names them.

    Raises:
        InterfaceError: the text breaks a rule; file and line are in the message.
    """
    suffixes = {"msg": [""], "srv": ["_Request", "_Response"], "action": ["_Goal", "_Result", "_Feedback"]}[kind]
    parts: list[list[tuple[int, str]]] = [[]]
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line.strip() == "---" and kind != "msg":
            parts.append([])
        else:
            parts[-1].append((number, line))
    if len(parts) != len(suffixes):
        raise InterfaceError(
            f"{path}: expected {len(suffixes) - 1} line(s) '---' in a .{kind} file, found {len(parts) - 1}"
        )
    found = [
        _parse_part(lines, f"{package}/{kind}/{path.stem}{suffix}", package, path)
        for lines, suffix in zip(parts, suffixes, strict=True)
    ]
    _refuse_common_constants(found, path)
    return found


def _refuse_common_constants(parts: list[MessageText], path: Path) -> None:
    """Refuse equal constants in two parts: rosidl_parser 4.6 gives both to the first, whose C does not compile then."""
    owners: dict[tuple[str, str, str], str] = {}
    for part in parts:
        for name, kind, value in part.constants:
            owner = owners.setdefault((name, kind, repr(value)), part.name)
            if owner != part.name:
                raise InterfaceError(
                    f"{path}: constant '{name}' is the same in {owner.rpartition('/')[2]} and "
                    f"{part.name.rpartition('/')[2]}, which does not build on ROS 2 Jazzy; give one another name"
                )


def _parse_part(lines: list[tuple[int, str]], name: str, package: str, path: Path) -> MessageText:
    fields: list[Field] = []
    constants: list[tuple[str, str, object]] = []
    for number, raw in lines:
        line = _without_comment(raw).strip()
        if not line:
            continue
        where = f"{path}:{number}"
        if match := _CONSTANT.match(line):
            kind = parse_type(match["type"], package, where)
            value = parse_value(match["value"].strip(), kind, where)
            constants.append((match["name"], kind.base, value))
        elif match := _FIELD.match(line):
            kind = parse_type(match["type"], package, where)
            if any(match["name"] == field.name for field in fields):
                raise InterfaceError(f"{where}: field '{match['name']}' is there twice; give each field its own name")
            default = match["default"]
            fields.append(Field(match["name"], kind, None if default is None else parse_value(default, kind, where)))
        else:
            raise InterfaceError(
                f"{where}: expected 'type name', 'type name default' or 'type NAME=value' "
                f"(field names in lower_snake_case), found {line!r}"
            )
    return MessageText(name, tuple(fields), tuple(constants))


def _without_comment(line: str) -> str:
    quote = ""
    for i, char in enumerate(line):
        if quote:
            quote = "" if char == quote and line[i - 1] != "\\" else quote
        elif char in "\"'" and re.search(r"[=\s\[,]$", line[:i]):
            quote = char
        elif char == "#":
            return line[:i]
    return line


def parse_type(text: str, package: str, where: str) -> FieldType:
    """Parse ``float64[<=3]``, ``string<=10[]``, ``pkg/Name``; a bare name belongs to the same package."""
    match = _TYPE.match(text)
    if match is None:
        raise InterfaceError(f"{where}: expected a type such as float64, string<=10, pkg/Name[3], found {text!r}")
    base = match["base"]
    if base not in PRIMITIVES:
        parts = base.split("/")
        if parts[-1][0].islower():
            raise InterfaceError(f"{where}: unknown type {text!r}; primitives are {', '.join(sorted(PRIMITIVES))}")
        base = f"{package if len(parts) == 1 else parts[0]}/msg/{parts[-1]}"
    bound = int(match["text_bound"] or 0)
    if bound and base not in {"string", "wstring"}:
        raise InterfaceError(f"{where}: only string and wstring take a bound '<={bound}', found {text!r}")
    if not match["array"]:
        return FieldType(base, bound)
    size = int(match["size"] or 0)
    if match["upto"]:
        return FieldType(base, bound, "bounded", size)
    return FieldType(base, bound, "fixed" if match["size"] else "unbounded", size)


def parse_value(text: str, kind: FieldType, where: str) -> object:
    """Parse a default or constant according to its type."""
    if kind.array:
        if not (text.startswith("[") and text.endswith("]")):
            raise InterfaceError(f"{where}: expected a list [a, b, ...] as default, found {text!r}")
        inner = [item.strip() for item in re.findall(r"\"(?:[^\"\\]|\\.)*\"|'(?:[^'\\]|\\.)*'|[^,\s][^,]*", text[1:-1])]
        if kind.array == "fixed" and len(inner) != kind.size:
            raise InterfaceError(f"{where}: expected {kind.size} default values, found {len(inner)}")
        return [parse_value(item, kind.element, where) for item in inner]
    try:
        return _parse_scalar(text, kind.base)
    except (ValueError, SyntaxError):
        raise InterfaceError(f"{where}: expected a value of type {kind.base}, found {text!r}") from None


def _parse_scalar(text: str, base: str) -> object:
    if base in {"string", "wstring"}:
        quoted = len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'"
        return str(ast.literal_eval(text)) if quoted else text
    if base == "bool":
        return (
            {"true": True, "1": True, "false": False, "0": False}[text.lower()] if text.lower() in _BOOLS else int("x")
        )
    if base in {"float32", "float64"}:
        return float(text)
    value = int(text, 0)
    low, high = INTEGER_RANGES["uint8" if base in {"byte", "char"} else base]
    if not low <= value <= high:
        raise ValueError(value)
    return bytes([value]) if base == "byte" else value


_BOOLS = {"true", "false", "0", "1"}
