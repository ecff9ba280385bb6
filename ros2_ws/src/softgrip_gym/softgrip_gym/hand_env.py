# SPDX-License-Identifier: Apache-2.0
"""What both environments share: an emulated cell drawn from a seed, stepped in the driver's periods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import gymnasium
import numpy as np

from softgrip_gym.tendons import MAX_LENGTH_M, PERIOD_S, SLOTS, next_targets, tendon_observation
from softgrip_testing.virtual_cell import VirtualCell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

#: Emulated cells that are drawn unless others are asked for; those of benchmarks and docs are below 1000.
TRAINING_CELLS: Final = (1000, 1_000_000)
#: Copies of a finger set that are drawn.
COPIES: Final = 50


class HandEnv(gymnasium.Env[Any, Any]):  # type: ignore[misc]  # Gymnasium is an extra, so mypy does not read it
    """An emulated cell with servos, driver and fingers of a set; every episode has another cell and copy of the set.

    Args:
        finger_set: profile in every slot.
        cells: first and last + 1 of the seeds that cells are drawn from.
        slots: tendons that the policy commands; the others stay open.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": round(1.0 / PERIOD_S)}  # noqa: RUF012  Gymnasium's

    def __init__(self, finger_set: str, cells: tuple[int, int] = TRAINING_CELLS, slots: Sequence[str] = SLOTS) -> None:
        self.finger_set, self.cells, self.slots = finger_set, cells, tuple(slots)
        self._indices = [SLOTS.index(slot) for slot in self.slots]
        self._targets_m: NDArray[np.float64] = np.zeros(len(self.slots))
        self._cell: VirtualCell | None = None

    @property
    def cell(self) -> VirtualCell:
        """The emulated cell of this episode."""
        assert self._cell is not None, "reset the environment first"
        return self._cell

    def draw_cell(self, seed: int | None, options: dict[str, Any]) -> None:
        """Draw a cell and home it.

        Args:
            seed: of the environment's draws; None: go on with them.
            options: ``cell``: this one instead of a drawn one; ``copy``: this copy of the finger set.
        """
        super().reset(seed=seed)
        number = int(options.get("cell", self.np_random.integers(*self.cells)))
        copy = int(options.get("copy", self.np_random.integers(1, COPIES + 1)))
        self._cell = VirtualCell(number, self.finger_set, copy=copy)
        self._cell.plant.grasp.lifts_itself = False
        self._cell.home()
        self._targets_m = np.zeros(len(self.slots))

    def drive(self, action: NDArray[np.floating]) -> bool:
        """Command the tendons for one period; return False when the driver has stopped them with a fault."""
        self._targets_m = next_targets(self._targets_m, action)
        if self.cell.fault() is None:
            self.cell.follow(self._within_travel(), PERIOD_S, self.slots)
        for _ in range(round(PERIOD_S / self.cell.period_s)):
            self.cell.live()
        return self.cell.fault() is None

    def tendons(self) -> NDArray[np.float32]:
        """Return what tendon/state carries now, (4 n,)."""
        samples = [self.cell.samples()[index] for index in self._indices]
        return tendon_observation(
            [one.pulled_length_m for one in samples],
            [one.velocity for one in samples],
            [one.tension for one in samples],
            self._targets_m.tolist(),
        )

    def _within_travel(self) -> list[float]:
        return [
            min(float(target_m), self.cell.controller.drives[slot].limits.travel, MAX_LENGTH_M)
            for slot, target_m in zip(self.slots, self._targets_m, strict=True)
        ]
