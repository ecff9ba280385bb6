# SPDX-License-Identifier: Apache-2.0
"""Names, remapping, ``--ros-args`` and parameter files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from embedded_ros import arguments, names, parameter_files
from embedded_ros.errors import ArgumentsError, UnknownArgumentsError


@pytest.mark.parametrize("name", ["chatter", "/a/b", "~", "~/x", "{node}/a", "a_{ns}", "_hidden"])
def test_valid_topic_names(name: str) -> None:
    assert names.topic_problem(name) is None


@pytest.mark.parametrize(
    ("name", "index"),
    [("", 0), ("a/", 1), ("a b", 1), ("a//b", 1), ("1a", 0), ("a/2b", 2), ("~a", 1), ("a~", 1), ("{a", 0)],
)
def test_wrong_topic_names_say_where(name: str, index: int) -> None:
    problem = names.topic_problem(name)
    assert problem is not None
    assert problem[1] == index


@pytest.mark.parametrize(
    ("name", "full"),
    [("x", "/ns/x"), ("/x", "/x"), ("~", "/ns/n"), ("~/x", "/ns/n/x"), ("{node}/x", "/ns/n/x"), ("{ns}/x", "/ns/ns/x")],
)
def test_expansion(name: str, full: str) -> None:
    assert names.expand(name, "n", "/ns") == full


def test_remapping_applies_to_the_expanded_name_and_the_right_node() -> None:
    rules = [names.parse_remap(text) for text in ("other:chatter:=a", "rosservice://chatter:=b", "chatter:=/c")]
    assert names.remap_name("/ns/chatter", "topic", "n", "/ns", rules) == "/c"
    assert names.remap_name("/ns/chatter", "service", "n", "/ns", rules) == "/ns/b"
    assert names.remap_name("/ns/chatter", "topic", "other", "/ns", rules) == "/ns/a"
    assert names.remap_name("/chatter", "topic", "n", "/ns", rules) == "/chatter"


def test_command_line() -> None:
    given = arguments.parse(
        ["prog", "--own", "--ros-args", "-r", "__node:=me", "-r", "a:=b", "-p", "x:=1", "-p", "other:y:=[1.0, 2]",
         "--log-level", "me:=debug", "--log-level", "warn", "--disable-rosout-logs", "--", "rest"]
    )  # fmt: skip
    assert given.rest == ["prog", "--own", "rest"]
    assert given.node_name("you") == "me"
    assert given.parameters_of("/me") == {"x": (1, "-p x:=1")}
    assert given.parameters_of("/other")["y"][0] == [1.0, 2.0]
    assert given.log_levels == {"me": 10, "": 30}
    assert not given.rosout


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["-r", "nothing"], "expected 'from:=to'"),
        (["-r", "a:=b c"], "must not contain characters"),
        (["-r"], "expected a value after it"),
        (["-p", "novalue"], "expected name:=value"),
        (["-p", "x:={a: 1}"], "expected true/false, a number"),
        (["-p", "x:=[1, a]"], "expected true/false, a number"),
        (["-p", "x:=[1"], "not valid YAML"),
        (["--log-level", "loud"], r"expected \[logger:=\]debug"),
        (["--params-file", "/nowhere.yaml"], "cannot be read"),
        (["--log-config-file", "x"], "needs ROS 2"),
    ],
)
def test_wrong_arguments_say_what_was_expected(argv: list[str], expected: str) -> None:
    with pytest.raises(ArgumentsError, match=expected):
        arguments.parse(["prog", "--ros-args", *argv])


def test_unknown_arguments_are_named() -> None:
    with pytest.raises(UnknownArgumentsError, match="--nope"):
        arguments.parse(["--ros-args", "--nope"])


@pytest.mark.parametrize(
    ("pattern", "name", "applies"),
    [
        ("/**", "/a/b/c", True),
        ("/**", "/c", True),
        ("/*", "/c", True),
        ("/*", "/a/c", False),
        ("c", "/c", True),
        ("/a/*", "/a/c", True),
        ("/**/c", "/a/b/c", True),
        ("/**/c", "/c", True),
        ("/a/**/c", "/a/c", True),
        ("/a/**/c", "/b/c", False),
    ],
)
def test_wildcards_of_node_names(pattern: str, name: str, applies: bool) -> None:
    assert arguments.matches(pattern, name) is applies


def test_parameter_file(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**:\n  ros__parameters: {a: 1, nested: {b: 1e3, c: [true, false]}}\n"
        "ns:\n  node:\n    ros__parameters: {a: 2}\n/**:\n  ros__parameters: {late: x}\n"
    )
    given = arguments.parse(["--ros-args", "--params-file", str(path), "-p", "late:=y"])
    found: dict[str, Any] = {name: value for name, (value, _) in given.parameters_of("/ns/node").items()}
    assert found == {"a": 2, "nested.b": 1000.0, "nested.c": [True, False], "late": "y"}
    assert given.parameters_of("/node")["a"][0] == 1


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("node:\n  ros__parameters:\n    a: {b: 1}\n    a.b: 2\n", 4, "'a.b' is there twice"),
        ("node:\n  ros__parameters:\n    a: 2020-01-01\n", 3, "a: expected true/false"),
        ("node:\n  parameters:\n    a: 1\n", 3, "expected 'node_name"),
        ("ros__parameters:\n  a: 1\n", 2, "expected a node name"),
        ("node:\n  ros__parameters: [1]\n", 2, "expected 'name: value' pairs"),
        ("node:\n  ros__parameters:\n    a: [1\n", 4, "not valid YAML"),
        ("- node\n", 1, "expected 'node_name"),
    ],
)
def test_a_wrong_parameter_file_names_file_and_line(tmp_path: Path, text: str, line: int, expected: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ArgumentsError, match=expected) as error:
        parameter_files.load_parameter_file(path)
    assert str(error.value).startswith(f"{path}:{line}")
