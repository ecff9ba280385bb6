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
    """Of a grasp; NONE is a closing that is no grasp, such as one finger curling alone."""

    POWER = "power"
    PINCH = "pinch"
    HOOK = "hook"
    NONE = "none"


@dataclass(frozen=True)
class GraspLimits:
    """Where one thing ends and another begins; two values are for entering and leaving.

    Attributes:
        curled_rad: sum of a finger's joint angles.
        touching: thumb tip to fingertip [palm lengths]; landmarks lie inside the flesh, so touching is not 0.
        many: so many curled fingers make a power grasp or a hook.
        proximal_share: of the knuckle in the flexion of the curled fingers; below it is a hook.
        least_s: a shorter closure is no motion.
        still: a motion begins after the hand nears the closed pose with less than this share of its greatest speed
        still_s: for this long,
        arrival: and ends where only this share of the way is left.
        before_s: how far before the closure the beginning is looked for.
    """

    curled_rad: tuple[float, float] = (math.radians(130.0), math.radians(110.0))
    touching: tuple[float, float] = (0.42, 0.52)
    many: int = 3
    proximal_share: float = 0.2
    min_s: float = 0.2
    still: float = 0.1
    still_s: float = 0.1
    arrival: float = 0.05
    before_s: float = 1.0


@dataclass(frozen=True, eq=False)
class DetectedGrasp:
    """A motion from open to closed.

    Attributes:
        kind: of grasp.
        start_s: [s] open.
        end_s: [s] closed.
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
    """
    chosen = limits or GraspLimits()
    curled = np.stack(
        [_hysteresis(motion.angles[finger].sum(axis=1), *chosen.curled_rad) for finger in LONG_FINGERS], axis=1
    )
    touching = np.stack([_hysteresis(-gap, *(-limit for limit in chosen.touching)) for gap in motion.gap.T], axis=1)
    closed = np.asarray(curled.any(axis=1) | touching.any(axis=1))
    period = float(np.median(np.diff(motion.times)))
    found, earliest = [], 0
    for begin, end in runs(closed):
        if (end - begin) * period >= chosen.min_s:
            stretch = _closing(motion, earliest, begin, end, chosen)
            if stretch is not None:
                found.append(_grasp(motion, *stretch, curled, origin, chosen))
        earliest = end
    return found


def _hysteresis(values: Array, enter: float, leave: float) -> Flags:
    """Return where values have risen above `enter` and not yet fallen below `leave`; gaps are outside."""
    inside, flags = False, np.zeros(len(values), dtype=np.bool_)
    for index, value in enumerate(values):
        inside = bool(value > (leave if inside else enter))
        flags[index] = inside
    return flags


def _closing(
    motion: RecordedMotion, earliest: int, begin: int, end: int, limits: GraspLimits
) -> tuple[int, int] | None:
    """Return first and last sample of the way into the closure [begin, end), None where its beginning is unknown."""
    period = float(np.median(np.diff(motion.times)))
    first = max(earliest, begin - round(limits.before_s / period))
    unknown = np.flatnonzero(~motion.known[first:begin])
    if len(unknown):
        first += int(unknown[-1]) + 1
    if begin - first < 2:
        return None
    pose = np.hstack([motion.angles[finger] for finger in motion.angles])
    away = np.linalg.norm(pose[first:end] - np.median(pose[begin:end], axis=0), axis=1)
    speed = -np.gradient(away[: begin - first + 1])
    quick = speed > limits.still * speed.max()
    still = [(a, b) for a, b in runs(~quick) if (b - a) * period >= limits.still_s and b < len(quick)]
    start = still[-1][1] - 1 if still else 0
    # a hand that trembles while closed may never come nearer than this
    near = max(limits.arrival * away[start], float(away[begin - first :].min()))
    return first + start, begin + int(np.flatnonzero(away[begin - first :] <= near)[0])


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
    if len(curled) >= limits.many:
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
        f"{count} (a grasp has {limits.many} or more), {meets} (a pinch has less than {limits.touching[1]:.2f})",
    )
