# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys
import threading
import time

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


CLINGING = """
import ctypes, sys
import rclpy
from rclpy.node import Node
from softgrip_nodekit import run

class Clinging(Node):
    def __init__(self):
        super().__init__("clinging")
        self.create_timer(0.01, rclpy.shutdown)

    def close(self):
        print("safe", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(20)  # with Python's lock: no thread of Python's could end this

sys.exit(run(Clinging, []))
"""


def test_a_middleware_that_does_not_let_go_holds_nobody_up() -> None:
    started = time.monotonic()
    done = subprocess.run([sys.executable, "-c", CLINGING], capture_output=True, text=True, check=False, timeout=40)
    assert 3.0 < time.monotonic() - started < 18.0
    assert done.returncode == 1
    assert done.stdout == "safe\n"  # the hardware first
    assert "in destroy_node" in done.stderr
