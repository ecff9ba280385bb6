# SPDX-License-Identifier: Apache-2.0
"""Grasp motions in a recording, and of which kind each is, with the numbers that decided it.

A hand counts as closed while a long finger is curled or a fingertip meets the thumb. What leads there, from the open
pose on, is a motion. Kinds as in section 4.3.1: in a power grasp all joints of the fingers flex together, in a hook the
proximal joints hardly do, in a pinch a finger meets the thumb while the others stay open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_design.capture.recording import LONG_FINGERS, RecordedMotion, runs
from softgrip_design.trajectory import FingerTrajectory

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Kind(StrEnum):
    """Kind of a closing; NONE is no grasp, such as one finger curling alone."""

    POWER = "power"
    PINCH = "pinch"
    HOOK = "hook"
    NONE = "none"


@dataclass(frozen=True)
class GraspLimits:
    """What counts as closed, as a motion, as which kind of grasp: assumptions, checked on recordings (docs/design.md).

    A pair is a hysteresis: where the state begins, and where it ends.

    Attributes:
        curled_rad: sum of a finger's joint angles, above.
        touching: distance from thumb tip to fingertip, below [palm lengths]; landmarks lie inside the flesh.
        min_curled: curled fingers of a power grasp or a hook.
        proximal_share: of the knuckles in the flexion of the curled fingers; a hook has less.
        min_s: shortest closure.
        still_share, still_s: the open hand stands still while it nears the closed pose with less than this share of its
            greatest speed, for at least this long; the motion begins when that ends.
        arrival_share: of the way; the motion ends where less of it is left.
        before_s: longest motion before the closure.
    """

    curled_rad: tuple[float, float] = (math.radians(130.0), math.radians(110.0))
    touching: tuple[float, float] = (0.42, 0.52)
    min_curled: int = 3
    proximal_share: float = 0.2
    min_s: float = 0.2
    still_share: float = 0.1
    still_s: float = 0.1
    arrival_share: float = 0.05
    before_s: float = 1.0


@dataclass(frozen=True, eq=False)
class DetectedGrasp:
    """A motion from open to closed.

    Attributes:
        start_s, end_s: of the motion: last time open, first time closed.
        trajectory: all fingers from start to end.
        curled: fingers that are curled when closed.
        proximal_share: mean over the curled fingers, of the flexion since the start; NaN where none is curled.
        touching: finger next to the thumb when closed, and its distance in palm lengths.
        flexion_rad: finger -> flexion since the start.
        why: the kind in words.
    """

    kind: Kind
    start_s: float
    end_s: float
    trajectory: FingerTrajectory
    curled: tuple[str, ...]
    proximal_share: float
    touching: tuple[str, float]
    flexion_rad: Mapping[str, float]
    why: str


def find_grasps(
    motion: RecordedMotion, origin: Mapping[str, str], limits: GraspLimits | None = None
) -> list[DetectedGrasp]:
    """Return every motion that closes the hand, in order.

    A closure that begins before the recording does, or right after a gap, has no open pose and is left out.

    Args:
        motion: n samples of one rate, of f long fingers.
        origin: written into the trajectories.
        limits: what counts as closed, as a motion and as which kind.
    """
    chosen = limits or GraspLimits()
    curled = np.stack(  # (n, f)
        [_hysteresis(motion.angles[finger].sum(axis=1), *chosen.curled_rad) for finger in LONG_FINGERS], axis=1
    )
    touching = np.stack([_hysteresis(-gap, *(-limit for limit in chosen.touching)) for gap in motion.gap.T], axis=1)
    closed = np.asarray(curled.any(axis=1) | touching.any(axis=1))
    period = float(np.median(np.diff(motion.times)))
    found, earliest = [], 0
    for begin, end in runs(closed):
        if (end - begin) * period >= chosen.min_s:
            motion_ends = _motion_into(motion, earliest, begin, end, chosen)
            if motion_ends is not None:
                found.append(_grasp(motion, *motion_ends, curled, origin, chosen))
        earliest = end
    return found


def _hysteresis(values: Array, enter: float, leave: float) -> Flags:
    """Return where values have risen above `enter` and not yet fallen below `leave`; gaps are outside."""
    inside, flags = False, np.zeros(len(values), dtype=np.bool_)
    for index, value in enumerate(values):
        inside = bool(value > (leave if inside else enter))
        flags[index] = inside
    return flags


def _motion_into(
    motion: RecordedMotion, earliest: int, begin: int, end: int, limits: GraspLimits
) -> tuple[int, int] | None:
    """Return first and last sample of the motion into the closure [begin, end), None where its beginning is unknown.

    It does not begin before `earliest`, the end of the closure before.
    """
    period = float(np.median(np.diff(motion.times)))
    first = max(earliest, begin - round(limits.before_s / period))
    unknown = np.flatnonzero(~motion.known[first:begin])
    if len(unknown):
        first += int(unknown[-1]) + 1
    if begin - first < 2:
        return None
    pose = np.hstack([motion.angles[finger] for finger in motion.angles])
    distance = np.linalg.norm(pose[first:end] - np.median(pose[begin:end], axis=0), axis=1)  # to the closed pose [rad]
    speed = -np.gradient(distance[: begin - first + 1])
    moves = speed > limits.still_share * speed.max()
    still = [(a, b) for a, b in runs(~moves) if (b - a) * period >= limits.still_s and b < len(moves)]
    start = still[-1][1] - 1 if still else 0
    closed = distance[begin - first :]
    # A hand that trembles while closed may never come nearer than its nearest.
    arrived = max(limits.arrival_share * distance[start], float(closed.min()))
    return first + start, begin + int(np.flatnonzero(closed <= arrived)[0])


def _grasp(
    motion: RecordedMotion, start: int, last: int, curled: Flags, origin: Mapping[str, str], limits: GraspLimits
) -> DetectedGrasp:
    flexed = {finger: angles[last] - angles[start] for finger, angles in motion.angles.items()}
    names = tuple(finger for i, finger in enumerate(LONG_FINGERS) if curled[last, i])
    shares = [flexed[finger][0] / flexed[finger].sum() for finger in names]
    share = float(np.mean(shares)) if shares else math.nan
    nearest = int(motion.gap[last].argmin())
    touching = LONG_FINGERS[nearest], float(motion.gap[last, nearest])
    kind, why = _classify(names, share, touching, limits)
    about = {
        "motion": f"{kind}: {why}",
        **origin,
        "part": f"{motion.times[start]:.3f} s to {motion.times[last]:.3f} s",
        "columns": "time [s]; flexion of each joint [rad], j0 at the base; smoothed",
    }
    return DetectedGrasp(
        kind=kind,
        start_s=float(motion.times[start]),
        end_s=float(motion.times[last]),
        trajectory=FingerTrajectory(
            motion.times[start : last + 1] - motion.times[start],
            {finger: angles[start : last + 1] for finger, angles in motion.angles.items()},
            about,
        ),
        curled=names,
        proximal_share=share,
        touching=touching,
        flexion_rad={finger: float(by_joint.sum()) for finger, by_joint in flexed.items()},
        why=why,
    )


def _classify(
    curled: tuple[str, ...], share: float, touching: tuple[str, float], limits: GraspLimits
) -> tuple[Kind, str]:
    """Return the kind of a closed pose and the numbers that make it so."""
    count = f"{len(curled)} of {len(LONG_FINGERS)} fingers curled"
    if len(curled) >= limits.min_curled:
        part = f"{count}, knuckles took {100 * share:.0f} % of their flexion"
        if share < limits.proximal_share:
            return Kind.HOOK, f"{part} (less than {100 * limits.proximal_share:.0f} %)"
        return Kind.POWER, f"{part} ({100 * limits.proximal_share:.0f} % or more)"
    finger, gap = touching
    meets = f"{finger} tip {gap:.2f} palm lengths from the thumb's"
    if gap < limits.touching[1]:
        return Kind.PINCH, f"{meets} (less than {limits.touching[1]:.2f}), {count}"
    return (
        Kind.NONE,
        f"{count} (a grasp has {limits.min_curled} or more), {meets} (a pinch has less than {limits.touching[1]:.2f})",
    )
