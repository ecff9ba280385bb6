# SPDX-License-Identifier: Apache-2.0
"""Write .pyi stubs of all interface packages, so that mypy knows the fields of every message: part of `make lint`.

A field is what rclpy gives back when it is read, and what it takes when it is set: numbers in a sequence are
array.array, in an array of fixed length numpy's; any sequence may be given.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from embedded_ros.interface_text import Field, FieldType, MessageText
from embedded_ros.registry import registry

#: part of a service or an action -> its suffix in the registry's names is the same
PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
#: primitive of ROS -> Python's; what is not here is a whole number
PRIMITIVES = {
    "byte": "bytes", "char": "int", "bool": "bool", "float32": "float", "float64": "float", "string": "str",
    "wstring": "str",
}  # fmt: skip
HEAD = "import array\nimport collections.abc\nimport typing\n\nimport numpy.typing\n"


def element(kind: FieldType) -> str:
    """Return Python's type of one element of a field."""
    if not kind.primitive:
        return kind.base.replace("/", ".")
    return PRIMITIVES.get(kind.base, "int")


def field_types(kind: FieldType) -> tuple[str, str]:
    """Return what a field is when it is read, and what it may be set to."""
    one = element(kind)
    if not kind.array:
        return one, one
    if not kind.primitive or kind.base in {"string", "wstring", "bool", "byte"}:
        return f"list[{one}]", f"collections.abc.Collection[{one}]"
    given = f"collections.abc.Sequence[{one}] | numpy.typing.NDArray[typing.Any] | array.array[{one}]"
    return ("numpy.typing.NDArray[typing.Any]" if kind.array == "fixed" else f"array.array[{one}]"), given


def field_lines(field: Field) -> Iterator[str]:
    """Yield a field as a property of its class."""
    got, given = field_types(field.type)
    yield "    @property"
    yield f"    def {field.name}(self) -> {got}: ..."
    yield f"    @{field.name}.setter"
    yield f"    def {field.name}(self, value: {given}) -> None: ..."


def class_lines(text: MessageText, name: str) -> Iterator[str]:
    """Yield the class of a message, or of a part of a service or an action."""
    yield f"class {name}:"
    for constant, _, value in text.constants:
        yield f"    {constant}: typing.ClassVar[{type(value).__name__}]"
    for field in text.fields:
        yield from field_lines(field)
    fields = "".join(f", {field.name}: {field_types(field.type)[1]} = ..." for field in text.fields)
    yield f"    def __init__(self{', *' if fields else ''}{fields}) -> None: ..."
    yield "    @classmethod"
    yield "    def get_fields_and_field_types(cls) -> dict[str, str]: ..."
    yield "    DEFINITION: typing.ClassVar[typing.Any]"


def texts_of(full_name: str) -> list[tuple[str, MessageText]]:
    """Return the parts of an interface with their texts; a message has one, without a name."""
    kind = full_name.split("/")[1]
    if kind == "msg":
        return [("", registry().message(full_name).DEFINITION.text)]
    made = registry().interface(full_name)
    return [(part, getattr(made, part).DEFINITION.text) for part in PARTS[kind]]


def module_of(package: str, kind: str) -> str:
    """Return the stub of ``package.kind``."""
    lines: list[str] = []
    used: set[str] = set()
    for name in registry().names(package, kind):
        texts = texts_of(f"{package}/{kind}/{name}")
        used |= {field.type.base for _, text in texts for field in text.fields if not field.type.primitive}
        if kind == "msg":
            lines += class_lines(texts[0][1], name)
            continue
        lines.append(f"class {name}:")
        for part, text in texts:
            lines += [f"    {line}" for line in class_lines(text, part)]
        lines.append("    DEFINITION: typing.ClassVar[typing.Any]")
    imports = sorted({f"import {'.'.join(base.split('/')[:2])}" for base in used})
    return "\n".join((HEAD, *imports, *lines)) + "\n"


def write_stubs(folder: Path, packages: Iterable[str]) -> None:
    """Write ``package/kind.pyi`` of packages into a folder; a file that would not change is left alone."""
    for package in packages:
        files = {"__init__.pyi": ""}
        for kind in ("msg", "srv", "action"):
            if registry().names(package, kind):
                files[f"{kind}.pyi"] = module_of(package, kind)
        (folder / package).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            path = folder / package / name
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where a folder for each interface package is made")
    write_stubs(parser.parse_args().folder, registry().packages())
    return 0


if __name__ == "__main__":
    sys.exit(main())
