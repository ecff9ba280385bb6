# SPDX-License-Identifier: Apache-2.0
"""The plant without servos: tendons pulled by hand, for judging grasps by mechanics alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.plant.cell import SLOTS, STEP_S, CellPlant

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from softgrip_emulator.plant.grasp import GraspState
    from softgrip_model.profile import Profile

_THUMB: Final = SLOTS.index("thumb")
_AFTERWARDS_S: Final = 0.3


class HandPulledCell(CellPlant):
    """Three fingers of one set; `pulled_length_m` (3,) is how far each tendon is pulled beyond taut [m]."""

    def __init__(self, profiles: Mapping[str, Profile], finger_set: str, *, seed: int) -> None:
        self.pulled_length_m: NDArray[np.float64] = np.zeros(len(SLOTS))
        super().__init__(profiles, seed=seed)
        self.mount(SLOTS, [f"{finger_set}-{slot}" for slot in SLOTS], [finger_set] * len(SLOTS))

    def wound_m(self) -> NDArray[np.float64]:
        """Cable wound since mounting [m], (3,): slack first, then what is pulled."""
        slack = self.bank.slack_m if hasattr(self, "bank") else 0.0
        return np.asarray(self.pulled_length_m + slack)

    def close(
        self,
        tension_n: float,
        *,
        travel_m: float = 0.028,
        speed_m_s: float = 0.015,
        limit_n: float = 30.0,
        max_s: float = 4.0,
    ) -> GraspState:
        """Pull until the thumb's tendon and a finger's carry `tension_n`, then hold until the grasp is decided.

        Args:
            tension_n: that counts as holding [N].
            travel_m: largest pulled length [m].
            speed_m_s: of pulling [m/s].
            limit_n: a tendon that carries this stops by itself [N].
            max_s: give up after this time [s].
        """
        stopped = np.zeros(len(SLOTS), bool)
        for _ in range(round(max_s / STEP_S)):
            forward = np.minimum(self.pulled_length_m + speed_m_s * STEP_S, travel_m)
            self.pulled_length_m = np.where(stopped, self.pulled_length_m, forward)
            self.step()
            tension = self.bank.tension_n
            stopped |= tension > limit_n
            if tension[_THUMB] > tension_n and np.delete(tension, _THUMB).max() > tension_n:
                stopped[:] = True
            state = self.grasp.state()
            if state.held or state.slipped:
                break
        for _ in range(round(_AFTERWARDS_S / STEP_S)):
            self.step()
        return self.grasp.state()
