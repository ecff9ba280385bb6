# SPDX-License-Identifier: Apache-2.0
"""FingerReach-v0: bring the tip of one finger where the design says it would be, whatever finger was printed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gymnasium import spaces

from softgrip_gym.hand_env import TRAINING_CELLS, HandEnv
from softgrip_gym.tendons import BOUND, PERIOD_S
from softgrip_model.finger.matching import TendonInput
from softgrip_testing.virtual_cell import SLOTS, TIP_NOISE_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Pulled lengths [m] at which goals lie, for the finger as designed.
GOAL_PULL_M: Final = (0.003, 0.014)
#: [s] of an episode.
EPISODE_S: Final = 3.0
#: [m] of one unit of a place in an observation: the length of a finger.
PLACE_UNIT_M: Final = 0.1


class FingerReach(HandEnv):
    """Observation (8,): pulled length, speed, tension, commanded length, seen tip x and y, goal x and y.

    Action (1,): speed of the commanded length. Reward: minus the distance between true tip and goal, in finger lengths
    of 0.1 m. An episode is truncated after 3 s; it is terminated when the driver stops with a fault.

    Args:
        finger_set: profile of the finger.
        cells: first and last + 1 of the seeds that cells are drawn from.
    """

    def __init__(self, finger_set: str = "power", cells: tuple[int, int] = TRAINING_CELLS) -> None:
        super().__init__(finger_set, cells, SLOTS[:1])
        self.observation_space = spaces.Box(-BOUND, BOUND, (8,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._goal_m = np.zeros(2)
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a cell, a copy of the finger and a goal; see `HandEnv.draw_cell` for the options."""
        self.draw_cell(seed, options or {})
        pull_m = float(self.np_random.uniform(*GOAL_PULL_M))
        requested = tuple(TendonInput(self.cell.now_ns, pull_m, 0.0, 0.0) for _ in SLOTS)
        self._goal_m = np.array(self.cell.session.predict(requested, SLOTS)[0].tip[:2])
        self._steps = 0
        return self._observe(), self._info()

    def step(self, action: NDArray[np.floating]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Command the tendon for 50 ms."""
        runs = self.drive(action)
        self._steps += 1
        info = self._info()
        truncated = self._steps >= round(EPISODE_S / PERIOD_S)
        return self._observe(), -info["distance_m"] / PLACE_UNIT_M, not runs, truncated, info

    def _tip_m(self) -> NDArray[np.float64]:
        bank = self.cell.plant.bank
        finger = bank.fingers[0]
        assert finger is not None, "the index slot is empty"
        return np.array(bank.chain()[0][0, finger.joints])

    def _observe(self) -> NDArray[np.float32]:
        seen_m = self._tip_m() + self.np_random.normal(0.0, TIP_NOISE_M, 2)
        places = np.concatenate([seen_m, self._goal_m]) / PLACE_UNIT_M
        return np.asarray(np.clip(np.concatenate([self.tendons(), places]), -BOUND, BOUND), np.float32)

    def _info(self) -> dict[str, Any]:
        return {"distance_m": float(np.linalg.norm(self._tip_m() - self._goal_m)), "cell": self.cell.plant.seed}
