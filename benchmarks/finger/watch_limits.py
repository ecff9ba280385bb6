# SPDX-License-Identifier: Apache-2.0
"""Which of the 25 changes of `watch_causes` the sensors can tell from another cause at all, by one finger's closings.

Everything is known here: the true finger and all noise. A change is told from the wrong cause that fits it best when
what that cause leaves is large beside the noise of the means of 12 closings and of 12 before. Printed are those
distances in standard deviations: two equally likely causes are told apart in 90 % of cases from 2.6 on.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable

import numpy as np
from _changed_finger import PULLS_MM, SCATTER_MM, SETS, TENSION, TIP_MM, WANDER, HingedFinger, Truth
from numpy.typing import NDArray
from scipy.optimize import least_squares
from watch_causes import AFTER, CHANGES, QUIET, Change

from softgrip_model.finger.hypotheses import Cause
from softgrip_testing.benchmark_claim import claim, no_options

Array = NDArray[np.float64]

SEED = 7301
#: Two causes this far apart are told from each other in 90 % of cases: Phi(2.56 / 2).
MIN_DISTANCE = 2.56
#: A change that is nearer to none is not called one (a log-likelihood ratio of 6, and what an amount costs).
MIN_CHANGE = 4.0


def strips(joint: int, share: float) -> dict[str, object]:
    """Return one strip that has lost a share."""
    return {"strips": tuple(1.0 - min(max(0.0, share), 0.95) * (j == joint) for j in range(3))}


#: What each cause makes of amounts about one.
CAUSES: tuple[tuple[Cause, int, Callable[[Array], dict[str, object]]], ...] = (
    (Cause.FRICTION, 1, lambda a: {"friction": max(0.05, 1.0 + 0.1 * a[0])}),
    (Cause.STIFFNESS, 1, lambda a: {"stiffness": max(0.05, 1.0 + 0.1 * a[0])}),
    (Cause.TENSION_GAIN, 1, lambda a: {"gain": 1.0 + 0.1 * a[0]}),
    (Cause.ZERO, 1, lambda a: {"zero_mm": a[0]}),
    (Cause.CABLE, 1, lambda a: {"stretch_mm_per_n": max(0.0, 0.1 * a[0])}),
    (Cause.OUT_OF_PLANE, 1, lambda a: {"tilt_rad": 0.2 * a[0]}),
    (Cause.CAMERA, 3, lambda a: {"camera_mm": (a[0], a[1]), "camera_scale": 1.0 + 0.01 * a[2]}),
    (Cause.STRIP, 1, lambda a: strips(0, 0.1 * a[0])),
    (Cause.STRIP, 1, lambda a: strips(1, 0.1 * a[0])),
    (Cause.STRIP, 1, lambda a: strips(2, 0.1 * a[0])),
)


def closing(finger: HingedFinger, truth: Truth, *wander: float) -> Array:
    """Return tips and tensions, (3 K,)."""
    tips, tensions = finger.answer(truth, *wander)
    return np.concatenate([tips.ravel(), tensions])


def whitening(finger: HingedFinger) -> Array:
    """Return what makes the difference of two means of closings of unit variance."""
    calm = closing(finger, Truth())
    white = np.concatenate([np.full(2 * len(PULLS_MM), TIP_MM), TENSION * calm[2 * len(PULLS_MM) :]])
    each = ((SCATTER_MM, 1.0, 1.0), (0.0, 1.0 + WANDER, 1.0), (0.0, 1.0, 1.0 + WANDER))
    wander = np.column_stack([closing(finger, Truth(), *one) - calm for one in each])
    covariance = (1.0 / AFTER[-1] + 1.0 / QUIET) * (np.diag(white**2) + wander @ wander.T)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def is_right(cause: Cause, change: Change) -> bool:
    """Whether a cause names a change; softer strips name what slow or hurried closings do, too."""
    return cause in change.causes or (cause is Cause.STIFFNESS and Cause.CONDITIONS in change.causes)


def distances(finger: HingedFinger, change: Change, root: Array) -> tuple[float, Cause, float]:
    """Return how far a change is from none, the wrong cause that is nearest to it, and how far that is."""
    truth = change.apply(Truth(), change.after[-1] - AFTER[-1] // 2)  # as it is in their midst
    calm, seen = closing(finger, Truth()), closing(finger, truth)
    nearest = (Cause.NONE_OF_THESE, math.inf)
    for cause, count, to in CAUSES:
        if is_right(cause, change):
            continue

        def left(amounts: Array, to: Callable[[Array], dict[str, object]] = to) -> Array:
            return np.asarray(root @ (closing(finger, dataclasses.replace(Truth(), **to(amounts))) - seen))

        for start in (0.5, -0.5):
            found = least_squares(left, np.full(count, start), diff_step=np.full(count, 1e-3), max_nfev=12)
            nearest = min(nearest, (cause, math.sqrt(2.0 * found.cost)), key=lambda one: one[1])
    return float(np.linalg.norm(root @ (seen - calm))), *nearest


def main() -> int:
    """Print the claim, and the table on stderr."""
    no_options(__doc__)
    identified = []
    for name in SETS:
        finger = HingedFinger(name, SEED)
        root = whitening(finger)
        for change in CHANGES:
            total, cause, apart = distances(finger, change, root)
            identified.append(apart >= MIN_DISTANCE and total >= MIN_CHANGE)
            print(f"{name}: {change.name}: {total:.1f} from none, {apart:.1f} from {cause}", file=sys.stderr)
    claim(
        "changes that closings can tell", 100.0 * float(np.mean(identified)), "%", better="higher", goal=None,
        runs=len(identified), note=f"{len(CHANGES)} changes to one finger of each set, everything else known",
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
