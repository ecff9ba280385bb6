# SPDX-License-Identifier: Apache-2.0
"""grasp_mix_manager recorded while it works for a controller, and replayed: what it answered and commanded comes again.

The manager, its scripted driver and the controller are those of softgrip_cell's own tests.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.replay import check
from softgrip_bag.reader import read, topic_summaries
from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES
from softgrip_interfaces.action import SwapFingers
from softgrip_interfaces.msg import CellState
from softgrip_testing.bag_excerpt import excerpt
from softgrip_testing.free_domains import own_domain
from softgrip_testing.scripts import load_script
from softgrip_testing.waiting import wait_until

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
TESTS = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_cell/test"
NODE = "grasp_mix_manager"
TRACE = f"/{NODE}/trace"
NOTHING = (math.inf, math.inf, math.inf)
LONGEST = 60.0  # [s] for anything that is waited for


def load(name: str) -> ModuleType:
    """Return a module of softgrip_cell's tests."""
    return load_script(TESTS / f"{name}.py")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a manager that was asked everything."""
    return record(tmp_path_factory.mktemp("live"))


def record(folder: Path) -> Path:
    """Have a manager do all of `work` beside a recorder; return the bag (make_bags.py ships it)."""
    manager = load("manager/conftest")
    patch = pytest.MonkeyPatch()
    patch.setenv("ROS_DOMAIN_ID", own_domain())
    patch.setenv("ROS_LOCALHOST_ONLY", "1")
    manager.rclpy.init()
    cell = manager.Cell(folder, load("conftest").Bench())
    command = [sys.executable, "-m", "softgrip_bag.nodes.recorder", "--ros-args"]
    recorder = subprocess.Popen([*command, "-p", f"root:={folder}", "-p", f"path:={folder / 'bag'}"])
    try:
        wait_until(lambda: (folder / "bag").is_dir() and "/tendon/state" in topics(folder / "bag"), "a recorder")
        work(cell, folder / "bag")
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(LONGEST) == 0
    finally:
        recorder.kill()
        cell.close()
        manager.rclpy.try_shutdown()
        patch.undo()
    return folder / "bag"


def topics(bag: Path) -> set[str]:
    return {topic.name for topic in topic_summaries(bag) if topic.messages} if list(bag.glob("*.mcap")) else set()


def work(cell: Any, bag: Path) -> None:
    """A grasp with every outcome, a plan, a refused and a good swap, and a manager that is killed and comes back."""

    def grasp(outcome: str, during: Callable[[], None] | None = None) -> None:
        def on_phase(phase: str) -> None:
            if phase == "lift" and during is not None:
                during()

        result = cell.controller.grasp("orange", on_phase=on_phase)
        assert GRASP_OUTCOMES[result.outcome] == outcome, result.reason
        cell.controller.release()
        # the manager sees by the tendons that nothing is held any more, after the driver's answer
        cell.state(lambda state: state.mode not in {CellState.GRASPING, CellState.HOLDING}, "nothing held")

    def slip() -> None:
        cell.driver.bench.grip = lambda _: 0.0

    def fault() -> None:
        cell.driver.fault = "overheated"

    def swap() -> None:
        """Swap as a person does: on a busy computer samples of the check get lost, which asks for another closing."""
        tries = (cell.swap() for _ in range(5))
        swapped = next(each for each in tries if "samples up to" not in each.reason)
        assert swapped.outcome == SwapFingers.Result.SUCCEEDED, swapped.reason

    cell.start("lift_window_s:=0.5", "stale_s:=3.0")
    grasp("ABORTED")
    cell.controller.plan(["egg", "grape"], [2, 1])
    cell.controller.select("orange")
    assert cell.swap("claw").outcome == SwapFingers.Result.REFUSED
    swap()
    grasp("EMPTY")
    cell.driver.bench.contact_m = (0.008, 0.009, 0.0085)
    grasp("GRIPPED")
    grasp("SLIPPED", during=slip)
    cell.driver.bench.grip = lambda _: 1.0
    grasp("TENDON_FAULT", during=fault)
    cell.driver.fault = ""
    wait_until(lambda: len(digest(bag).grasps) == 5, "the trace of five grasps")
    cell.stop(signal.SIGKILL)
    cell.start("lift_window_s:=0.5", "stale_s:=3.0")
    cell.driver.bench.contact_m = NOTHING
    cell.driver.publish_friction()
    swap()
    cell.stop()


def test_what_the_manager_did_comes_out_again(bag: Path) -> None:
    result = check(bag, NODE)
    assert result.divergence is None, str(result.divergence)
    # a message of a best-effort stream may get lost on a busy machine; what follows it cannot be replayed
    assert result.compared > (0 if result.without_input else 80)
    outcomes = [grasp.outcome for grasp in digest(bag).grasps]
    assert outcomes == ["ABORTED", "EMPTY", "GRIPPED", "SLIPPED", "TENDON_FAULT"]


def test_another_threshold_is_found_and_named(bag: Path) -> None:
    found = check(bag, NODE, ["-p", "slip_share:=0.9", "-p", "false_alarm_s:=1e15"]).divergence
    assert found is not None
    assert found.topic.startswith(f"{NODE} step ")
    assert found.recorded != found.replayed


def test_what_follows_a_message_that_the_recorder_did_not_get_is_counted_as_not_compared(
    bag: Path, tmp_path: Path
) -> None:
    last = [message.received for message in read(bag, {"/tendon/state"})][-1]
    excerpt(bag, tmp_path / "cut", {TRACE, "/cell/state"}, 0, last)
    result = check(tmp_path / "cut", NODE)
    assert result.divergence is None
    assert result.without_input > 10 * result.compared  # it says how little was left to compare
