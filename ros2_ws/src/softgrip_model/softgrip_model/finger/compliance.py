# SPDX-License-Identifier: Apache-2.0
"""What gives where in a finger of mode F, part by part, for programs that build the finger of springs (docs/finger.md).

A compliance is symmetric, (3, 3), over a closing moment [N mm], a compression [N] and a shear [N] at one point; what it
gives is a closing turn [rad], a shift into the link [mm] and a shift across it, towards closing, [mm].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import _core
from softgrip_model.finger.design import Finger, core_design

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointCompliance:
    """One joint: from the link before it to the one beyond.

    Attributes:
        link_before: from the middle of the link before to its end, at the apex; nothing where the base is before it.
        root_before: of the strip in the link before, at the strip's end; nothing where the base is before it.
        bending_nmm2: strip, moment per curvature at rest.
        axial_n: strip, force per strain.
        shear_n: strip, force per shear.
        root_beyond: of the strip in the link beyond, at the strip's end.
        link_beyond: from the near end of the link beyond, at the apex, to its middle.
    """

    link_before: Array | None
    root_before: Array | None
    bending_nmm2: float
    axial_n: float
    shear_n: float
    root_beyond: Array
    link_beyond: Array


def compliances(finger: Finger) -> tuple[list[JointCompliance], Array]:
    """Return what gives in each joint, base to tip, and from the last link's middle to the tip, at the tip (3, 3).

    A link's compliance may be negative where cables act beyond its middle: it takes back what the root gave too much.
    """
    sides, strips, tip = _core.flexures(core_design(finger))
    joints = []
    for j, (of_sides, (bending, axial, shear)) in enumerate(zip(sides, strips, strict=True)):
        root_before, link_before, root_beyond, link_beyond = (_symmetric(values) for values in of_sides)
        held = j == 0
        joints.append(
            JointCompliance(
                None if held else link_before,
                None if held else root_before,
                bending,
                axial,
                shear,
                root_beyond,
                link_beyond,
            )
        )
    return joints, _symmetric(tip)


def _symmetric(values: list[float]) -> Array:
    mm, mn, mv, nn, nv, vv = values
    return np.array([(mm, mn, mv), (mn, nn, nv), (mv, nv, vv)])
