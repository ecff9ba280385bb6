# SPDX-License-Identifier: Apache-2.0
"""YAML launch files: what they come to, and what is wrong with wrong ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from embedded_ros import workspace as workspaces
from embedded_ros.errors import LaunchError
from embedded_ros.launch_description import Description
from embedded_ros.launch_file import LaunchReader
from embedded_ros.launch_run import RotatingLog
from embedded_ros.substitutions import Scope, substitute


@pytest.fixture(autouse=True)
def in_workspace(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("EMBEDDED_WORKSPACE", str(workspace))
    workspaces.packages.cache_clear()
    yield
    workspaces.packages.cache_clear()


def read(tmp_path: Path, text: str, **given: str) -> Description:
    path = tmp_path / "x.launch.yaml"
    path.write_text(text)
    return LaunchReader(given).read(path)


NODE = "{pkg: talk_interfaces, exec: talker"


def test_a_node_with_everything(tmp_path: Path) -> None:
    description = read(
        tmp_path,
        """
launch:
- arg: {name: period, default: "0.5", description: "[s]"}
- set_use_sim_time: {value: true}
- group:
  - push_ros_namespace: {namespace: cell}
  - node:
      pkg: talk_interfaces
      exec: talker
      name: t
      namespace: left
      args: "one 'two three'"
      ros_args: "--log-level debug"
      param:
      - {name: period, value: $(var period)}
      - {name: group, param: [{name: text, value: "5", type: str}, {name: list, value: [1, 2]}]}
      remap: [{from: a, to: b}]
      env: [{name: KEY, value: "v"}]
      output: screen
      on_exit: shutdown
- node: {pkg: talk_interfaces, exec: listener}
""",
        period="0.25",
    )
    talker, listener = description.processes
    text = " ".join(talker.command)
    assert talker.command[5:7] == ["one", "two three"]
    assert "-r __node:=t -r __ns:=/cell/left" in text
    assert text.endswith("-r a:=b")
    assert "-p use_sim_time:=true" in text
    files = [talker.command[i + 1] for i, part in enumerate(talker.command) if part == "--params-file"]
    values = [yaml.safe_load(Path(file).read_text()) for file in files]
    assert values == [
        {"/cell/left/t": {"ros__parameters": {"period": 0.25}}},
        {"/cell/left/t": {"ros__parameters": {"group": {"text": "5", "list": [1, 2]}}}},
    ]
    assert (talker.label, talker.environment["KEY"], talker.output, talker.on_exit_shutdown) == (
        "t-1",
        "v",
        "screen",
        True,
    )
    assert listener.label == "listener-2"
    assert "__ns" not in " ".join(listener.command)


def test_conditions_includes_let_and_environment(tmp_path: Path) -> None:
    (tmp_path / "inner.launch.yaml").write_text(
        f"launch:\n- arg: {{name: who}}\n- node: {NODE}, args: $(var who) $(env WHERE none)}}\n"
    )
    description = read(
        tmp_path,
        f"""
launch:
- let: {{name: flag, value: "true"}}
- set_env: {{name: WHERE, value: here}}
- include: {{file: $(dirname)/inner.launch.yaml, arg: [{{name: who, value: you}}]}}
- node: {NODE}, if: $(not $(var flag))}}
- node: {NODE}, unless: "$(equals a b)"}}
""",
    )
    included, node = description.processes
    assert included.command[5:7] == ["you", "here"]
    assert node.command[3] == "talker"


def test_what_an_included_file_sets_stays_and_its_arguments_give_way_to_given_ones(tmp_path: Path) -> None:
    """As upstream: an include opens no scope (ros2/launch pull request 123)."""
    (tmp_path / "inner.launch.yaml").write_text(
        "launch:\n- arg: {name: who, default: inner}\n- arg: {name: other, default: inner}\n"
        "- let: {name: x, value: set}\n"
    )
    description = read(
        tmp_path,
        f"""
launch:
- include: {{file: $(dirname)/inner.launch.yaml}}
- arg: {{name: who, default: outer}}
- arg: {{name: other, default: outer}}
- node: {NODE}, args: $(var who) $(var other) $(var x) $(dirname)}}
""",
        who="given",
    )
    assert description.processes[0].command[5:9] == ["given", "inner", "set", str(tmp_path)]


def test_a_command_gives_what_it_prints(tmp_path: Path) -> None:
    description = read(
        tmp_path,
        f"""
launch:
- let: {{name: word, value: two words}}
- set_env: {{name: WHERE, value: here}}
- let: {{name: said, value: '$(command ''printf "<%s>" "$(var word)"'')'}}
- let: {{name: env, value: '$(command ''sh -c "printf $WHERE"'')'}}
- let: {{name: path, value: $(exec-in-pkg talker talk_interfaces)}}
- node: {NODE}, args: '"$(var said)" $(var env) "$(var path)"'}}
""",
    )
    said, where, path = description.processes[0].command[5:8]
    assert (said, where) == ("<two words>", "here")
    assert path.split()[1:4] == ["-m", "embedded_ros.child", "talker"]


def test_a_group_that_is_not_scoped_keeps_what_it_sets(tmp_path: Path) -> None:
    description = read(
        tmp_path,
        f"""
launch:
- group:
    scoped: false
    children: [{{let: {{name: x, value: kept}}}}]
