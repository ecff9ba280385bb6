# SPDX-License-Identifier: Apache-2.0
"""From the messages of a bag to its `Story`."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

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
#: Modes in which something may be between the fingers.
_BUSY = {"GRASPING", "HOLDING"}
_ERROR = 2  # diagnostic_msgs/DiagnosticStatus.ERROR

Tip = tuple[int, float, tuple[float, float]]  # stamp [ns], pulled length [m], tip [m]


class _Reader:
    """Takes messages one by one."""

    def __init__(self, cell: str) -> None:
        self._cell = cell
        self.story = Story()
        self._mode = ""
        self._faults: dict[tuple[str, str], str] = {}
        self.measured: dict[tuple[str, str], list[Tip]] = defaultdict(list)
        self.predicted: dict[tuple[str, str], list[Tip]] = defaultdict(list)
        self.errors: dict[str, list[tuple[int, float]]] = defaultdict(list)

    def read_message(self, raw: RawMessage, message: Any) -> None:
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
        if self._mode not in _BUSY:
            self._tips(message, self.measured)

    def _finger_predicted(self, _: int, message: FingerStates) -> None:
        self._tips(message, self.predicted)

    def _tips(self, message: FingerStates, into: dict[tuple[str, str], list[Tip]]) -> None:
        stamp = stamp_of(message)
        for finger in message.fingers:
            if finger.validity != finger.FAILED:
                tip = (float(finger.tip.x), float(finger.tip.y))
                into[finger.profile, finger.finger].append((stamp, float(finger.pulled_length), tip))

    def _finger_residual(self, _: int, message: PredictionResidual) -> None:
        if self._mode not in _BUSY:
            self.errors[message.finger].append((stamp_of(message), float(message.tip_error_percent)))

    def _tendon_status(self, time: int, message: TendonStatusArray) -> None:
        for tendon in message.tendons:
            self._fault(time, "tendon/status", tendon.tendon, tendon.fault, tendon.reason)
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
        expected = reader.predicted.get((profile, finger), [])
        stamps = [stamp for stamp, _, _ in expected]
        pairs = []
        for stamp, _, tip in seen:
            at = bisect_left(stamps, stamp)
            nearest = min(
                (i for i in (at - 1, at) if 0 <= i < len(stamps)), key=lambda i: abs(stamps[i] - stamp), default=-1
            )
            if nearest >= 0 and abs(stamps[nearest] - stamp) <= _TOGETHER:
                pairs.append((expected[nearest][1], tip, expected[nearest][2]))
        if not pairs:
            continue
        own = {stamp for stamp, _, _ in seen}
        errors = [error for stamp, error in reader.errors[finger] if stamp in own and np.isfinite(error)]
        pulled, measured, predicted = zip(*pairs, strict=True)
        found.append(
            RecordedClosing(
                profile, finger, np.array(pulled), np.array(measured), np.array(predicted), np.array(errors)
            )
        )
    return found


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


def _constant(kind: Any, value: int, names: set[str] | None = None) -> str:
    """Return the name of a message's constant."""
    for name in dir(kind):
        if name.isupper() and getattr(kind, name) == value and (names is None or name in names):
            return name
    return str(value)
