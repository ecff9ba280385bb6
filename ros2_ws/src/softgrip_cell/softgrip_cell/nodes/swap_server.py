# SPDX-License-Identifier: Apache-2.0
"""Action cell/swap and service cell/confirm_step: walks a SwapSequence through driver, person and check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, Protocol

from rclpy.action import CancelResponse
from rclpy.task import Future

from softgrip_cell.errors import CellError, RefusedError
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.driver_link import DriverLink
from softgrip_cell.observation import Pair, SeenTip, TendonFault, TendonSample
from softgrip_cell.storage.journal import Slot
from softgrip_cell.swap.check import CheckSettings, EmptyClosing, Finding, FingerCheck
from softgrip_cell.swap.sequence import SwapSequence, SwapStep, Turn
from softgrip_interfaces.action import MoveTendon, SwapFingers
from softgrip_interfaces.srv import ConfirmStep
from softgrip_nodekit import Doors

#: A tendon with less tension than this may be unhooked [N].
SLACK_N: Final = 2.0


class SwapHost(Protocol):
    """What the action needs of the manager."""

    def begin_swap(self, finger_set: str, serials: Sequence[str]) -> SwapSequence:
        """Check every gate and take the cell; raises RefusedError."""

    def earlier_references(self, sequence: SwapSequence) -> Mapping[str, FreeReference]:
        """What the last checks of these fingers saw, per slot."""

    def remember(self, turn: Turn) -> None:
        """Write down what has to be written before a step begins."""

    def end_swap(
        self, sequence: SwapSequence, outcome: str, reason: str, duration_s: float, checks: Mapping[str, FingerCheck]
    ) -> None:
        """Write down what came of it and give the cell back."""

    def slots(self) -> Sequence[Slot]:
        """What the slots hold now."""

    def now_s(self) -> float:
        """Monotonic time [s]."""


class SwapEnded(Exception):  # noqa: N818  not an error: the way out of the procedure
    """The swap is over before its last step."""

    def __init__(self, outcome: str, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome
        self.reason = reason


class SwapServer:
    """One swap at a time."""

    def __init__(
        self,
        doors: Doors,
        host: SwapHost,
        driver: DriverLink,
        settings: CheckSettings,
        slots: Sequence[str],
        limit_s: float,
    ) -> None:
        self._doors = doors
        self._host = host
        self._driver = driver
        self._settings = settings
        self._slots = tuple(slots)
        self._limit_s = limit_s
        self._sequence: SwapSequence | None = None
        self._goal: Any = None
        self._waiting: Future | None = None
        self._ended: SwapEnded | None = None
        self._closing: EmptyClosing | None = None
        self._started_s = 0.0
        self._tension_n: tuple[float, ...] = ()
        doors.action_server(SwapFingers, "cell/swap", self._execute, self._cancel)
        doors.service(ConfirmStep, "cell/confirm_step", self._confirm)

    @property
    def active(self) -> bool:
        """Whether a swap is going on."""
        return self._sequence is not None

    def observe_sample(self, sample: TendonSample) -> None:
        """Take a tendon sample."""
        self._tension_n = sample.tension_n

    def observe(self, pair: Pair) -> None:
        """Take a tendon sample with its prediction."""
        if self._closing is not None:
            self._closing.observe(pair)

    def see(self, tips: Sequence[SeenTip]) -> None:
        """Take what the camera saw."""
        if self._closing is not None:
            for tip in tips:
                self._closing.see(tip)

    def observe_faults(self, faults: Sequence[TendonFault]) -> None:
        """Take what tendon/status says; a fault while the cell itself moves ends the swap."""
        if self._sequence is not None and faults and self._sequence.step in (SwapStep.HOME, SwapStep.VERIFY):
            fault = faults[0]
            self._interrupt("FAILED", f"tendon {fault.tendon}: {fault.name}: {fault.reason}")

    def watch_clock(self) -> None:
        """End a swap that takes longer than it may."""
        if self._sequence is not None and self._host.now_s() - self._started_s > self._limit_s:
            self._interrupt("FAILED", f"not done within {self._limit_s:g} s, at step '{self._sequence.step}'")

    async def _execute(self, goal_handle: Any) -> SwapFingers.Result:
        request = goal_handle.request
        try:
            sequence = self._host.begin_swap(request.finger_set, list(request.serials))
        except CellError as error:
            goal_handle.abort()
            return convert.swap_result("REFUSED", str(error), self._host.slots(), 0.0)
        self._sequence, self._goal, self._ended, self._waiting = sequence, goal_handle, None, None
        self._started_s = self._host.now_s()
        checks: Mapping[str, FingerCheck] = {}
        try:
            await self._walk(sequence)
            checks = await self._verify(sequence)
            bad = [f"{name}: {check.reason}" for name, check in checks.items() if check.finding is not Finding.GOOD]
            outcome, reason = ("FAILED", "check refused: " + "; ".join(bad)) if bad else ("SUCCEEDED", _praise(checks))
        except SwapEnded as end:
            outcome, reason = end.outcome, f"{end.reason}; {sequence.safe_condition()}"
        except CellError as error:
            outcome, reason = "FAILED", f"{error}; {sequence.safe_condition()}"
        self._sequence, self._goal, self._closing = None, None, None
        self._driver.release(lambda _success, _message: None)
        duration_s = self._host.now_s() - self._started_s
        try:
            self._host.end_swap(sequence, outcome, reason, duration_s, checks)
        except CellError as error:
            outcome, reason = "FAILED", str(error)
        if outcome == "SUCCEEDED":
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return convert.swap_result(outcome, reason, self._host.slots(), duration_s)

    async def _walk(self, sequence: SwapSequence) -> None:
        """From slack tendons to homed ones."""
        self._tell(sequence.start())
        await self._slackened()
        turn = sequence.released()
        while turn.confirmation:
            self._host.remember(turn)
            self._tell(turn)
            turn = await self._wait()
        self._host.remember(turn)
        self._tell(turn)
        await self._answered(self._driver.home, "tendon/home")

    async def _verify(self, sequence: SwapSequence) -> Mapping[str, FingerCheck]:
        """Close on nothing, open again, and judge."""
        turn = sequence.homed()
        self._host.remember(turn)
        self._tell(turn)
        self._closing = EmptyClosing(self._slots, self._settings, self._host.earlier_references(sequence))
        settings = self._settings
        await self._moved(settings.length_m, settings.speed_m_per_s, settings.tension_limit_n)
        closing, self._closing = self._closing, None
        await self._moved(0.0, 2.0 * settings.speed_m_per_s, 0.0)
        return closing.judge()

    async def _moved(self, target_m: float, speed_m_per_s: float, tension_limit_n: float) -> None:
        def ended(outcome: int, reason: str) -> None:
            if outcome in (MoveTendon.Result.REACHED, MoveTendon.Result.TENSION_LIMIT):
                self._resume(None)
            else:
                self._interrupt("FAILED", f"tendon/move to {target_m * 1e3:.1f} mm: {reason}")

        self._driver.move(self._slots, [target_m] * len(self._slots), speed_m_per_s, tension_limit_n, ended)
        await self._wait()

    async def _slackened(self) -> None:
        """Have the tendons released; where the driver has none to release they have to be slack already."""

        def answered(success: bool, message: str) -> None:
            pulling = [name for name, n in zip(self._slots, self._tension_n, strict=False) if n > SLACK_N]
            if success or (self._tension_n and not pulling):
                self._resume(None)
            else:
                self._interrupt(
                    "FAILED", f"tendon/release: {message}; tendons {', '.join(pulling) or 'unseen'} are taut"
                )

        self._driver.release(answered)
        await self._wait()

    async def _answered(self, call: Any, name: str) -> None:
        def answered(success: bool, message: str) -> None:
            if success:
                self._resume(None)
            else:
                self._interrupt("FAILED", f"{name}: {message}")

        call(answered)
        await self._wait()

    async def _wait(self) -> Any:
        """Wait for whoever resumes or interrupts the swap."""
        if self._waiting is None:
            self._waiting = Future()
        result = await self._doors.resumed("swap", self._waiting)
        self._waiting = None
        if self._ended is not None:
            raise self._ended
        return result

    def _resume(self, value: Any) -> None:
        if self._waiting is None:
            self._waiting = Future()
        if not self._waiting.done():
            self._waiting.set_result(value)

    def _interrupt(self, outcome: str, reason: str) -> None:
        if self._sequence is not None:
            self._driver.hold()
            self._ended = self._ended or SwapEnded(outcome, reason)
            self._resume(None)

    def _tell(self, turn: Turn) -> None:
        self._goal.publish_feedback(
            SwapFingers.Feedback(
                step=turn.step.value,
                instruction=turn.instruction,
                confirmation=turn.confirmation,
                elapsed=self._host.now_s() - self._started_s,
            )
        )

    def _confirm(self, request: Any, response: Any) -> Any:
        try:
            if self._sequence is None:
                raise RefusedError("expected a swap to be going on, found none; start one with cell/swap")
            turn = self._sequence.confirm(request.step, list(request.serials))
            response.success, response.message = True, turn.instruction
            self._resume(turn)
        except RefusedError as error:
            response.success, response.message = False, str(error)
        return response

    def _cancel(self, _goal_handle: Any) -> CancelResponse:
        self._doors.later(self._interrupt, "CANCELLED", "cancelled by the client")
        return CancelResponse.ACCEPT


def _praise(checks: Mapping[str, FingerCheck]) -> str:
    return "; ".join(f"{name}: {check.reason}" for name, check in checks.items())
