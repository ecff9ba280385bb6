# SPDX-License-Identifier: Apache-2.0
"""From the messages of a bag to its `Story`."""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from softgrip_bag.closings import FingerFrame, free_closings
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import message_class, stamp_of, tree
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.trace import TraceStep, stretches
from softgrip_bag.reader import RawMessage
from softgrip_bag.story import (
    RecordedClosing,
    RecordedFault,
    RecordedFit,
    RecordedGrasp,
    RecordedMode,
    RecordedSample,
    Story,
)
from softgrip_interfaces.action import Grasp as GraspAction
from softgrip_interfaces.msg import (
    CellState,
    FingerEvidence,
    FingerStates,
    FrictionModel,
    FrictionSample,
    GraspEvidence,
    PredictionResidual,
    TendonStatusArray,
)
from softgrip_nodekit import nanoseconds

#: What the story is told from: topic -> type. Topics of that name and another type are left out.
_READ = {
    "/cell/state": "softgrip_interfaces/msg/CellState",
    "/friction/active": "softgrip_interfaces/msg/FrictionModel",
    "/rig/sample": "softgrip_interfaces/msg/FrictionSample",
    "/finger/measured": "softgrip_interfaces/msg/FingerStates",
    "/finger/predicted": "softgrip_interfaces/msg/FingerStates",
    "/finger/residual": "softgrip_interfaces/msg/PredictionResidual",
    "/tendon/status": "softgrip_interfaces/msg/TendonStatusArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
#: What all cells of a domain publish under one name.
_SHARED = {"/diagnostics"}
_TRACE = "/grasp_mix_manager/trace"
_UUID = 16
#: [ns] a camera frame and a prediction of the same instant are at most so far apart.
_TOGETHER = 20_000_000
#: Modes in which something may be between the fingers, or they do not do what they are told.
_BUSY = {"GRASPING", "HOLDING", "FAULT", "ESTOP"}
_ERROR = 2  # diagnostic_msgs/DiagnosticStatus.ERROR


@dataclass(frozen=True)
class _State:
    """One finger of a message: stamp [ns], pulled length [m], tip [m], joint angles [rad]."""

    stamp: int
    pulled_m: float
    tip: tuple[float, float]
    angles: tuple[float, ...]
    can_close: bool


_NOTHING = _State(0, math.nan, (math.nan, math.nan), (), can_close=False)


class _Reader:
    """Takes messages one by one."""

    def __init__(self, cell: str) -> None:
        self._cell = cell
        self.story = Story()
        self._mode = ""
        self._faults: dict[tuple[str, str], str] = {}
        self._unfit: set[str] = set()  # tendons without a zero, or with a fault
        self.measured: dict[tuple[str, str], list[_State]] = defaultdict(list)
        self.predicted: dict[tuple[str, str], list[_State]] = defaultdict(list)
        # of each residual by its stamp: pulled length [m] at that instant, tip error [%]
        self.residuals: dict[str, dict[int, tuple[float, float]]] = defaultdict(dict)

    def read_message(self, raw: RawMessage, message: object) -> None:
        name = raw.topic.removeprefix(self._cell).strip("/").replace("/", "_")
        getattr(self, f"_{name}")(raw.received, message)

    def _cell_state(self, time: int, message: CellState) -> None:
        mode = _constant(CellState, message.mode)
        self._mode = mode
        reason = message.fault or message.reason
        self.story.modes.append(RecordedMode(time, mode, message.finger_set, message.product, reason))

    def _friction_active(self, time: int, message: FrictionModel) -> None:
        fit = RecordedFit(
            time=time,
            id=message.id,
            law=message.law,
            k_reading=message.k_reading,
            coefficients=dict(zip(message.coefficient_names, map(float, message.coefficients), strict=False)),
            radius_mm=1e3 * (message.cable_radius + message.surface_radius),
            average_error=message.average_error,
            maximum_error=message.maximum_error,
            r_squared=message.r_squared,
            points=message.points,
            verdict=_constant(FrictionModel, message.verdict, {"UNSET", "USABLE", "REPEAT_POINTS", "DO_NOT_USE"}),
        )
        if not self.story.fits or self.story.fits[-1].id != fit.id:
            self.story.fits.append(fit)

    def _rig_sample(self, time: int, message: FrictionSample) -> None:
        accepted = message.verdict == FrictionSample.ACCEPTED
        self.story.samples.append(
            RecordedSample(time, message.angle, message.tension_high, message.tension_low, accepted=accepted)
        )

    def _finger_measured(self, _: int, message: FingerStates) -> None:
        self._states(message, self.measured)

    def _finger_predicted(self, _: int, message: FingerStates) -> None:
        self._states(message, self.predicted)

    def _states(self, message: FingerStates, into: dict[tuple[str, str], list[_State]]) -> None:
        stamp = stamp_of(message)
        for finger in message.fingers:
            if finger.validity != finger.FAILED:
                can_close = self._mode not in _BUSY and finger.finger not in self._unfit
                tip = (float(finger.tip.x), float(finger.tip.y))
                state = _State(
                    stamp, float(finger.pulled_length), tip, tuple(map(float, finger.joint_angles)), can_close
                )
                into[finger.profile, finger.finger].append(state)

    def _finger_residual(self, _: int, message: PredictionResidual) -> None:
        residual = (float(message.pulled_length), float(message.tip_error_percent))
        self.residuals[message.finger][stamp_of(message)] = residual

    def _tendon_status(self, time: int, message: TendonStatusArray) -> None:
        for tendon in message.tendons:
            self._fault(time, "tendon/status", tendon.tendon, tendon.fault, tendon.reason)
        self._unfit = {one.tendon for one in message.tendons if one.fault or not one.homed or one.state == one.HOMING}
        self._fault(time, "tendon/status", "all", "estop" if message.estop else "", "the emergency stop is latched")

    def _diagnostics(self, time: int, message: DiagnosticArray) -> None:
        for status in message.status:
            bad = status.level[0] == _ERROR
            self._fault(time, "diagnostics", status.name, status.name if bad else "", status.message)

    def _fault(self, time: int, source: str, of: str, name: str, text: str) -> None:
        before = self._faults.get((source, of), "")
        self._faults[source, of] = name
        if name and name != before:
            shown = f"{of}: {name}" if name != of else name
            self.story.faults.append(RecordedFault(time, source, shown, text))


def digest(bag: Path) -> Story:
    """Return what happened in a bag.

    Raises:
        BagError: no bag, or no MCAP.
    """
    recorded = RecordedBag(bag)
    reader = _Reader(recorded.cell)
    topics = {topic if topic in _SHARED else recorded.cell + topic: kind for topic, kind in _READ.items()}
    for raw in recorded.read({topic for topic, kind in topics.items() if recorded.types.get(topic) == kind}):
        reader.read_message(raw, deserialize_message(raw.data, message_class(raw.type_name)))
    story = reader.story
    story.closings.extend(_closings(reader))
    if recorded.types.get(recorded.cell + _TRACE) == "softgrip_interfaces/msg/NodeTrace":
        story.grasps.extend(_grasps(recorded))
    return story


def _closings(reader: _Reader) -> list[RecordedClosing]:
    found = []
    for (profile, finger), seen in sorted(reader.measured.items()):
        residuals = reader.residuals[finger]
        pulled = {stamp: length for stamp, (length, _) in residuals.items()}
        runs = free_closings(_frames(seen, reader.predicted.get((profile, finger), []), pulled))
        frames = [frame for run in runs for frame in run]
        if not frames:
            continue
        joints = max(len(frame.predicted_angles) for frame in frames)
        errors = [residuals[frame.stamp][1] for frame in frames if frame.stamp in residuals]
        found.append(
            RecordedClosing(
                profile,
                finger,
                run=np.repeat(np.arange(len(runs)), [len(run) for run in runs]),
                pulled=np.array([frame.pulled_m for frame in frames]),
                measured=np.array([frame.measured_tip for frame in frames]),
                predicted=np.array([frame.predicted_tip for frame in frames]),
                measured_angles=_angles((frame.measured_angles for frame in frames), joints),
                predicted_angles=_angles((frame.predicted_angles for frame in frames), joints),
                error_percent=np.array([error for error in errors if np.isfinite(error)]),
            )
        )
    return found


def _frames(seen: Sequence[_State], expected: Sequence[_State], pulled: Mapping[int, float]) -> list[FingerFrame]:
    """Return what was seen with the prediction of the same instant, NaN where only its residual is recorded.

    Args:
        seen: of one finger, in the order of their stamps.
        expected: the same.
        pulled: stamp -> pulled length [m] of each residual; the prediction's stands in elsewhere.
    """
    stamps = [one.stamp for one in expected]
    frames = []
    for state in seen:
        at = bisect_left(stamps, state.stamp)
        beside = [expected[i] for i in (at - 1, at) if 0 <= i < len(stamps)]
        nearest = min(beside, key=lambda one: abs(one.stamp - state.stamp), default=_NOTHING)
        predicted = nearest if abs(nearest.stamp - state.stamp) <= _TOGETHER else _NOTHING
        length = pulled.get(state.stamp, predicted.pulled_m)
        if np.isfinite(length):
            tips, angles = (state.tip, predicted.tip), (state.angles, predicted.angles)
            frames.append(FingerFrame(state.stamp, length, *tips, *angles, state.can_close))
    return frames


def _angles(rows: Iterable[tuple[float, ...]], joints: int) -> NDArray[np.float64]:
    """Return (n, joints) [rad]; a row of another length says nothing about the joints."""
    return np.array([row if len(row) == joints else (np.nan,) * joints for row in rows]).reshape(-1, joints)


def _grasps(bag: RecordedBag) -> list[RecordedGrasp]:
    """Return the grasps that ended in the bag; the product is empty where the bag began after the order."""
    found = []
    try:
        for steps in stretches(bag, bag.cell + _TRACE):
            product = ""
            for step in steps:
                if step.name == f"goal {bag.cell}/cell/grasp":
                    product = deserialize_message(step.data[_UUID:], GraspAction.Goal).product
                elif step.name == f"finished {bag.cell}/cell/grasp":
                    found.append(grasp_result(step, product))
    except BagError:
        return found  # what is there before a step that nobody can read
    return found


def grasp_result(step: TraceStep, product: str) -> RecordedGrasp:
    """Return how a grasp ended, of the trace's step that says so."""
    result = deserialize_message(step.data, GraspAction.Result)
    outcome = _constant(GraspAction.Result, result.outcome)
    evidence = _evidence(result.decision)
    return RecordedGrasp(step.time_ns, product, outcome, result.reason, result.latency, result.duration, evidence)


def _evidence(decision: GraspEvidence) -> str:
    """Return the numbers behind a decision as JSON."""
    fingers = [
        {name: None if value != value else value for name, value in tree(finger).items()}  # noqa: PLR0124  NaN: unseen
        | {"state": _constant(FingerEvidence, finger.state)}
        for finger in decision.fingers
    ]
    phase = _constant(GraspEvidence, decision.phase)
    return json.dumps({"stamp_ns": nanoseconds(decision.stamp), "phase": phase, "fingers": fingers})


def _constant(kind: type[object], value: int, names: set[str] | None = None) -> str:
    """Return the name of a message's constant."""
    for name in dir(kind):
        if name.isupper() and getattr(kind, name) == value and (names is None or name in names):
            return name
    return str(value)
