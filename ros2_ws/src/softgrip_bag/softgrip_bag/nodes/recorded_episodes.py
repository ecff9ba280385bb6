# SPDX-License-Identifier: Apache-2.0
"""From a bag to its episodes: grasps and demonstrations.

The manager's trace says when a grasp began and what it commanded, teleoperation/state the same of a demonstration.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from softgrip_bag.episode import Episode, StampedSeries, TendonCommand, commanded
from softgrip_bag.nodes.digest import grasp_result
from softgrip_bag.nodes.messages import message_class, stamp_of
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.trace import TraceStep, stretches
from softgrip_interfaces.action import Grasp as GraspAction
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import TeleoperationState
from softgrip_time.units import NANOSECONDS

_TRACE, _TELEOPERATION = "/grasp_mix_manager/trace", "/teleoperation/state"
_STATE, _MODE = "/tendon/state", "/cell/state"
_PREDICTED, _MEASURED, _IMAGE = "/finger/predicted", "/finger/measured", "/camera/image_raw/compressed"
#: Bytes of the goal's id, which stands before a goal in the trace.
_GOAL_ID_BYTES = 16
#: Outcome of a demonstration by its last phase; any other phase is ABORTED.
_OUTCOMES = {TeleoperationState.SUCCEEDED: "SUCCEEDED", TeleoperationState.FAILED: "FAILED"}
#: Pulled length that stands for "to its tension" in a command without a length [m]: the longest (thesis: 20 mm).
FULL_LENGTH_M = 0.020


@dataclass
class _Topics:
    """What a bag holds of each topic, as (stamp [ns], values) in the order of reception.

    Attributes:
        tendons: n names.
        states: pulled lengths [m], then tensions [N]: 2 n values.
        predicted, measured: joint angles [rad], finger after finger.
        images: as compressed.
        finger_sets: mounted set, with the time of reception.
    """

    tendons: tuple[str, ...] = ()
    states: list[tuple[int, list[float]]] = field(default_factory=list)
    predicted: list[tuple[int, list[float]]] = field(default_factory=list)
    measured: list[tuple[int, list[float]]] = field(default_factory=list)
    images: list[tuple[int, bytes]] = field(default_factory=list)
    finger_sets: list[tuple[int, str]] = field(default_factory=list)

    def finger_set(self, time_ns: int) -> str:
        """Return what was mounted at a time, empty where nobody said."""
        return next((one for time, one in reversed(self.finger_sets) if time <= time_ns), "")


@dataclass(frozen=True)
class _Span:
    """An episode before it is cut into frames: when it began and ended, what was commanded and how it ended."""

    begun_ns: int
    ended_ns: int
    commands: tuple[TendonCommand, ...]
    task: str
    product: str
    outcome: str
    reason: str
    evidence: str


def recorded_episodes(path: Path, rate_hz: int) -> list[Episode]:
    """Return the grasps of a bag that moved a tendon, then its demonstrations, each in their order.

    Args:
        path: of the bag.
        rate_hz: of the frames.

    Raises:
        BagError: no bag.
    """
    bag = RecordedBag(path)
    if bag.cell + _STATE not in bag.types:
        return []
    topics = _read(bag)
    spans = [*_grasps(bag, topics), *_demonstrations(bag, topics)]
    return [_episode(path, span, topics, rate_hz) for span in spans if span.commands and topics.states]


def _read(bag: RecordedBag) -> _Topics:
    found = _Topics()
    names = {bag.cell + topic for topic in (_STATE, _MODE, _PREDICTED, _MEASURED, _IMAGE)}
    for raw in bag.read(names & set(bag.types)):
        message = deserialize_message(raw.data, message_class(raw.type_name))
        stamp = stamp_of(message)
        topic = raw.topic.removeprefix(bag.cell)
        if topic == _STATE:
            found.tendons = found.tendons or tuple(message.name)
            found.states.append((stamp, [*message.position, *message.effort]))
        elif topic == _MODE:
            found.finger_sets.append((raw.received, str(message.finger_set)))
        elif topic == _IMAGE:
            found.images.append((stamp, bytes(message.data)))
        else:
            angles = [angle for finger in message.fingers for angle in finger.joint_angles]
            (found.predicted if topic == _PREDICTED else found.measured).append((stamp, angles))
    return found


def _grasps(bag: RecordedBag, topics: _Topics) -> Iterator[_Span]:
    if bag.cell + _TRACE in bag.types:
        for steps in stretches(bag, bag.cell + _TRACE):
            yield from _grasps_of(bag, steps, topics)


def _grasps_of(bag: RecordedBag, steps: Sequence[TraceStep], topics: _Topics) -> Iterator[_Span]:
    product, begun_ns = "", 0
    moves: list[tuple[int, MoveTendon.Goal]] = []
    for step in steps:
        name = step.name.replace(f" {bag.cell}/", " /", 1)
        if name == "goal /cell/grasp":
            product, begun_ns = deserialize_message(step.data[_GOAL_ID_BYTES:], GraspAction.Goal).product, step.time_ns
            moves = []
        elif name == "sent /tendon/move":
            moves.append((step.time_ns, deserialize_message(step.data, MoveTendon.Goal)))
        elif name == "finished /cell/grasp" and begun_ns:  # else the bag began in the middle of the grasp
            result = grasp_result(step, product)
            fingers = topics.finger_set(step.time_ns) or "mounted"
            task = f"Grasp the {product.replace('_', ' ')} with the {fingers} fingers and lift it"
            commands = tuple(_commands(moves, topics.tendons))
            yield _Span(begun_ns, step.time_ns, commands, task, product, result.outcome, result.reason, result.evidence)
            moves = []


def _demonstrations(bag: RecordedBag, topics: _Topics) -> Iterator[_Span]:
    """Yield what people showed: from the first frame of a demonstration to the one that ends it."""
    if bag.cell + _TELEOPERATION not in bag.types:
        return
    frames: list[TeleoperationState] = []
    for raw in bag.read({bag.cell + _TELEOPERATION}):
        frame = deserialize_message(raw.data, TeleoperationState)
        if frames and (frame.episode, frame.phase) != (frames[0].episode, TeleoperationState.RUNNING):
            yield _demonstration(frames, frame if frame.episode == frames[0].episode else None, topics)
            frames = []
        if frame.phase == TeleoperationState.RUNNING:
            frames.append(frame)
    if frames:  # the bag ends before the demonstration
        yield _demonstration(frames, None, topics)


def _demonstration(frames: Sequence[TeleoperationState], last: TeleoperationState | None, topics: _Topics) -> _Span:
    """Return a demonstration from its running frames and the one that ended it, None where the bag ends before."""
    first, end = frames[0], last or frames[-1]
    outcome = _OUTCOMES.get(end.phase, "ABORTED") if last is not None else "ABORTED"
    commands = []
    before = list(first.targets)
    for frame in frames:
        for name, target, begun in zip(frame.tendons, frame.targets, before, strict=True):
            if frame.duration > 0.0 and name in topics.tendons:
                speed = abs(target - begun) / frame.duration
                tendon = topics.tendons.index(name)
                commands.append(TendonCommand(stamp_of(frame), tendon, target, speed, frame.tension_limit))
        before = list(frame.targets)
    reason = "" if last is not None else "the bag ends before the demonstration"
    return _Span(stamp_of(first), stamp_of(end), tuple(commands), first.task, "", outcome, reason, "")


def _episode(path: Path, span: _Span, topics: _Topics, rate_hz: int) -> Episode:
    """Cut a span into frames of one rate: each shows what was known at its time."""
    states = _series(topics.states)
    count = len(topics.tendons)
    first_ns = next((stamp for stamp in states.stamps_ns if stamp >= span.begun_ns), states.stamps_ns[-1])
    period_ns = round(NANOSECONDS / rate_hz)
    frames = max(1, (span.ended_ns - first_ns) // period_ns + 1)
    times_ns = first_ns + period_ns * np.arange(frames, dtype=np.int64)
    values, stamps = states.at(times_ns.tolist())
    lengths_m, tensions_n = values[:, :count], values[:, count:]
    length_m, tension_n = commanded(span.commands, times_ns.tolist(), lengths_m, FULL_LENGTH_M)
    predicted, _ = _series(topics.predicted).at(times_ns.tolist())
    measured, measured_stamps = _series(topics.measured).at(times_ns.tolist())
    images, image_stamps = _images(topics.images, times_ns.tolist())
    return Episode(
        bag=path.name,
        task=span.task,
        product=span.product,
        finger_set=topics.finger_set(span.ended_ns),
        outcome=span.outcome,
        reason=span.reason,
        evidence=span.evidence,
        tendons=topics.tendons,
        times_ns=times_ns,
        state_stamps_ns=stamps,
        lengths_m=lengths_m,
        tensions_n=tensions_n,
        commanded_lengths_m=length_m,
        commanded_tensions_n=tension_n,
        predicted_rad=np.nan_to_num(predicted),
        measured_rad=np.nan_to_num(measured),
        measured_stamps_ns=measured_stamps,
        images=images,
        image_stamps_ns=image_stamps,
    )


def _series(found: Sequence[tuple[int, list[float]]]) -> StampedSeries:
    """Return what a topic held; messages with other counts than most are left out."""
    by_count: dict[int, list[tuple[int, list[float]]]] = defaultdict(list)
    for stamp, values in sorted(found, key=lambda one: one[0]):
        by_count[len(values)].append((stamp, values))
    rows = max(by_count.values(), key=len, default=[])
    table = np.array([values for _, values in rows], float).reshape(len(rows), len(rows[0][1]) if rows else 0)
    return StampedSeries(tuple(stamp for stamp, _ in rows), table)


def _images(found: Sequence[tuple[int, bytes]], times_ns: Sequence[int]) -> tuple[tuple[bytes, ...], NDArray[np.int64]]:
    """Return the last image at or before each time; before the first one, that one with its later stamp."""
    if not found:
        return (), np.zeros(0, np.int64)
    ordered = sorted(found, key=lambda one: one[0])
    numbers, _ = StampedSeries(tuple(s for s, _ in ordered), np.arange(len(ordered), dtype=float)[:, None]).at(times_ns)
    chosen = [ordered[int(number)] for number in numbers[:, 0]]
    return tuple(data for _, data in chosen), np.array([stamp for stamp, _ in chosen], np.int64)


def _commands(moves: Sequence[tuple[int, MoveTendon.Goal]], tendons: Sequence[str]) -> list[TendonCommand]:
    """Return the moves tendon by tendon; without a length (NaN) where a move goes to a tension."""
    made = []
    for time_ns, goal in moves:
        names = list(goal.tendons) or list(tendons)
        targets = list(goal.targets) * (len(names) if len(goal.targets) == 1 else 1)
        for name, target in zip(names, targets, strict=True):
            is_length = goal.mode == MoveTendon.Goal.LENGTH
            made.append(
                TendonCommand(
                    time_ns,
                    tendons.index(name),
                    float(target) if is_length else math.nan,
                    float(goal.speed),
                    float(goal.tension_limit) if is_length else float(target),
                )
            )
    return made