- group:
    children: [{{let: {{name: x, value: dropped}}}}]
- node: {NODE}, args: $(var x)}}
""",
    )
    assert description.processes[0].command[5] == "kept"


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("launch:\n- nod: {}\n", 2, "unknown action 'nod'"),
        (f"launch:\n- node: {NODE}, nmae: x}}\n", 2, "unknown attribute.* nmae"),
        ("launch:\n- node: {pkg: talk_interfaces}\n", 2, "exec missing"),
        ("launch:\n- node: {pkg: nope, exec: x}\n", 2, "package 'nope' not found"),
        ("launch:\n- node: {pkg: talk_interfaces, exec: x}\n", 2, "no executable 'x'.*talker"),
        (
            "launch:\n- set_env: {name: a, value: hi}\n- set_env: {name: b, value: $(var gone)}\n",
            3,
            "no such launch argument",
        ),
        ("launch:\n- arg: {name: must}\n", 2, "'must' is required"),
        ("launch:\n- arg: {name: a, default: x, choice: [{value: y}]}\n", 2, "expected y, found 'x'"),
        (f"launch:\n- node: {NODE}, if: perhaps}}\n", 2, "expected true or false"),
        (f"launch:\n- node: {NODE}, output: loud}}\n", 2, "expected log, screen"),
        (f"launch:\n- node: {NODE}, param: [{{from: /no.yaml}}]}}\n", 2, "found nothing at /no.yaml"),
        ("launch:\n- node_container: {}\n", 2, "needs ROS 2"),
        ("launch:\n- set_env: {name: a, value: $(nope x)}\n", 2, "unknown substitution"),
        ("launch:\n- let: {name: a, value: \"$(equals '' x)\"}\n", 2, r"text \[\] on ROS 2 Jazzy.*nothing"),
        ("launch:\n- set_env: {name: a, value: $(eval 1)}\n", 2, "needs ROS 2"),
        ("launch:\n- set_env: {name: a, value: $(command /no/such)}\n", 2, "cannot be run"),
        ("launch:\n- set_env: {name: a, value: $(command 'sh -c \"echo why >&2; exit 3\"')}\n", 2, "why"),
        ("launch:\n- set_env: {name: a, value: $(command false)}\n", 2, "exit code 1: false"),
        ("launch:\n- set_env: {name: a, value: $(exec-in-pkg nope talk_interfaces)}\n", 2, "no executable 'nope'"),
        ("launch:\n- executable: {cmd: id}\n", 2, "needs ROS 2"),
        ("launch:\n- set_env: {name: a, value: $(var x}\n", 2, "closing"),
        ("launch: {}\n", 1, "expected a list of actions"),
        ("lunch: []\n", 1, "top-level key 'launch'"),
        ("launch: [\n", 2, "not valid YAML"),
        ("launch:\n- set_env: {name: a, name: b}\n", 2, "there twice"),
    ],
)
def test_a_wrong_launch_file_names_file_and_line(tmp_path: Path, text: str, line: int, expected: str) -> None:
    with pytest.raises(LaunchError, match=expected) as error:
        read(tmp_path, text)
    assert str(error.value).startswith(f"{tmp_path / 'x.launch.yaml'}:{line}")


def test_an_error_in_an_included_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "inner.launch.yaml").write_text("launch:\n- set_env: {name: a, value: b}\n- bad: {}\n")
    with pytest.raises(LaunchError, match=r"inner.launch.yaml:3: unknown action") as error:
        read(tmp_path, "launch:\n- include: {file: $(dirname)/inner.launch.yaml}\n")
    assert str(error.value).count(".yaml:") == 1


def test_an_argument_nobody_declared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LaunchError, match=r"typo not declared; declared are: a"):
        read(tmp_path, "launch:\n- arg: {name: a, default: b}\n", typo="x")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a $(var x) b", "a 1 b"),
        ("$(var none default)", "default"),
        ("$(if true yes no)", "yes"),
        ("$(and true $(not false))", "true"),
        ("$(or 0 no)", "false"),
        (r"\$(var x)", "$(var x)"),
        ("$(env NOT_SET_ANYWHERE here)", "here"),
        ("$(find-pkg-share talk_interfaces)/x", "{share}/x"),
        ("no substitution ) here", "no substitution ) here"),
    ],
)
def test_substitutions(tmp_path: Path, workspace: Path, text: str, value: str) -> None:
    scope = Scope(tmp_path / "f")
    scope.variables["x"] = "1"
    assert substitute(text, scope) == value.replace("{share}", str(workspace / "talk_interfaces"))


def test_a_log_that_grows_long_is_put_aside_and_the_oldest_is_dropped(tmp_path: Path) -> None:
    log = RotatingLog(tmp_path / "launch.log", max_bytes=100, kept=2)
    for number in range(100):
        log.write_line(f"line {number:04}")
    log.close()
    names = sorted(path.name for path in tmp_path.glob("launch.log*"))
    assert names == ["launch.log", "launch.log.1", "launch.log.2"]
    text = "".join((tmp_path / name).read_text() for name in reversed(names))
    lines = text.split("\n")[:-1]
    assert lines == [f"line {number:04}" for number in range(100 - len(lines), 100)]
    assert all((tmp_path / name).stat().st_size <= 110 for name in names)
