# SPDX-License-Identifier: Apache-2.0
"""Scan, IDs and self-test run by a page: who may, when the bus is free, what is shown of what they say."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_driver.commands import setup
from softgrip_panel.access.record import ActRecord
from softgrip_panel.errors import PanelError
from softgrip_panel.model import bench_commands
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.bench import BenchView, TerminalStep, id_step, terminal_steps
from softgrip_panel.model.bench_commands import MAX_LINES, BenchCommands
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import PanelState

IDA, ADA = Person("s1", "Ida", Role.ENGINEER), Person("s2", "Ada", Role.OPERATE)
FREE = BenchView("unconfigured", "/dev/servos", 1_000_000, ("index",), (1,))
SCAN = next(one for one in terminal_steps(FREE) if one.key == "scan")
#: Stands in for `ros2`.
ROS2 = """#!/bin/sh
echo "$@"
case "$3" in
scan) echo "ID 1" >&2; printf "no end of line" ;;
selftest) exit 1 ;;
setup) sleep 60 ;;
deaf) trap "" INT; echo "deaf now"; sleep 60 ;;
esac
"""


class NoCell:
    async def call(self, act: Act, who: str) -> ActResult:
        raise AssertionError

    def cancel(self, act_name: str) -> None:
        raise AssertionError


@pytest.fixture(autouse=True)
def _stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "ros2"
    program.write_text(ROS2)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")


@pytest.fixture
def work(state: PanelState, tmp_path: Path) -> BenchCommands:
    state.bench = FREE
    return BenchCommands(ActDesk(state, NoCell(), ActRecord(tmp_path / "acts", state.now_s)), lambda: state.bench)


async def ended(work: BenchCommands) -> None:
    for _ in range(500):
        if not work.output.is_running:
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f"expected the end of {work.output.command}")


def test_a_step_is_run_as_at_a_terminal_and_what_it_says_is_kept(
    work: BenchCommands, state: PanelState, tmp_path: Path
) -> None:
    async def run() -> None:
        assert work.begin_step(IDA, SCAN).success
        assert work.output.is_running
        refused = work.begin_step(IDA, SCAN)
        assert (refused.success, "expected no other command" in refused.message) == (False, True)
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(run())
    assert work.output.lines == ("run softgrip_driver scan --port /dev/servos", "ID 1", "no end of line")
    assert (work.output.key, work.output.code) == ("scan", 0)
    recorded = [json.loads(line) for line in (tmp_path / "acts").read_text().splitlines()]
    assert [(one["act"], one["success"], one["message"]) for one in recorded if one["success"]] == [
        ("bench", True, "begun"), ("bench", True, "exit code 0"),
    ]  # fmt: skip
    assert {one["subject"] for one in recorded} == {"ros2 run softgrip_driver scan --port /dev/servos"}


def test_a_step_that_fails_says_with_which_code(work: BenchCommands, state: PanelState) -> None:
    async def run() -> None:
        work.begin_step(IDA, next(one for one in terminal_steps(FREE) if one.key == "selftest"))
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(run())
    assert work.output.code == 1


@pytest.mark.parametrize("phase", ["inactive", "active"])
def test_nothing_is_run_while_the_driver_has_the_bus(work: BenchCommands, state: PanelState, phase: str) -> None:
    state.control.take_control(IDA)
    state.bench = replace(FREE, phase=phase)
    result = work.begin_step(IDA, SCAN)
    assert (result.success, result.message) == (False, "The driver has the bus. Free it first.")
    assert work.output.key == ""


def test_only_an_engineer_with_control_runs_a_step(work: BenchCommands, state: PanelState) -> None:
    assert not work.begin_step(IDA, SCAN).success  # nobody has control
    state.control.take_control(ADA)
    assert "expected the role engineer" in work.begin_step(ADA, SCAN).message
    assert "Ada has it" in work.begin_step(IDA, SCAN).message
    assert work.output.key == ""


@pytest.mark.parametrize("key", ["wizard", "calibrate"])
def test_what_asks_or_moves_is_for_a_terminal(work: BenchCommands, state: PanelState, key: str) -> None:
    state.control.take_control(IDA)
    step = next(one for one in terminal_steps(FREE) if one.key == key)
    assert "found one for a terminal" in work.begin_step(IDA, step).message


def test_a_step_is_ended_with_all_that_it_started(work: BenchCommands, state: PanelState) -> None:
    async def run() -> None:
        work.begin_step(IDA, id_step(FREE, 1, 57_600, 3))
        while not work.output.lines:
            await asyncio.sleep(0.02)
        assert work.stop(ADA).success  # ending is everybody's who operates
        await ended(work)
        assert not work.stop(ADA).success

    state.control.take_control(IDA)
    asyncio.run(asyncio.wait_for(run(), 20.0))
    assert work.output.code != 0


def test_a_step_that_does_not_end_when_it_is_asked_to_is_killed(
    work: BenchCommands, state: PanelState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_commands, "END_S", 0.3)
    deaf = TerminalStep("scan", ("ros2", "run", "softgrip_driver", "deaf"), is_run_here=True)

    async def run() -> None:
        work.begin_step(IDA, deaf)
        while "deaf now" not in work.output.lines:
            await asyncio.sleep(0.02)
        assert work.stop(ADA).success
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(asyncio.wait_for(run(), 20.0))
    assert work.output.code == -signal.SIGKILL


def test_a_step_can_be_ended_before_it_has_begun(work: BenchCommands, state: PanelState) -> None:
    async def run() -> None:
        work.begin_step(IDA, id_step(FREE, 1, 57_600, 3))
        assert work.stop(ADA).success
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(asyncio.wait_for(run(), 20.0))
    assert work.output.code != 0


def test_a_step_that_takes_too_long_is_ended(
    work: BenchCommands, state: PanelState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_commands, "LIMIT_S", 0.3)
    monkeypatch.setattr(bench_commands, "END_S", 0.3)

    async def run() -> None:
        work.begin_step(IDA, id_step(FREE, 1, 57_600, 3))
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(asyncio.wait_for(run(), 20.0))
    assert work.output.lines[-1] == "not done in time"
    assert work.output.code != 0


def test_a_step_without_its_program_says_so(
    work: BenchCommands, state: PanelState, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))

    async def run() -> None:
        work.begin_step(IDA, SCAN)
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(run())
    assert "No such file" in work.output.lines[0]
    assert work.output.code is None


def test_what_is_said_without_end_is_not_kept_without_end(work: BenchCommands, state: PanelState) -> None:
    async def run() -> None:
        work.begin_step(IDA, TerminalStep("scan", ("sh", "-c", "yes | head -c 100000"), is_run_here=True))
        await ended(work)

    state.control.take_control(IDA)
    asyncio.run(run())
    assert work.output.lines == ("y",) * MAX_LINES


def test_the_command_for_an_id_is_one_that_setup_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(setup, "work", lambda options: seen.append(options) or 0)
    assert setup.main(list(id_step(FREE, 1, 57_600, 3).words[4:])) == 0
    (options,) = seen
    assert (options.port, options.baud, options.id) == ("/dev/servos", 57_600, 1)
    assert (options.new_id, options.new_baud, options.reboot) == (3, 1_000_000, False)


@pytest.mark.parametrize(("now", "baud", "new"), [(-1, 57_600, 3), (1, 57_600, 253), (1, 12_345, 3)])
def test_an_id_or_a_rate_that_no_servo_has_is_refused(now: int, baud: int, new: int) -> None:
    with pytest.raises(PanelError, match="expected"):
        id_step(FREE, now, baud, new)
