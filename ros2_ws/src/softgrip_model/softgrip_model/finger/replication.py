# SPDX-License-Identifier: Apache-2.0
"""Mode R: the thesis' own recipe for a closing (section 3.2.2), to reproduce its numbers. Use `kernel` to predict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import _core
from softgrip_model.finger.design import Finger, JointModel, core_design, core_friction
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.kernel import Array
from softgrip_model.friction.laws import FrictionLaw


class BendingForce(StrEnum):
    """What bends a joint.

    SPAN_TENSION: the tension in its span (section 4.2.2's words). TENSION_LOSS: what its two routing points take from
    the tension (Eqs 3.5, 3.6 as printed); what is left at the tip bends the last joint, so that the joints' forces sum
    up to the actuator's.
    """

    SPAN_TENSION = "span_tension"
    TENSION_LOSS = "tension_loss"


_FORCE_INDEX = {force: index for index, force in enumerate(BendingForce)}


@dataclass(frozen=True)
class ReplicationRecipe:
    """What the thesis leaves open, and one reading of it that fits its facts (docs/finger.md).

    Attributes:
        passage_radius_mm: of the cable's hole; a routing point counts once the cable bears on its rim; 0 = always.
        cable_radius_mm: rc.
        neighbour_mm: how far away the cable is held before the first and beyond the last point.
        initial_tension_n: in every span.
        force: that bends a joint.
    """

    passage_radius_mm: float = 0.9
    cable_radius_mm: float = 0.75
    neighbour_mm: float = 35.0
    initial_tension_n: float = 0.05
    force: BendingForce = BendingForce.SPAN_TENSION


@dataclass(frozen=True, eq=False)
class Replica:
    """A closing by explicit increments; K steps, n joints. NaN from the step that broke off.

    Attributes:
        pulled_mm: (K,).
        angle_rad: (K, n).
        tension_n: (K, 2 n + 1), span by span from the actuator.
        status: (K,), bits of `kernel.Status`.
    """

    pulled_mm: Array
    angle_rad: Array
    tension_n: Array
    status: NDArray[np.uint32]


def replicate(
    finger: Finger,
    law: FrictionLaw,
    pulled_mm: float = 20.0,
    steps: int = 200,
    recipe: ReplicationRecipe = ReplicationRecipe(),
) -> Replica:
    """Close a finger by explicit increments, lambda of the law as printed (negative).

    Raises:
        FingerError: a finger of mode F, no step, or nothing pulled.
    """
    if finger.joint_model is not JointModel.HINGE:
        raise FingerError(
            f"expected joints that are hinges, found {finger.joint_model}: mode R knows no other; take "
            "finger.with_joint_model(JointModel.HINGE)"
        )
    if steps < 1 or not pulled_mm > 0.0:
        raise FingerError(f"expected at least one step and a pull > 0 mm, found {steps} and {pulled_mm}")
    angle, tension, status = _core.replicate(
        core_design(finger),
        core_friction(law),
        steps,
        pulled_mm / steps,
        _core.Replication(
            recipe.passage_radius_mm,
            recipe.cable_radius_mm,
            recipe.neighbour_mm,
            recipe.initial_tension_n,
            _FORCE_INDEX[recipe.force],
        ),
    )
    return Replica(pulled_mm * np.arange(1, steps + 1) / steps, angle, tension, status)
