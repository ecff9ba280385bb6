# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading

import pytest
import rclpy
from rclpy.node import Node

from softgrip_nodekit import run


class Failing(Node):
    """Fails in its first callback."""

    def __init__(self) -> None:
        super().__init__("failing")
        self.create_timer(0.01, self._fail)
        self.closed = False

    def _fail(self) -> None:
        raise RuntimeError("Unable to convert call argument '0' to Python object")

    def close(self) -> None:
        self.closed = True


class Interrupted(Failing):
    """The same while a signal ends the process: rclpy says this when SIGINT cuts the taking of a message short."""

    def _fail(self) -> None:
        threading.Timer(0.05, rclpy.shutdown).start()
        super()._fail()


@pytest.mark.parametrize(("kind", "fails"), [(Failing, True), (Interrupted, False)])
def test_an_error_counts_unless_the_node_is_being_stopped(kind: type[Failing], fails: bool) -> None:
    made: list[Failing] = []

    def make() -> Failing:
        made.append(kind())
        return made[0]

    if fails:
        with pytest.raises(RuntimeError, match="Unable to convert"):
            run(make, [])
    else:
        assert run(make, []) == 0
    assert made[0].closed
