# SPDX-License-Identifier: Apache-2.0
"""A tendon on the stage instead of the rig's cable: loose at first, then a spring, until it breaks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from softgrip_emulator.rig.plant import RigPlant

if TYPE_CHECKING:
    from softgrip_emulator.rig.truth import RigTruth


class SpringPlant(RigPlant):
    """F = k max(0, x - x0) over the travel x of the stage.

    Args:
        truth: of the gauge.
        stiffness: k [N/m].
        slack: x0 [m].
    """

    def __init__(self, truth: RigTruth, stiffness: float = 1500.0, slack: float = 3e-3) -> None:
        super().__init__(truth, seed=0)
        self._stiffness = stiffness
        self._slack = slack
        self._broken = False
        self._pulled_n = 0.0

    @property
    def slack(self) -> float:
        """Travel at which the tendon becomes taut [m]."""
        return self._slack

    def loosen(self, length: float) -> None:
        """Make the tendon longer by a length [m]."""
        with self.lock:
            self._slack += length
            self._slide(0.0)

    def pull_by_hand(self, force: float) -> None:
        """Pull the tendon by hand with a force [N]; 0 lets it go."""
        with self.lock:
            self._pulled_n = force
            self._slide(0.0)

    def cut(self, broken: bool) -> None:
        """Break the tendon, or mend it."""
        with self.lock:
            self._broken = broken
            self._slide(0.0)

    def _slide(self, way: float) -> None:
        self.travel += way
        self.force = 0.0 if self._broken else self._pulled_n + self._stiffness * max(0.0, self.travel - self._slack)
