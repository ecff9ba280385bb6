# SPDX-License-Identifier: Apache-2.0
"""GraspProduct-v0: close three fingers on a product so that it is still there after the arm has lifted it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gymnasium import spaces

from softgrip_gym.hand_env import TRAINING_CELLS, HandEnv
from softgrip_gym.tendons import BOUND, PERIOD_S, product_observation
from softgrip_testing.virtual_grasps import ProductSet, catalogue, plant_products

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

#: [s] that the fingers have before the arm goes up.
CLOSE_S: Final = 2.5
#: [s] that the product has to hang; thesis 4.3.3 watches for 5 s.
HOLD_S: Final = 5.0


class GraspProduct(HandEnv):
    """Observation (17,): lengths, speeds, tensions, commanded lengths; sizes and mass of the product; time to lift.

    Action (3,): speeds of the commanded lengths. Reward: 1 at the end for a product that hangs undamaged, -1 for a
    crushed one, 0 for a lost one, and minus 0.01 a second of winding at full speed, so that of two good grasps the
    calmer is better. The arm lifts after 2.5 s. An episode is terminated when the product is held for `hold_s`, lost,
    crushed, or when the driver stops with a fault.

    Args:
        finger_set: profile in every slot.
        products: names to draw from; empty: all of the catalogue.
        product_set: A, the emulator's, or B, by published masses.
        hold_s: that the product has to hang [s].
        cells: first and last + 1 of the seeds that cells are drawn from.
    """

    def __init__(
        self,
        finger_set: str = "power",
        products: Sequence[str] = (),
        product_set: str = "A",
        hold_s: float = HOLD_S,
        cells: tuple[int, int] = TRAINING_CELLS,
    ) -> None:
        super().__init__(finger_set, cells)
        self._known = catalogue(ProductSet(product_set))
        self._real = plant_products(ProductSet(product_set))
        self.products = tuple(products) or tuple(self._known)
        unknown = sorted(set(self.products) - set(self._known))
        if unknown:
            raise ValueError(f"products: expected names of {sorted(self._known)}, found {unknown}")
        self.observation_space = spaces.Box(-BOUND, BOUND, (17,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._close_steps, self._end_step = round(CLOSE_S / PERIOD_S), round((CLOSE_S + hold_s) / PERIOD_S)
        self._product = self.products[0]
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a cell, a copy of the finger set and a product.

        Args:
            seed: of the draws; None: go on with them.
            options: ``product``: this one; and those of `HandEnv.draw_cell`.
        """
        options = options or {}
        self.draw_cell(seed, options)
        self._product = str(options.get("product", self.np_random.choice(np.array(self.products))))
        self.cell.plant.place(self._real[self._product])
        self._steps = 0
        return self._observe(), self._info()

    def step(self, action: NDArray[np.floating]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Command the tendons for 50 ms."""
        if self._steps >= self._close_steps:
            self.cell.plant.lift()
        runs = self.drive(action)
        self._steps += 1
        state = self.cell.plant.grasp.state()
        lost = state.slipped or not state.product
        holds = self._steps >= self._end_step and not lost and not state.crushed
        effort = 0.01 * PERIOD_S * float(np.abs(np.clip(action, -1.0, 1.0)).mean())
        reward = float(holds) - float(state.crushed) - effort
        info = self._info() | {"is_success": holds and runs, "crushed": state.crushed, "lost": lost}
        return self._observe(), reward, bool(holds or lost or state.crushed or not runs), False, info

    def _observe(self) -> NDArray[np.float32]:
        left = max(0.0, (self._close_steps - self._steps) / self._close_steps)
        known = product_observation(self._known[self._product])
        return np.asarray(np.clip(np.concatenate([self.tendons(), known, [left]]), -BOUND, BOUND), np.float32)

    def _info(self) -> dict[str, Any]:
        return {"product": self._product, "cell": self.cell.plant.seed, "is_success": False}
