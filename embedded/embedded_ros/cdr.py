# SPDX-License-Identifier: Apache-2.0
"""Generates, per message class, the functions that write and read its CDR (OMG XCDR1, little-endian).

The generated source is straight-line: nested messages are inlined and neighbouring fixed-size fields share one
``struct`` call, whose padding depends only on the offset modulo 8. Checks mirror what rosidl's C code asserts, and
raise instead of aborting.
"""

from __future__ import annotations

import array
import struct
from typing import TYPE_CHECKING, Any

from embedded_ros import arrays, limits
from embedded_ros.errors import CdrError
from embedded_ros.interface_text import FieldType

if TYPE_CHECKING:
    from collections.abc import Callable

    from embedded_ros.messages import Message

HEADER = b"\x00\x01\x00\x00"
MEMO_BYTES = 1 << 12
LAZY_BYTES = 1 << 16  # longer arrays stay a view of the packet until somebody asks for them

FORMATS = {
    "bool": "?", "byte": "c", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
ARRAY_CODES = {base: code for base, code in FORMATS.items() if base not in {"bool", "byte"}}
_SIZES = {code: struct.calcsize("<" + code) for code in FORMATS.values()}
_PYTHON_TYPES = {"bool": "bool", "byte": "bytes", "float32": "float", "float64": "float"}
_PADDING = tuple(bytes(n) for n in range(8))


class _Packer:
    """Eight precompiled layouts of one run of fixed-size fields, one per start offset modulo 8."""

    def __init__(self, codes: str) -> None:
        self.layouts = [struct.Struct(_layout(codes, start)) for start in range(8)]


def _layout(codes: str, start: int) -> str:
    text, offset = "<", start
    for code in codes:
        padding = -offset % _SIZES[code]
        text += "x" * padding + code
        offset += padding + _SIZES[code]
    return text


class _Source:
    """Collects generated lines, the names they use, and the run of fixed-size fields not yet written."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[str, Any] = {"array": array.array, "arrays": arrays, "HEADER": HEADER, "PADDING": _PADDING}
        self.depth = 1
        self.run: list[tuple[str, str]] = []
        self._count = 0

    def emit(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def fresh(self, prefix: str) -> str:
        self._count += 1
        return f"{prefix}{self._count}"

    def share(self, prefix: str, value: object) -> str:
        name = self.fresh(prefix)
        self.names[name] = value
        return name

    def compile(self, head: str, name: str) -> Callable[..., Any]:
        source = "\n".join([head, *self.lines])
        exec(compile(source, f"<cdr {name}>", "exec"), self.names)  # noqa: S102  our own generated text, no input in it
        function: Callable[..., Any] = self.names["generated"]
        return function


class _Writer(_Source):
    def message(self, kind: type[Message], value: str) -> None:
        fields = kind.DEFINITION.text.fields
        if not fields:
            self.run.append(("B", "0"))
        for field in fields:
            self.field(field.type, f"{value}._{field.name}", kind)

    def field(self, kind: FieldType, value: str, owner: type[Message]) -> None:
        if kind.array:
            self.sequence(kind, value, owner)
        else:
            self.element(kind, value, owner)

    def element(self, kind: FieldType, value: str, owner: type[Message]) -> None:
        local = self.fresh("v")
        self.emit(f"{local} = {value}")
        if kind.text:
            self.text(kind, local)
        elif kind.primitive:
            expected = _PYTHON_TYPES.get(kind.base, "int")
            self.emit(f"if not isinstance({local}, {expected}): raise TypeError")
            self.run.append((FORMATS[kind.base], local))
        else:
            nested = owner.DEFINITION.nested(kind.base)
            self.emit(f"if not isinstance({local}, {self.share('C', nested)}): raise TypeError")
            self.message(nested, local)

    def text(self, kind: FieldType, local: str) -> None:
        if kind.text_bound:
            self.emit(f"if len({local}) > {kind.text_bound}: raise ValueError")
        if kind.base == "string":
            self.emit(f"{local} = {local}.encode()")
            self.run.append(("I", f"len({local}) + 1"))
            self.flush()
            self.emit(f"b += {local}; b += b'\\0'")
        else:
            self.emit(f"{local} = {local}.encode('utf-16-le')")
            self.run.append(("I", f"len({local}) // 2"))
            self.flush()
            self.emit(f"b += arrays.utf16_to_wide({local})")

    def sequence(self, kind: FieldType, value: str, owner: type[Message]) -> None:
        local = self.fresh("s")
        self.emit(f"{local} = {value}")
        if kind.array == "fixed":
            self.emit(f"if len({local}) != {kind.size}: raise ValueError")
        else:
            if kind.array == "bounded":
                self.emit(f"if len({local}) > {kind.size}: raise ValueError")
            self.run.append(("I", f"len({local})"))
        if kind.base in ARRAY_CODES:
            self.numbers(kind, local, value)
        elif kind.base == "byte":
            self.flush()
            self.emit(f"for e in {local}:")
            self.emit("    if not isinstance(e, bytes) or len(e) != 1: raise TypeError")
            self.emit("    b += e")
        elif kind.base == "string" and not kind.text_bound:
            self.strings(kind, local, owner)
        else:
            self.items(kind, local, owner)

    def items(self, kind: FieldType, local: str, owner: type[Message]) -> None:
        self.flush()
        item = self.fresh("e")
        self.emit(f"if isinstance({local}, (str, bytes)): raise TypeError")
        self.emit(f"for {item} in {local}:")
        self.depth += 1
        self.element(kind.element, item, owner)
        self.flush()
        self.depth -= 1

    def strings(self, kind: FieldType, local: str, owner: type[Message]) -> None:
        """Names of joints and the like are the same in every message: what they became last time is kept."""
        self.flush()
        if kind.array == "fixed":
            self.emit("b += PADDING[-(len(b) + 4) & 3]")
        memo = self.share("M", [(b"", None)])
        self.emit(f"block, known = {memo}[0]")
        self.emit(f"if {local}.__class__ is list and {local} == known: b += block")
        self.emit("else:")
        self.depth += 1
        self.emit("begin = len(b)")
        self.items(kind, local, owner)
        self.emit(f"if {local}.__class__ is list and len(b) - begin <= {MEMO_BYTES}:")
        self.emit(f"    {memo}[0] = bytes(b[begin:]), {local}.copy()")
        self.depth -= 1

    def numbers(self, kind: FieldType, local: str, value: str) -> None:
        code = ARRAY_CODES[kind.base]
        self.flush()
        if kind.array == "fixed":
            self.emit(f"if {local}.dtype != arrays.dtype('<{code}'): raise TypeError")
            data = f"{local}.tobytes()"
        else:
            # What was received as a view of the packet becomes an array when it is asked for by its public name.
            self.emit(f"if {local}.__class__ is memoryview: {local} = {value.replace('._', '.')}")
            self.emit(f"if {local}.typecode != {code!r}: raise TypeError")
            data = local
        size = _SIZES[code]
        if size > 1:
            self.emit(f"if len({local}): b += PADDING[-(len(b) + 4) & {size - 1}]")
        self.emit(f"b += {data}")

    def flush(self) -> None:
        if self.run:
            codes = "".join(code for code, _ in self.run)
            packer = self.share("P", tuple(layout.pack for layout in _Packer(codes).layouts))
            self.emit(f"b += {packer}[(len(b) + 4) & 7]({', '.join(value for _, value in self.run)})")
            self.run.clear()


class _Reader(_Source):
    """Reads with ``o``, the offset in ``d``; a run is read when something after it needs the offset."""

    def message(self, kind: type[Message], target: str) -> None:
        """Emit the reading of a message whose fresh object is bound to ``target``."""
        self.emit(f"{target} = new({self.share('C', kind)})")
        fields = kind.DEFINITION.text.fields
        if not fields:
            self.run.append(("B", "_"))
        for field in fields:
            place = f"{target}._{field.name}"
            if field.type.array:
                self.sequence(field.type, place, kind)
            else:
                self.element(field.type, place, kind)

    def element(self, kind: FieldType, place: str, owner: type[Message]) -> None:
        if kind.text:
            self.text(kind, place)
        elif kind.primitive:
            self.run.append((FORMATS[kind.base], place))
        else:
            local = self.fresh("m")
            self.message(owner.DEFINITION.nested(kind.base), local)
            self.emit(f"{place} = {local}")

    def text(self, kind: FieldType, place: str) -> None:
        self.run.append(("I", "n"))
        self.flush()
        if kind.base == "string":
            self.emit("if n > size - o: raise ValueError")
            self.emit(f"{place} = d[o:o + n - 1].decode() if n else ''; o += n")
        else:
            self.emit("if 4 * n > size - o: raise ValueError")
            self.emit(f"{place} = arrays.wide_to_utf16(d, n, o).decode('utf-16-le'); o += 4 * n")

    def sequence(self, kind: FieldType, place: str, owner: type[Message]) -> None:
        length = str(kind.size)
        if kind.array != "fixed":
            length = self.fresh("n")
            self.run.append(("I", length))
        self.flush()
        if kind.array == "bounded":
            self.emit(f"if {length} > {kind.size}: raise ValueError")
        if kind.base in ARRAY_CODES:
            self.numbers(kind, place, length)
            return
        items, item = self.fresh("l"), self.fresh("i")
        self.emit(f"if {length} > size - o: raise ValueError")
        if kind.array != "fixed":
            self.emit(f"parts -= {_parts(kind.element, owner)} * {length}")
            self.emit("if parts < 0: raise TooManyParts")
        memo = ""
        if kind.base == "string":  # as in _Writer.strings
            if kind.array == "fixed":
                self.emit("o += -(o + 4) & 3")
            memo = self.share("M", [(b"", [])])
            self.emit(f"block, known = {memo}[0]")
            self.emit(f"if {length} == len(known) and d.startswith(block, o): {items} = known.copy(); o += len(block)")
            self.emit("else:")
            self.depth += 1
            self.emit("begin = o")
        self.emit(f"{items} = []")
        self.emit(f"for _ in range({length}):")
        self.depth += 1
        self.element(kind.element, item, owner)
        self.flush()
        self.emit(f"{items}.append({item})")
        self.depth -= 1
        if memo:
            self.emit(f"if o - begin <= {MEMO_BYTES}: {memo}[0] = d[begin:o], {items}.copy()")
            self.depth -= 1
        self.emit(f"{place} = {items}")

    def numbers(self, kind: FieldType, place: str, length: str) -> None:
        code = ARRAY_CODES[kind.base]
        size = _SIZES[code]
        if size > 1:
            self.emit(f"if {length}: o += -(o + 4) & {size - 1}")
        self.emit(f"if {length} * {size} > size - o: raise ValueError")
        if kind.array == "fixed":
            self.emit(f"{place} = arrays.read_array(d, {code!r}, {length}, o)")
        else:
            part = f"[o:o + {length} * {size}]"
            self.emit(f"{place} = array({code!r}, d{part}) if {length} < {LAZY_BYTES // size} else memoryview(d){part}")
        self.emit(f"o += {length} * {size}")

    def flush(self) -> None:
        if self.run:
            layouts = _Packer("".join(code for code, _ in self.run)).layouts
            table = self.share("U", tuple((layout.unpack_from, layout.size) for layout in layouts))
            self.emit(f"u, k = {table}[(o + 4) & 7]")
            self.emit(f"{', '.join(value for _, value in self.run)}, = u(d, o); o += k")
            self.run.clear()


class _TooManyPartsError(ValueError):
    def __init__(self) -> None:
        super().__init__(f"more than {limits.max_parts()} parts; {limits.MAX_PARTS_VARIABLE} says how many may be")


def _parts(kind: FieldType, owner: type[Message]) -> int:
    """Return how many objects, texts and lists an element consists of, without those in lists of its own."""
    if kind.text or kind.primitive:
        return 1
    nested = owner.DEFINITION.nested(kind.base)
    fields = nested.DEFINITION.text.fields
    return 1 + sum(1 if field.type.array else _parts(field.type, nested) for field in fields if _is_made(field.type))


def _is_made(kind: FieldType) -> bool:
    return bool(kind.array or kind.text or not kind.primitive)


def make_serializer(kind: type[Message]) -> Callable[[Any], bytearray]:
    """Return ``f(message) -> bytearray`` with the encapsulation header for a message class."""
    writer = _Writer()
    writer.emit("b = bytearray(HEADER)")
    writer.message(kind, "m")
    writer.flush()
    writer.emit("return b")
    return writer.compile("def generated(m):", kind.__name__)


def make_deserializer(kind: type[Message]) -> Callable[[bytes], Any]:
    """Return ``f(bytes) -> message``; it raises CdrError when the bytes cannot be a message of the class."""
    reader = _Reader()
    reader.names["new"] = object.__new__
    reader.names["TooManyParts"] = _TooManyPartsError
    reader.names["PARTS"] = limits.max_parts()
    reader.emit("o = 4; size = len(d); parts = PARTS")
    reader.message(kind, "m")
    reader.flush()
    reader.emit("return m")
    read = reader.compile("def generated(d):", kind.__name__)

    def deserialize(data: bytes) -> Any:
        if data[:2] != b"\x00\x01":
            raise CdrError(f"{kind.__name__}: expected little-endian CDR (header 00 01), found {data[:4].hex(' ')!r}")
        try:
            return read(data)
        except (struct.error, ValueError, UnicodeDecodeError) as error:
            raise CdrError(
                f"{kind.__name__}: {len(data)} bytes are no such message ({error or 'too short'})"
            ) from error

    return deserialize
