# SPDX-License-Identifier: Apache-2.0
"""A cell that is started when a step first needs it, and ended with the one who started it."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node

from softgrip_cell.nodes.controller_client import CellController
from softgrip_demo.errors import FirstRunError
from softgrip_demo.nodes.link import CellLink
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_nodekit import SENSOR, make_executor

#: [s] for the nodes to come up, and for the launch to end by itself
START_TIMEOUT_S, END_TIMEOUT_S = 120.0, 30.0
#: what a node prints before it gives up (softgrip_nodekit.run)
CANNOT_START = "cannot start: "


class CellSession:
    """The launch of a cell file, and a client of it.

    Args:
        cell_file: to launch.
        namespace: of the cell.
        arguments: of the launch besides, name:=value.
        log: file for what the launch prints.
    """

    def __init__(self, cell_file: Path, namespace: str, arguments: Sequence[str], log: Path) -> None:
        self._command = [
            "ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"cell_file:={cell_file}", *arguments,
        ]  # fmt: skip
        self._namespace, self._log = namespace, log
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None
        self._node: Node | None = None
        self._link: CellLink | None = None
        self._executor: Executor | None = None
        self._controller: CellController | None = None
        self._status: TendonStatusArray | None = None
        self.before_start: Callable[[], None] = lambda: None

    @property
    def link(self) -> CellLink:
        """The client; the cell is started when it is first asked for.

        Raises:
            FirstRunError: the cell does not come up.
        """
        if self._link is None:
            self._link = self._start()
        elif self._process is not None and self._process.poll() is not None:
            raise FirstRunError(f"expected the cell to run, found its launch ended; {self._last_words()}")
        return self._link

    @property
    def status(self) -> TendonStatusArray:
        """The newest tendon/status; `link` has waited for the first one."""
        assert self._status is not None, "the cell is started by its link"
        return self._status

    @property
    def controller(self) -> CellController:
        """The cell controller's client."""
        link = self.link
        if self._controller is None:
            self._controller = CellController(link.node, wait=link.wait)
        return self._controller

    def _start(self) -> CellLink:
        self.before_start()
        self._log.parent.mkdir(parents=True, exist_ok=True)
        self._output = self._log.open("wb")
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._node = node = Node("first_run", namespace=self._namespace)
        node.create_subscription(TendonStatusArray, "tendon/status", self._on_status, SENSOR)
        self._executor = make_executor(node)
        self._executor.add_node(node)
        link = CellLink(node, self._executor)
        link.until(self._is_up, START_TIMEOUT_S, "tendon/status of the cell")
        if self._status is None:
            raise FirstRunError(f"expected the cell to start, found its launch ended; {self._last_words()}")
        return link

    def _last_words(self) -> str:
        """Return what nodes said that could not start, and where the rest is."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        causes = [line.partition("] ")[2] for line in lines if CANNOT_START in line]
        return "; ".join([*causes, f"all that it said is in {self._log}"])

    def _is_up(self) -> bool:
        return self._status is not None or (self._process is not None and self._process.poll() is not None)

    def _on_status(self, message: TendonStatusArray) -> None:
        self._status = message

    def close(self) -> None:
        """End the client, then the cell."""
        if self._executor is not None:
            self._executor.shutdown(timeout_sec=2.0)
        if self._node is not None:
            self._node.destroy_node()
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._output is not None:
            self._output.close()
        rclpy.try_shutdown()
