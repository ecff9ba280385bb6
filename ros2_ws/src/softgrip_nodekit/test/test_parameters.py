# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.parameter import Parameter as RosParameter

from softgrip_nodekit import CellNode, Parameter, ParameterTable, StartupError

TABLE = ParameterTable(
    Parameter("rate", 100.0, "of the loop", "Hz", 10.0, 500.0, changeable=True),
    Parameter("count", 3, "of things", "", 0, 9, changeable=True),
    Parameter("kind", "a", "which", choices=("a", "b"), changeable=True),
    Parameter("angles", [0.1, 0.2], "of joints", "rad", 0.0, 1.5, changeable=True),
    Parameter("port", "/dev/null", "of the device", device=True),
)


@pytest.fixture
def context() -> Iterator[Any]:
    context = rclpy.Context()
    yield context
    context.try_shutdown()


def make_node(context: Any, *arguments: str) -> Any:
    rclpy.init(args=["--ros-args", *arguments], context=context)
    return CellNode("table", context=context)


def test_defaults_have_unit_and_bounds_in_their_descriptor(context: Any) -> None:
    node = make_node(context)
    values = TABLE.declare(node)
    assert values == {"rate": 100.0, "count": 3, "kind": "a", "angles": [0.1, 0.2], "port": "/dev/null"}
    descriptor = node.describe_parameter("rate")
    assert descriptor.description == "of the loop [Hz]"
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (10.0, 500.0)
    assert node.device_paths == ["/dev/null"]
    node.destroy_node()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("rate:=1000.0", "rate"),
        ("rate:=fast", "rate"),
        ("kind:=c", "expected one of"),
        ("angles:=[0.1, 9.0]", "found 9"),
        ("port:=0", "'port' to '0' of type 'INTEGER', expecting type 'STRING'.*; text .* wants quotes: -p port:="),
    ],
)
def test_a_wrong_value_at_start_is_named(context: Any, given: str, said: str) -> None:
    node = make_node(context, "-p", given)
    with pytest.raises(StartupError, match=said):
        TABLE.declare(node)
    node.destroy_node()


def test_a_change_is_validated_then_applied(context: Any) -> None:
    node = make_node(context)
    TABLE.declare(node)
    applied: list[dict[str, Any]] = []
    TABLE.on_change(node, applied.append)
    good, bad, nan, fixed = node.set_parameters(
        [
            RosParameter("rate", value=200.0),
            RosParameter("kind", value="z"),
            RosParameter("angles", value=[math.nan]),
            RosParameter("port", value="/dev/x"),
        ]
    )
    assert good.successful
    assert not bad.successful
    assert "expected one of" in bad.reason
    assert not nan.successful
    assert not fixed.successful
    assert applied == [{"rate": 200.0}]
    node.destroy_node()


def test_two_rows_of_one_name_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="differ"):
        ParameterTable(Parameter("a", 1, "x"), Parameter("a", 2, "y"))


def test_text_that_looks_like_a_number_is_taken_in_quotes(context: Any) -> None:
    node = make_node(context, "-p", "port:='0'")
    assert TABLE.declare(node)["port"] == "0"
    node.destroy_node()


@pytest.mark.parametrize(
    ("given", "expected"),
    [((), 2.0), (("patience_s:=5.0",), 5.0), (("timeout_s:=7.0",), 7.0), (("patience_s:=5.0", "timeout_s:=7.0"), 7.0)],
)
def test_a_value_given_under_a_former_name_counts_unless_the_present_name_is_given(
    context: Any, given: tuple[str, ...], expected: float
) -> None:
    node = make_node(context, *(word for one in given for word in ("-p", one)))
    renamed = ParameterTable(Parameter("timeout_s", 2.0, "of a wait", "s", 0.0, 9.0, former="patience_s"))
    assert renamed.declare(node) == {"timeout_s": expected}
    assert not node.has_parameter("patience_s")
    node.destroy_node()


def test_a_value_out_of_bounds_under_a_former_name_ends_the_node_with_the_present_name(context: Any) -> None:
    node = make_node(context, "-p", "patience_s:=10.0")
    renamed = ParameterTable(Parameter("timeout_s", 2.0, "of a wait", "s", 0.0, 9.0, former="patience_s"))
    with pytest.raises(StartupError, match=r"parameter .timeout_s.: .*10"):
        renamed.declare(node)
    node.destroy_node()


def test_a_value_of_a_former_parameter_of_another_meaning_is_converted(context: Any) -> None:
    node = make_node(context, "-p", "rate_hz:=4.0")
    row = Parameter(
        "period_s", 2.0, "of a wait", "s", 0.0, 9.0, former="rate_hz", convert=lambda rate_hz: 1.0 / rate_hz
    )
    assert ParameterTable(row).declare(node) == {"period_s": 0.25}
    node.destroy_node()


FORMER_NODE = """
import sys
import threading
from softgrip_nodekit import CellNode
from softgrip_nodekit import Parameter, ParameterTable, run

def made():
    node = CellNode("meter")
    table = ParameterTable(Parameter("timeout_s", 2.0, "of a wait", "s", 0.0, 9.0, former="patience_s"))
    print("timeout", table.declare(node)["timeout_s"], flush=True)
    threading.Timer(0.5, node.context.try_shutdown).start()
    return node

sys.exit(run(made))
"""


def test_a_node_starts_with_a_file_that_has_a_former_name(tmp_path: Path) -> None:
    file = tmp_path / "old.yaml"
    file.write_text("meter:\n  ros__parameters:\n    patience_s: 5.0\n")
    command = [sys.executable, "-c", FORMER_NODE, "--ros-args", "--params-file", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "timeout 5.0" in ended.stdout
    assert "parameter 'patience_s' is called 'timeout_s' now" in ended.stderr + ended.stdout
    assert ended.returncode == 0, ended.stderr


NODE = """
import sys
from softgrip_nodekit import CellNode
from softgrip_nodekit import run

def made():
    node = CellNode("meter")
    node.declare_parameter("rate", 1.0)
    return node

sys.exit(run(made))
"""


def test_a_parameter_that_the_node_does_not_have_ends_it_with_its_name() -> None:
    command = [
        sys.executable,
        "-c",
        NODE,
        "--ros-args",
        "-p",
        "rate:=2.0",
        "-p",
        "raet:=3.0",
        "-p",
        "qos_overrides./x:=1",
    ]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "cannot start: unknown parameter 'raet'; meter has lockstep, rate, " in ended.stderr


def test_a_parameter_file_that_is_none_ends_it_with_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("meter:\n  ros__parameters:\n    rate: [1.0,\n")
    command = [sys.executable, "-c", NODE, "--ros-args", "--params-file", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "cannot start: " in ended.stderr
    assert str(file) in ended.stderr
    assert "Traceback" not in ended.stderr
