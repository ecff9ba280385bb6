# SPDX-License-Identifier: Apache-2.0
"""The stubs that mypy reads say what messages are: every field of every message, and what mypy makes of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy", reason="make setup")
registry = pytest.importorskip("embedded_ros.registry", reason="stubs are written where embedded/ stands in for rclpy")

from softgrip_testing.scripts import load_script  # noqa: E402

STUBS = load_script(Path(__file__).resolve().parents[2] / "tools" / "message_stubs.py")
RIGHT = """
from sensor_msgs.msg import JointState
from softgrip_interfaces.srv import SelectProduct

def first(message: JointState) -> float:
    return message.position[0]

def ask() -> str:
    return SelectProduct.Request(product="egg").product
"""
#: what is wrong -> what mypy says of it
WRONG = {
    RIGHT.replace("message.position[0]", "message.positions[0]"): 'has no attribute "positions"',
    RIGHT.replace("message.position[0]", "message.name[0]"): "Incompatible return value type",
    RIGHT.replace('product="egg"', 'product=b"egg"'): 'incompatible type "bytes"',
    RIGHT.replace('product="egg"', 'produce="egg"'): 'Unexpected keyword argument "produce"',
}


@pytest.fixture(scope="module")
def stubs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stubs")
    STUBS.write_stubs(folder, registry.registry().packages())
    return folder


def said_of(text: str, stubs: Path, tmp_path: Path) -> str:
    file = tmp_path / "reader.py"
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(stubs / "cache"), str(file)]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, cwd=tmp_path, env={"MYPYPATH": str(stubs)}
    ).stdout


def test_mypy_knows_the_fields(stubs: Path, tmp_path: Path) -> None:
    assert said_of(RIGHT, stubs, tmp_path).startswith("Success")
    for text, answer in WRONG.items():
        assert answer in said_of(text, stubs, tmp_path)


def test_every_field_is_what_its_stub_says() -> None:
    found = registry.registry()
    seen = 0
    for package in found.packages():
        for name in found.names(package, "msg"):
            kind = found.message(f"{package}/msg/{name}")
            message = kind()
            for field in kind.DEFINITION.text.fields:
                value, stub = getattr(message, field.name), STUBS.field_types(field.type)[0]
                module, own = type(value).__module__, type(value).__name__
                names = {own, f"{module}.{own}", {"ndarray": "numpy.typing.NDArray"}.get(own, "")}
                assert stub.split("[")[0] in names, f"{package}/{name}.{field.name}: {type(value)}, not {stub}"
                seen += 1
    assert seen > 500
