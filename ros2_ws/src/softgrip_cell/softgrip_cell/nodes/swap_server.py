# SPDX-License-Identifier: Apache-2.0
"""Action cell/swap and service cell/confirm_step: walks a SwapSequence through driver, person and check.

While a person's hands may be inside, from open_palm to close_palm, the drives are locked (tendon/lock): torque off and
every motion refused. A swap that ends meanwhile leaves them locked until a person confirms that the hands are out.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from rclpy.action import CancelResponse
from rclpy.task import Future

from softgrip_cell.cell import Cell
from softgrip_cell.errors import CellError, RefusedError
from softgrip_cell.gates import SafetyFacts
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.drive_lock import DriveLock
from softgrip_cell.nodes.driver_link import Answered, DriverLink, MoveEnd
from softgrip_cell.nodes.swap_progress import SwapProgressLog
from softgrip_cell.observation import ObservedPair, SeenTip, TendonFault, TendonSample
from softgrip_cell.storage.journal import HeldLock, SwapOutcome
from softgrip_cell.swap.check import CheckSettings, EmptyClosing, Finding, FingerCheck
from softgrip_cell.swap.sequence import (
    HANDS_OUT,
    HANDS_OUT_TEXT,
    OVERRIDE_TEXT,
    SwapSequence,
    SwapStep,
    SwapTransition,
)
from softgrip_interfaces.action import SwapFingers
from softgrip_interfaces.srv import ConfirmStep
from softgrip_nodekit import GoalHandle, NodeIo, answer

T = TypeVar("T")
_Handle = GoalHandle[SwapFingers.Goal, SwapFingers.Feedback]

#: A tendon with less tension than this may be unhooked [N].
SLACK_N: Final = 2.0
#: Once tendon/release has answered, the tendons have to be seen slack within this [s].
SLACK_S: Final = 2.0
#: At its end a swap waits at most so long for the driver to slacken the tendons and to take the lease back [s].
GIVE_BACK_S: Final = 5.0
#: Whether the lock still stands is asked at most so often [s].
ASK_S: Final = 1.0

#: Steps in which the cell itself moves, or is about to.
MOVING: Final = frozenset({SwapStep.RELEASE, SwapStep.HOME, SwapStep.VERIFY})


class SwapEnded(Exception):  # noqa: N818  not an error: the way out of the procedure
    """The swap is over before its last step."""

    def __init__(self, outcome: SwapOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome
        self.reason = reason


class SwapServer:
    """One swap at a time.

    Args:
        node_io: the node's way to others.
        cell: its rules and what it holds.
        driver: moves the tendons.
        lock: of the drives.
        progress: says to everybody where the swap stands.
        settings: of the check.
        slots: tendon names, in slot order.
        limit_s: longest swap [s].
    """

    def __init__(
        self,
        node_io: NodeIo,
        cell: Cell,
        driver: DriverLink,
        lock: DriveLock,
        progress: SwapProgressLog,
        settings: CheckSettings,
        slots: Sequence[str],
        limit_s: float,
    ) -> None:
        self._node_io = node_io
        self._cell = cell
        self._driver = driver
        self._lock = lock
        self._progress = progress
        self._settings = settings
        self._slots = tuple(slots)
        self._limit_s = limit_s
        self._sequence: SwapSequence | None = None
        self._goal: _Handle | None = None
        self._token = ""  # of the running swap, for cell/confirm_step
        self._waiting: Future[Any] = Future()
        self._ended: SwapEnded | None = None
        self._closing: EmptyClosing | None = None
        self._started_s = 0.0
        self._slack: Future[None] | None = None  # waits for slack tendons
        self._slack_until_s = 0.0
        self._slack_said = ""
        self._given_back: tuple[Future[None], float] | None = None
        self._lock_stands = False  # the driver has said so since it was taken, or since safety/state said otherwise
        self._next_ask_s = 0.0
        self._tension_n: tuple[float, ...] = ()
        node_io.create_action_server(SwapFingers, "cell/swap", self._execute, self._cancel)
        node_io.create_order_service(ConfirmStep, "cell/confirm_step", self._on_confirm)

    @property
    def active(self) -> bool:
        """Whether a swap is going on."""
        return self._sequence is not None

    def observe_sample(self, sample: TendonSample) -> None:
        """Take a tendon sample."""
        self._tension_n = sample.tension_n
        if self._slack is not None and not self._taut():
            slack, self._slack = self._slack, None
            _resolve(slack, None)

    def observe(self, pair: ObservedPair) -> None:
        """Take a tendon sample with its prediction."""
        if self._closing is not None:
            self._closing.observe(pair)

    def observe_tips(self, tips: Sequence[SeenTip]) -> None:
        """Take what the camera saw."""
        if self._closing is not None:
            for tip in tips:
                self._closing.observe_tip(tip)

    def observe_faults(self, faults: Sequence[TendonFault]) -> None:
        """Take what tendon/status says; a fault while the cell itself moves ends the swap."""
        if self._sequence is not None and faults and self._sequence.step in (SwapStep.HOME, SwapStep.VERIFY):
            fault = faults[0]
            self._interrupt(SwapOutcome.FAILED, f"tendon {fault.tendon}: {fault.name}: {fault.reason}")

    def observe_safety(self, safety: SafetyFacts) -> None:
        """Take safety/state; a stop or somebody's lock ends a swap that moves."""
        if not safety.locked:
            self._lock_stands = False  # whether ours is meant, the driver is asked
        if self._sequence is None or self._sequence.step not in MOVING:
            return
        if safety.estop:
            self._interrupt(SwapOutcome.FAILED, f"the emergency stop is latched: {safety.estop_reason}")
        elif safety.locked:
            self._interrupt(SwapOutcome.FAILED, safety.lock_text)

    def lose(self, reason: str) -> None:
        """End a swap that moves: the tendons are somebody else's."""
        if self._sequence is not None and self._sequence.step in MOVING:
            self._interrupt(SwapOutcome.FAILED, reason)

    def fall_silent(self, reason: str) -> None:
        """End a swap that moves: the driver is not heard any more."""
        self.lose(reason)

    def watch_clock(self) -> None:
        """End what takes longer than it may; see that the lock of the drives still stands."""
        now_s = self._cell.now_s()
        if self._sequence is not None and now_s - self._started_s > self._limit_s:
            self._interrupt(SwapOutcome.FAILED, f"not done within {self._limit_s:g} s, at step '{self._sequence.step}'")
        if self._slack is not None and now_s > self._slack_until_s:
            taut = ", ".join(self._taut()) or "(none seen since)"
            self._interrupt(SwapOutcome.FAILED, f"tendon/release: {self._slack_said}; tendons {taut} are taut")
        if self._given_back is not None and now_s > self._given_back[1]:
            _resolve(self._given_back[0], None)
        if self._cell.lock is not None and not self._lock_stands and now_s >= self._next_ask_s and self._lock.ready():
            self._next_ask_s = now_s + ASK_S
            self._lock.ask(self._cell.lock.token, self._on_lock_asked)

    async def _execute(self, goal_handle: _Handle) -> SwapFingers.Result:
        request = goal_handle.request
        try:
            sequence = self._cell.begin_swap(request.finger_set, list(request.serials))
        except CellError as error:
            goal_handle.abort()
            return convert.swap_result(SwapOutcome.REFUSED, str(error), self._cell.slots(), 0.0)
        self._sequence, self._goal, self._ended = sequence, goal_handle, None
        self._token = self._node_io.draw_token()
        self._started_s = self._cell.now_s()
        self._progress.publish_start(goal_handle.goal_id.uuid, sequence.finger_set.id)
        outcome, reason, checks = await self._swapped(sequence)
        self._goal, self._closing, self._slack = None, None, None
        duration_s = self._cell.now_s() - self._started_s
        if self._cell.lock is not None:
            reason = f"{reason}; {HANDS_OUT_TEXT}"
        await self._give_back()
        self._sequence = None
        self._cell.end_swap(sequence, outcome, reason, duration_s, checks)
        self._progress.publish_end(outcome, reason)
        if outcome is SwapOutcome.SUCCEEDED:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return convert.swap_result(outcome, reason, self._cell.slots(), duration_s)

    async def _swapped(self, sequence: SwapSequence) -> tuple[SwapOutcome, str, Mapping[str, FingerCheck]]:
        """Return outcome, reason, and what was found of the fingers."""
        try:
            await self._walk(sequence)
            checks = await self._verify(sequence)
        except SwapEnded as end:
            return end.outcome, f"{end.reason}; {sequence.safe_condition()}", {}
        except CellError as error:
            return SwapOutcome.FAILED, f"{error}; {sequence.safe_condition()}", {}
        bad = [f"{name}: {check.reason}" for name, check in checks.items() if check.finding is not Finding.GOOD]
        return (
            (SwapOutcome.FAILED, "check refused: " + "; ".join(bad), checks)
            if bad
            else (SwapOutcome.SUCCEEDED, _check_summary(checks), checks)
        )

    async def _walk(self, sequence: SwapSequence) -> None:
        """From slack tendons to homed ones."""
        self._tell(sequence.start())
        await self._owned()
        await self._slackened()
        turn = sequence.released()
        if turn.step is SwapStep.LOCK:
            turn = await self._changed_by_hand(sequence, turn)
        self._cell.persist(turn)
        self._tell(turn)
        await self._answered(self._driver.home, "tendon/home")

    async def _changed_by_hand(self, sequence: SwapSequence, turn: SwapTransition) -> SwapTransition:
        """Lock the drives, have a person change the fingers, unlock; returns what follows."""
        self._cell.persist(turn)
        self._tell(turn)
        token = await self._locked(sequence)
        turn = sequence.locked()
        try:
            self._cell.keep_lock(turn, HeldLock(token, self._token, sequence.finger_set.id))
        except CellError:
            self._unlock_unused(token)  # nobody was told to reach in
            raise
        while turn.confirmation:
            self._tell(turn)
            turn = await self._wait(Future())
            self._cell.persist(turn)
        self._tell(turn)
        await self._unlocked(token)
        await self._owned()
        return sequence.unlocked()

    async def _verify(self, sequence: SwapSequence) -> Mapping[str, FingerCheck]:
        """Close on nothing, open again, and judge."""
        turn = sequence.homed()
        self._cell.persist(turn)
        self._tell(turn)
        self._closing = EmptyClosing(self._slots, self._settings, self._cell.earlier_references(sequence))
        settings = self._settings
        ended_m = await self._moved(settings.length_m, settings.speed_m_per_s)
        closing, self._closing = self._closing, None
        closing.end(ended_m)
        await self._moved(0.0, 2.0 * settings.speed_m_per_s)
        return closing.judge()

    async def _moved(self, target_m: float, speed_m_per_s: float) -> Mapping[str, float]:
        """Move all tendons; return where each was in the end [m]."""
        done: Future[Mapping[str, float]] = Future()

        def ended(end: MoveEnd) -> None:
            if end.is_good:
                _resolve(done, end.pulled_length_m)
            else:
                self._interrupt(SwapOutcome.FAILED, f"tendon/move to {target_m * 1e3:.1f} mm: {end.reason}")

        targets_m = [target_m] * len(self._slots)
        self._driver.move(self._slots, targets_m, speed_m_per_s, self._settings.tension_limit_n, ended)
        return await self._wait(done)

    async def _owned(self) -> None:
        """Become the owner of the tendons; the driver's words say whose they are."""
        done: Future[str] = Future()
        self._driver.lease.acquire(lambda why_not: _resolve(done, why_not))
        why_not = await self._wait(done)
        if why_not:
            raise SwapEnded(SwapOutcome.FAILED, why_not)

    async def _slackened(self) -> None:
        """Release the tendons, and wait until they are slack; where the driver releases none they have to be so."""
        slack: Future[None] = Future()

        def answered(success: bool, message: str) -> None:
            self._slack, self._slack_said = slack, "done" if success else message
            self._slack_until_s = self._cell.now_s() + SLACK_S

        self._driver.release(answered)
        await self._wait(slack)

    def _taut(self) -> list[str]:
        """Return the tendons that pull; all while none was seen."""
        if not self._tension_n:
            return list(self._slots)
        return [name for name, tension_n in zip(self._slots, self._tension_n, strict=True) if tension_n > SLACK_N]

    async def _locked(self, sequence: SwapSequence) -> str:
        """Lock the drives; returns the token."""
        done: Future[str] = Future()

        def answered(success: bool | None, said: str) -> None:
            if not success:
                self._interrupt(SwapOutcome.FAILED, f"tendon/lock: {said}")
            elif done.done() or self._ended is not None:
                self._unlock_unused(said)  # the swap ended meanwhile, nobody was told to reach in
            else:
                self._lock_stands = True
                _resolve(done, said)

        if not self._lock.ready():
            raise SwapEnded(SwapOutcome.FAILED, "expected services tendon/lock and tendon/unlock, found none")
        self._lock.lock(f"swap to '{sequence.finger_set.id}'", answered)
        return await self._wait(done)

    async def _unlocked(self, token: str) -> None:
        """Unlock the drives: no hands are inside any more."""
        done: Future[None] = Future()

        def answered(success: bool | None, said: str) -> None:
            if success:
                self._cell.drop_lock()
                _resolve(done, None)
            else:
                self._lock_stands = False
                self._interrupt(SwapOutcome.FAILED, f"tendon/unlock: {said}")

        self._lock.unlock(token, "the palm is closed", answered)
        await self._wait(done)

    def _unlock_unused(self, token: str) -> None:
        self._lock.unlock(token, "the swap ended before anybody reached in", lambda _success, _said: None)

    def _on_lock_asked(self, success: bool | None, said: str) -> None:
        if self._cell.lock is None or success is None:
            return
        self._lock_stands = success
        if not success:
            self._cell.drop_lock(f"the lock of the drives is gone: {said}; run cell/swap when all hands are out")
            self._interrupt(SwapOutcome.FAILED, f"the lock of the drives is gone: {said}; take your hands out")

    async def _answered(self, call: Callable[[Answered], None], name: str) -> None:
        done: Future[None] = Future()

        def answered(success: bool, message: str) -> None:
            if success:
                _resolve(done, None)
            else:
                self._interrupt(SwapOutcome.FAILED, f"{name}: {message}")

        call(answered)
        await self._wait(done)

    async def _give_back(self) -> None:
        """Order slack tendons, unless the drives are locked, and give them back to whoever comes next."""
        done: Future[None] = Future()
        self._given_back = (done, self._cell.now_s() + GIVE_BACK_S)

        def give_back(*_: object) -> None:
            self._driver.lease.release(lambda: _resolve(done, None))

        if self._cell.lock is None:
            self._driver.release(give_back)
        else:
            give_back()
        await self._node_io.wait_for("swap", done)
        self._given_back = None

    async def _wait(self, future: Future[T]) -> T:
        """Wait for what resolves the future, or for whoever interrupts the swap."""
        if self._ended is None:
            self._waiting = future
            result = await self._node_io.wait_for("swap", future)
        if self._ended is not None:
            raise self._ended
        return result

    def _interrupt(self, outcome: SwapOutcome, reason: str) -> None:
        if self._goal is not None:
            self._driver.hold()
            self._slack = None
            self._ended = self._ended or SwapEnded(outcome, reason)
            _resolve(self._waiting, None)

    def _tell(self, turn: SwapTransition) -> None:
        assert self._goal is not None
        self._goal.publish_feedback(
            SwapFingers.Feedback(
                step=convert.SWAP_STEPS[turn.step],
                instruction=turn.instruction,
                confirmation=turn.confirmation,
                elapsed=self._cell.now_s() - self._started_s,
                token=self._token,
            )
        )
        self._progress.publish_step(turn)

    def _on_confirm(self, request: ConfirmStep.Request, response: ConfirmStep.Response) -> ConfirmStep.Response:
        return answer(response, lambda: self._confirm(request), RefusedError)

    def _confirm(self, request: ConfirmStep.Request) -> str:
        if self._sequence is not None:
            return self._confirm_step(self._sequence, request)
        return self._confirm_hands_out(request)

    def _confirm_step(self, sequence: SwapSequence, request: ConfirmStep.Request) -> str:
        _check_token(request.token, self._token)
        if self._goal is None or self._ended is not None:
            raise RefusedError("the swap is ending; look at its result")
        turn = sequence.confirm(convert.confirmed_step(request), list(request.serials))
        _resolve(self._waiting, turn)
        return turn.instruction

    def _confirm_hands_out(self, request: ConfirmStep.Request) -> str:
        """Unlock the drives that an interrupted swap left locked, in this or in an earlier run."""
        lock = self._cell.lock
        if lock is None:
            raise RefusedError("expected a swap to be going on, found none; start one with cell/swap")
        confirmed = convert.confirmed_step(request)
        if confirmed != HANDS_OUT:
            raise RefusedError(f"expected a confirmation of step '{HANDS_OUT}', found '{confirmed}'")
        _check_token(request.token, lock.confirm_token, f"; {OVERRIDE_TEXT}")
        if not self._lock.ready():
            raise RefusedError("expected service tendon/unlock, found none; start tendon_driver, then confirm again")

        def answered(success: bool | None, _said: str) -> None:
            if success:
                self._cell.drop_lock("hands are out, the drives are unlocked; run cell/swap before any grasp")
            else:
                self._lock_stands = False  # the driver is asked what became of it

        self._lock.unlock(lock.token, "a person confirmed that hands are out", answered)
        return "the drives are being unlocked; run cell/swap before any grasp"

    def _cancel(self, _goal_handle: _Handle) -> CancelResponse:
        self._node_io.create_task(self._interrupt, SwapOutcome.CANCELLED, "cancelled by the client")
        return CancelResponse.ACCEPT


def _resolve(future: Future[T], result: T) -> None:
    if not future.done():
        future.set_result(result)


def _check_token(given: str, expected: str, remedy: str = "") -> None:
    if not secrets.compare_digest(given.encode(), expected.encode()):
        found = "another one" if given else "none"
        raise RefusedError(
            f"expected the token that the feedback of this swap gave to its client, found {found}{remedy}"
        )


def _check_summary(checks: Mapping[str, FingerCheck]) -> str:
    return "; ".join(f"{name}: {check.reason}" for name, check in checks.items())
