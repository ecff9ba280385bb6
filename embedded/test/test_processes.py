# SPDX-License-Identifier: Apache-2.0
"""The ``ros2`` command and nodes as processes: launch, signals, death of the router's host, frozen peers, two cells."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.ros
Start = Callable[..., Any]


def output(start: Start, *arguments: str, code: int = 0, **environment: str) -> str:
    process = start(*arguments, **environment)
    assert process.popen.wait(30) == code, "\n".join(process.lines)
    process._reader.join(5)
    return "\n".join(process.lines)


def free_port() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def pids(launch: Any) -> list[int]:
    return [int(line.split("[")[-1].rstrip("]")) for line in launch.lines if "process started with pid" in line]


def test_commands_answer_about_a_running_node(start: Start) -> None:
    talker = start("run", "talk_interfaces", "talker", "--ros-args", "-r", "__ns:=/cell", "-r", "count:=out")
    talker.wait_for("talking")
    assert output(start, "topic", "list", "-t").splitlines() == [
        "/cell/out [talk_interfaces/msg/Count]",
        "/parameter_events [rcl_interfaces/msg/ParameterEvent]",
        "/rosout [rcl_interfaces/msg/Log]",
    ]
    assert output(start, "node", "list") == "/cell/talker"
    assert "    /cell/out: talk_interfaces/msg/Count" in output(start, "node", "info", "/cell/talker")
    assert output(start, "topic", "info", "/cell/out").startswith(
        "Type: talk_interfaces/msg/Count\nPublisher count: 1\n"
    )
    echoed = output(start, "topic", "echo", "--once", "/cell/out").splitlines()
    assert (echoed[0][:7], echoed[1:]) == ("value: ", ["word: ''", "---"])
    assert output(start, "topic", "echo", "--once", "--field", "word", "/cell/out").splitlines()[-1] == "---"
    assert output(start, "param", "get", "/cell/talker", "period") == "Double value is: 0.05"
    assert output(start, "param", "set", "/cell/talker", "period", "1").startswith(
        "Setting parameter failed: Wrong parameter"
    )
    assert "period: 0.05" in output(start, "param", "dump", "cell/talker")
    assert "names=['use_sim_time'" in output(
        start, "service", "call", "/cell/talker/list_parameters", "rcl_interfaces/srv/ListParameters", "{depth: 1}"
    )
    assert talker.stop() == 0


def test_commands_fail_with_a_reason(start: Start) -> None:
    assert output(start, "topic", "info", "/nowhere", code=1) == "Unknown topic '/nowhere'"
    assert output(start, "param", "get", "/nobody", "x", code=1) == "Node not found"
    assert "no executable 'x' in package 'talk_interfaces'; it has: asker, breaks" in output(
        start, "run", "talk_interfaces", "x", code=1
    )
    assert "std_msgs/msg has: " in output(start, "topic", "pub", "/t", "std_msgs/msg/Nope", code=1)
    assert "String has no field 'dat'; it has: data" in output(
        start, "topic", "pub", "/t", "std_msgs/msg/String", "{dat: 1}", code=1
    )
    assert "choose from" in output(start, "nope", code=2)


def test_interfaces_of_the_workspace_are_shown(start: Start) -> None:
    text = output(start, "interface", "show", "talk_interfaces/msg/Count")
    assert text.splitlines() == ["int32 value 7   # a default", "string<=5 word", "uint8 LIMIT=3"]
    assert output(start, "pkg", "executables", "talk_interfaces").splitlines()[0] == "talk_interfaces asker"


@pytest.mark.parametrize("ends_by", [signal.SIGINT, signal.SIGTERM])
def test_launch_runs_until_interrupted_and_leaves_nothing(
    start: Start, workspace: Path, tmp_path: Path, ends_by: signal.Signals
) -> None:
    (workspace / "talk_interfaces" / "launch" / "two.launch.yaml").write_text(
        "launch:\n- arg: {name: period, default: '0.5', description: '[s] between messages'}\n"
        "- node: {pkg: talk_interfaces, exec: talker, param: [{name: period, value: $(var period)}]}\n"
        "- node: {pkg: talk_interfaces, exec: listener, output: screen}\n"
    )
    shown = output(start, "launch", "-s", "talk_interfaces", "two.launch.yaml")
    assert "'period':" in shown
    assert "[s] between messages" in shown
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    launch = start("launch", "talk_interfaces", "two.launch.yaml", "period:=0.02", TMPDIR=str(temporary))
    launch.wait_for("[listener-2] heard")
    started = pids(launch)
    assert len(list(temporary.glob("*/*.yaml"))) == 1  # talker's parameters
    assert launch.stop(ends_by) == 0
    assert list(temporary.iterdir()) == []
    assert len(started) == 2
    assert all(gone(pid) for pid in started)
    assert any("process has finished cleanly" in line for line in launch.lines)


def test_a_process_that_cannot_go_on_ends_the_launch(start: Start, workspace: Path) -> None:
    path = workspace / "bad.launch.yaml"
    path.write_text(
        "launch:\n- node: {pkg: talk_interfaces, exec: talker}\n"
        "- node: {pkg: talk_interfaces, exec: breaks, on_exit: shutdown}\n"
    )
    launch = start("launch", str(path))
    assert launch.popen.wait(20) == 1
    launch.wait_for("[breaks-2] cannot go on: no device")
    launch.wait_for("process has died [pid")
    assert all(gone(pid) for pid in pids(launch))


def test_children_end_when_the_launch_is_killed(start: Start, workspace: Path) -> None:
    path = workspace / "one.launch.yaml"
    path.write_text("launch:\n- node: {pkg: talk_interfaces, exec: talker}\n")
    launch = start("launch", str(path))
    launch.wait_for("talking")
    (pid,) = pids(launch)
    launch.stop(signal.SIGKILL)
    end = time.monotonic() + 5
    while not gone(pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert gone(pid)


def test_another_takes_the_router_over(start: Start) -> None:
    port = free_port()
    host = start("run", "talk_interfaces", "talker", EMBEDDED_ROUTER_PORT=port)
    host.wait_for("talking")
    listener = start("run", "talk_interfaces", "listener", EMBEDDED_ROUTER_PORT=port)
    listener.wait_for("heard")
    seen = listener.wait_for("up talker")
    host.stop(signal.SIGKILL)
    listener.wait_for("down talker", 3.0, after=seen)
    again = start("run", "talk_interfaces", "talker", EMBEDDED_ROUTER_PORT=port)
    seen = listener.wait_for("up talker", after=seen)
    listener.wait_for("heard 1", after=seen - 2)
    assert (again.stop(), listener.stop(signal.SIGTERM)) == (0, 0)


@pytest.mark.slow
def test_a_frozen_peer_is_noticed_and_welcome_again(start: Start) -> None:
    port = free_port()
    listener = start("run", "talk_interfaces", "listener", EMBEDDED_ROUTER_PORT=port)
    listener.wait_for("up listener")
    talker = start("run", "talk_interfaces", "talker", EMBEDDED_ROUTER_PORT=port)
    seen = listener.wait_for("up talker")
    talker.popen.send_signal(signal.SIGSTOP)
    seen = listener.wait_for("down talker", 30.0, after=seen)
    talker.popen.send_signal(signal.SIGCONT)
    seen = listener.wait_for("up talker", after=seen)
    listener.wait_for("heard", after=seen)
    assert (talker.stop(), listener.stop()) == (0, 0)


@pytest.mark.slow
def test_a_result_is_had_from_a_server_that_was_frozen_meanwhile(start: Start, tmp_path: Path) -> None:
    port, file = free_port(), tmp_path / "go"
    listener = start("run", "talk_interfaces", "listener", EMBEDDED_ROUTER_PORT=port)
    listener.wait_for("up listener")
    waiter = start("run", "talk_interfaces", "waiter", EMBEDDED_ROUTER_PORT=port)
    seen = listener.wait_for("up waiter")
    asker = start("run", "talk_interfaces", "asker", str(file), EMBEDDED_ROUTER_PORT=port)
    asker.wait_for("asking")
    waiter.popen.send_signal(signal.SIGSTOP)
    listener.wait_for("down waiter", 30.0, after=seen)
    file.touch()
    waiter.popen.send_signal(signal.SIGCONT)
    asker.wait_for("found 7", 60.0)
    assert (asker.popen.wait(20), waiter.stop(), listener.stop()) == (0, 0, 0)


def test_two_cells_do_not_see_each_other(start: Start) -> None:
    one, two = free_port(), free_port()
    talker = start("run", "talk_interfaces", "talker", EMBEDDED_ROUTER_PORT=one)
    talker.wait_for("talking")
    assert output(start, "node", "list", EMBEDDED_ROUTER_PORT=two) == ""
    other_domain = output(start, "node", "list", EMBEDDED_ROUTER_PORT=one, ROS_DOMAIN_ID="84")
    assert (other_domain, output(start, "node", "list", EMBEDDED_ROUTER_PORT=one)) == ("", "/talker")
    assert talker.stop() == 0


def test_a_port_in_use_by_something_else_is_said(start: Start) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        node = start("run", "talk_interfaces", "talker", EMBEDDED_ROUTER_PORT=port)
        assert node.popen.wait(30) != 0
        node._reader.join(5)
        text = "\n".join(node.lines)
    assert f"port {port}" in text
    assert "EMBEDDED_ROUTER_PORT" in text


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["-p", "period"], "expected name:=value"),
        (["--params-file", "{folder}/bad.yaml"], "bad.yaml:3"),
        (["-p", "period:=fast"], "expecting type 'DOUBLE'"),
    ],
)
def test_wrong_arguments_end_a_node_with_a_reason(
    start: Start, workspace: Path, arguments: list[str], expected: str
) -> None:
    (workspace / "bad.yaml").write_text("talker:\n  ros__parameters:\n    period: {a: }\n    b: 2020-01-01\n")
    given = [argument.format(folder=workspace) for argument in arguments]
    assert expected in output(start, "run", "talk_interfaces", "talker", "--ros-args", *given, code=1)
