# SPDX-License-Identifier: Apache-2.0
"""cell/swap_progress: where the present or last swap stands, for whoever has not ordered it. It never has a token."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import SupportsIndex

from softgrip_cell.cell import Cell
from softgrip_cell.nodes import convert
from softgrip_cell.storage.journal import SwapOutcome
from softgrip_cell.swap.sequence import HANDS_OUT_TEXT, SwapTransition
from softgrip_interfaces.msg import SwapProgress
from softgrip_interfaces.srv import ConfirmStep
from softgrip_nodekit import to_time_message


class SwapProgressLog:
    """Keeps where a swap stands, and publishes each change.

    Args:
        cell: knows whether the drives are still locked by a swap, and what the last run left.
        publish: sends cell/swap_progress.
        now_ns: the node's clock [ns since the epoch].
    """

    def __init__(self, cell: Cell, publish: Callable[[SwapProgress], object], now_ns: Callable[[], int]) -> None:
        self._cell = cell
        self._publish = publish
        self._now_ns = now_ns
        self._progress = SwapProgress()
        self._was_published = False

    def publish_start(self, goal_id: Iterable[SupportsIndex], finger_set: str) -> None:
        """Publish that a swap begins.

        Args:
            goal_id: the 16 bytes of its goal's identity.
            finger_set: id of what is to be mounted.
        """
        since = to_time_message(self._now_ns())
        self._progress = SwapProgress(
            running=True, goal_id=[int(byte) for byte in goal_id], finger_set=finger_set, since=since
        )
        self._send()

    def publish_step(self, turn: SwapTransition) -> None:
        """Publish the step that begins now."""
        progress = self._progress
        progress.step, progress.instruction = convert.SWAP_STEPS[turn.step], turn.instruction
        progress.confirmation = turn.confirmation
        self._send()

    def publish_end(self, outcome: SwapOutcome, reason: str) -> None:
        """Publish the end, and whether the drives wait for hands that are still inside."""
        progress = self._progress
        progress.running, progress.outcome, progress.reason = False, outcome, reason
        self._set_waiting()
        self._send()

    def publish_changes(self) -> None:
        """Publish once at the start; later where drives that a swap left locked were unlocked, or found locked."""
        if self._progress.running or (
            self._was_published and self._progress.confirmation == (self._cell.lock is not None)
        ):
            return
        cut = self._cell.cut_off
        if not self._progress.finger_set and cut is not None and cut.kind == "swap":
            self._progress.finger_set, self._progress.outcome = cut.subject, SwapOutcome.FAILED
            self._progress.reason = cut.text
        self._set_waiting()
        self._send()

    def _set_waiting(self) -> None:
        progress, lock = self._progress, self._cell.lock
        progress.confirmation = lock is not None
        progress.step = ConfirmStep.Request.HANDS_OUT if lock is not None else ConfirmStep.Request.UNSET
        progress.instruction = HANDS_OUT_TEXT if lock is not None else ""
        if lock is not None and not progress.finger_set:
            progress.finger_set = lock.subject

    def _send(self) -> None:
        self._was_published = True
        self._progress.header.stamp = to_time_message(self._now_ns())
        self._publish(self._progress)
