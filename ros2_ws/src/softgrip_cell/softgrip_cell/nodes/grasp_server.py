# SPDX-License-Identifier: Apache-2.0
"""Action cell/grasp: feeds one GraspSequence and does what it commands."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.action import CancelResponse
from rclpy.task import Future

from softgrip_cell.cell import Cell
from softgrip_cell.errors import CellError
from softgrip_cell.grasp.commands import Close
from softgrip_cell.grasp.sequence import GraspSequence, GraspStep
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase, GraspTask, GraspVerdict
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.driver_link import DriverLink, MoveEnd
from softgrip_cell.observation import ObservedPair, SeenTip, TendonFault, TendonSample
from softgrip_interfaces.action import Grasp, MoveTendon
from softgrip_nodekit import GoalHandle, NodeIo

_Handle = GoalHandle[Grasp.Goal, Grasp.Feedback]


class GraspServer:
    """One grasp at a time, decided in the subscription callbacks that feed it."""

    def __init__(self, node_io: NodeIo, cell: Cell, driver: DriverLink, settings: GraspSettings) -> None:
        self._node_io = node_io
        self._cell = cell
        self._driver = driver
        self._settings = settings
        self._sequence: GraspSequence | None = None
        self._goal: _Handle | None = None
        self._done: Future[GraspVerdict] | None = None
        self._sample: TendonSample | None = None
        self._is_active = False
        self._step = GraspStep(GraspPhase.DONE)
        node_io.create_action_server(Grasp, "cell/grasp", self._execute, self._cancel)

    @property
    def phase(self) -> GraspPhase | None:
        """Where the running grasp stands, None when none runs."""
        return self._sequence.phase if self._sequence is not None else None

    @property
    def active(self) -> bool:
        """Whether a grasp is about to begin, goes on, or has an end that the cell does not know yet."""
        return self._is_active

    def observe_sample(self, sample: TendonSample) -> None:
        """Take a tendon sample before its prediction is known."""
        self._sample = sample
        if self._sequence is not None:
            self._do(self._sequence.observe_sample(sample))

    def observe(self, pair: ObservedPair) -> None:
        """Take a tendon sample with its prediction."""
        if self._sequence is not None:
            self._do(self._sequence.observe(pair))

    def observe_tip(self, tip: SeenTip) -> None:
        """Take what the camera saw; the next tendon sample is judged with it."""
        if self._sequence is not None:
            self._sequence.observe_tip(tip)

    def observe_faults(self, faults: Sequence[TendonFault], stamp_ns: int) -> None:
        """Take what tendon/status says; a fault ends the grasp."""
        if self._sequence is not None and faults:
            stop = next((fault for fault in faults if fault.name == "estop"), None)
            if stop is not None:
                self._do(self._sequence.abort(stop.reason, stamp_ns))
            else:
                self._do(self._sequence.fault(faults[0], stamp_ns))

    def abort(self, reason: str) -> None:
        """End the running grasp from outside."""
        if self._sequence is not None:
            self._do(self._sequence.abort(reason))

    async def _execute(self, goal_handle: _Handle) -> Grasp.Result:
        request = goal_handle.request
        started_s = self._cell.now_s()
        try:
            task = self._cell.begin_grasp(request.product, confirm_lift=request.confirm_lift, trial=request.trial)
        except CellError as error:
            return self._refused(goal_handle, f"refused: {error}")
        self._is_active = True
        why_not = await self._owned(goal_handle)
        if why_not:
            self._is_active = False
            self._cell.abandon_grasp(why_not)
            return self._refused(goal_handle, why_not)
        self._goal = goal_handle
        self._done = Future()
        self._sequence = GraspSequence(task, self._settings)
        self._do(self._sequence.start())
        verdict = await self._node_io.wait_for("grasp", self._done)
        duration_s = self._cell.now_s() - started_s
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        elif verdict.outcome is GraspOutcome.ABORTED:
            goal_handle.abort()
        else:
            goal_handle.succeed()
        result = convert.grasp_result(verdict, self._sample, duration_s)
        # After the result has gone out: writing to disk must not delay it.
        self._node_io.create_task(self._finish, task, verdict, duration_s)
        return result

    def _finish(self, task: GraspTask, verdict: GraspVerdict, duration_s: float) -> None:
        """Write down what came of the grasp; only then it is known whether the tendons go on holding something."""
        try:
            self._cell.end_grasp(task, verdict, duration_s)
        finally:
            self._is_active = False

    async def _owned(self, goal_handle: _Handle) -> str:
        """Become the owner of the tendons; returns why not."""
        owned: Future[str] = Future()
        self._driver.lease.acquire(owned.set_result)
        denied = await self._node_io.wait_for("lease", owned)
        if goal_handle.is_cancel_requested:
            return "cancelled by the client before anything moved"
        return f"refused: {denied}" if denied else ""

    def _refused(self, goal_handle: _Handle, reason: str) -> Grasp.Result:
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return convert.grasp_result(GraspVerdict(GraspOutcome.ABORTED, reason, 0.0), self._sample, 0.0)

    def _cancel(self, _goal_handle: _Handle) -> CancelResponse:
        self._node_io.create_task(self.abort, "cancelled by the client; the fingers stay where they are")
        return CancelResponse.ACCEPT

    def _do(self, step: GraspStep) -> None:
        for command in step.commands:
            self._driver.run(command, self._closing_ended if isinstance(command, Close) else self._movement_ended)
        changed = (step.phase, step.contact) != (self._step.phase, self._step.contact)
        self._step = step
        if changed and step.verdict is None and self._goal is not None:
            self._goal.publish_feedback(convert.grasp_feedback(step, self._sample))
        if step.verdict is not None and self._done is not None:
            done, self._sequence, self._goal, self._done = self._done, None, None, None
            done.set_result(step.verdict)

    def _closing_ended(self, end: MoveEnd) -> None:
        if self._sequence is not None and end.is_good:
            self._sequence.closing_ended()
        else:
            self._movement_ended(end)

    def _movement_ended(self, end: MoveEnd) -> None:
        if self._sequence is None or end.is_good:
            return
        if end.outcome == MoveTendon.Result.FAULT:
            stamp_ns = self._sample.stamp_ns if self._sample else 0
            self._do(self._sequence.fault(TendonFault("(see reason)", "movement failed", end.reason), stamp_ns))
        else:
            self._do(self._sequence.abort(f"the driver did not move: {end.reason}"))
