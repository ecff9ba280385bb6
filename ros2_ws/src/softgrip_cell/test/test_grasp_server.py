# SPDX-License-Identifier: Apache-2.0
"""The action's side of a grasp: until the cell knows what came of it, the tendons stay the manager's."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from softgrip_cell.errors import StorageError
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.nodes.grasp_server import GraspServer

pytestmark = pytest.mark.ros


class QueuedIo:
    """Tasks wait until the test lets them run; what rclpy's executor does between two callbacks."""

    def __init__(self) -> None:
        self.tasks: list[Callable[[], Any]] = []
        self.execute: Any = None

    def create_action_server(self, _kind: Any, _name: str, execute: Any, _cancel: Any) -> None:
        self.execute = execute

    def create_task(self, work: Callable[..., Any], *arguments: Any) -> None:
        self.tasks.append(lambda: work(*arguments))

    async def wait_for(self, _name: str, future: Any) -> Any:
        return await future


class GivenGoal(SimpleNamespace):
    """A goal for an egg; remembers how it ended."""

    def __init__(self) -> None:
        request = SimpleNamespace(product="egg", confirm_lift=False, trial=False)
        super().__init__(request=request, is_cancel_requested=False, ended="")

    def publish_feedback(self, _feedback: Any) -> None:
        pass

    def abort(self) -> None:
        self.ended = "aborted"


@pytest.mark.parametrize("problem", [None, StorageError("the disk is full")])
def test_a_grasp_is_active_until_the_cell_knows_what_came_of_it(task: Any, problem: Exception | None) -> None:
    known: list[str] = []

    def end_grasp(_task: Any, verdict: Any, _duration_s: float) -> None:
        known.append(verdict.reason)
        if problem is not None:
            raise problem

    cell = SimpleNamespace(now_s=lambda: 0.0, begin_grasp=lambda *_, **__: task(), end_grasp=end_grasp)
    lease = SimpleNamespace(acquire=lambda answered: answered(""))
    node_io, goal = QueuedIo(), GivenGoal()
    server = GraspServer(node_io, cell, SimpleNamespace(lease=lease, run=lambda *_: None), GraspSettings())  # type: ignore[arg-type]
    running = node_io.execute(goal)
    running.send(None)
    assert server.active
    server.abort("a test")
    with pytest.raises(StopIteration):
        running.send(None)  # the result goes out
    assert (goal.ended, known) == ("aborted", [])
    assert server.active  # else the manager would give the tendons back beside a product that is held
    (finish,) = node_io.tasks
    if problem is None:
        finish()
    else:
        with pytest.raises(StorageError):
            finish()
    assert known == ["a test"]
    assert not server.active
