# SPDX-License-Identifier: Apache-2.0
"""All mounted fingers stepped together: joints, tendon, friction with memory (mechanics in src/plant/finger.hpp).

Arrays are (finger F, joint J, ...), SI units; rows of a finger with fewer joints, or of none, end in zeros.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.plant import _core
from softgrip_emulator.plant.material import in_room

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.plant._core import JointLoad
    from softgrip_emulator.plant.truth import FingerTruth

    Array = NDArray[np.float64]

_RUN_IN_CLOSINGS: Final = 3
_RUN_IN_M: Final = 0.022
_RUN_IN_N: Final = 28.0
_RUN_IN_M_PER_S: Final = 0.02
_RUN_IN_STEP_S: Final = 0.002


class FingerBank:
    """State and geometry of the mounted fingers; a slot without a finger has a tendon that pulls on nothing.

    The arrays are views onto the state: they change with every step. Copy what has to stay.
    """

    def __init__(self, fingers: Sequence[FingerTruth | None]) -> None:
        self.fingers = list(fingers)
        self.core = _core.FingerBank(self.fingers)
        self.joints = self.core.joints
        self.q: Array = self.core.q()
        """Joint angles [rad], (F, J)."""
        self.joint_speed: Array = self.core.joint_speed()
        """[rad/s], (F, J)."""
        self.tension_n: Array = self.core.tension_n()
        """Tension at the spools [N], (F,)."""
        self.span_tension_n: Array = self.core.span_tension_n()
        """Tension after each routing contact, spool to tip [N], (F, 2J)."""
        self.slack_m: Array = self.core.slack_m()
        """Loose cable [m], (F,); whoever disturbs the plant writes here."""
        self.broken: NDArray[np.bool_] = self.core.broken()
        """Whose tendon is broken, (F,); whoever disturbs the plant writes here."""

    @property
    def friction_scale(self) -> float:
        """Wear of the cable guides: all friction times this."""
        return self.core.friction_scale

    @friction_scale.setter
    def friction_scale(self, scale: float) -> None:
        self.core.friction_scale = scale

    def adopt(self, before: FingerBank, keep: Sequence[int]) -> None:
        """Take over the state of fingers that stay mounted."""
        self.core.adopt(before.core, keep)

    def warm(self, temperature_c: float) -> None:
        """Bring all fingers to a temperature [degC]."""
        self.core.set_room(*in_room(temperature_c))

    def memories(self) -> dict[tuple[str, str], list[float]]:
        """What strips and tendons do not forget, by profile and serial number."""
        named = [(i, finger) for i, finger in enumerate(self.fingers) if finger is not None]
        return {(finger.profile, finger.serial): self.core.recall(i) for i, finger in named}

    def recall(self, memories: Mapping[tuple[str, str], list[float]]) -> None:
        """Let fingers that were mounted before be as used as they were."""
        for slot, finger in enumerate(self.fingers):
            if finger is not None and (finger.profile, finger.serial) in memories:
                self.core.restore(slot, memories[finger.profile, finger.serial])

    def pulled_length_m(self) -> Array:
        """How much cable the present joint angles take in [m], (F,)."""
        return self.core.pulled_length_m()

    def step(self, wound_m: Array, dt_s: float, load: JointLoad | None = None) -> None:
        """Advance by one step.

        Args:
            wound_m: cable wound on each spool since mounting [m], (F,).
            dt_s: step [s].
            load: what products do to the links: force on their poses [N, N, N m a joint], (F, 3J), and its stiffness
                against their motion, (F, 3J, 3J).
        """
        self.core.step(wound_m, dt_s, load)

    def chain(self, ago_s: float = 0.0) -> tuple[Array, Array]:
        """Middles of the strips and tip in each finger's base frame [m], (F, J+1, 2), and link directions (F, J).

        Args:
            ago_s: so long before now, by the speeds of the last step [s].
        """
        return self.core.chain(ago_s)


def run_in(finger: FingerTruth) -> list[float]:
    """Return what a finger does not forget of the closings that whoever made it has tried it with.

    Elastomers are conditioned before they are measured or used, and
    cords are pulled before they are cut to length. Otherwise strips that run in would be taken for wear.
    """
    bank = FingerBank([finger])
    step_m = _RUN_IN_M_PER_S * _RUN_IN_STEP_S
    for _ in range(_RUN_IN_CLOSINGS):
        wound_m = finger.slack_m
        while wound_m < finger.slack_m + _RUN_IN_M and bank.tension_n[0] < _RUN_IN_N:
            wound_m += step_m
            bank.step(np.array([wound_m]), _RUN_IN_STEP_S)
        while wound_m > 0.0:
            wound_m -= step_m
            bank.step(np.array([wound_m]), _RUN_IN_STEP_S)
    return bank.core.recall(0)
