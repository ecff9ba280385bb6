# SPDX-License-Identifier: Apache-2.0
"""A small policy for GraspProduct-v0: wind each tendon until it carries a tension that depends on the product."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_gym.tendons import SLOTS, TENSION_UNIT_N

if TYPE_CHECKING:
    from numpy.typing import NDArray

KIND: Final = "softgrip_grasp_policy"
#: The policy that ships, for power fingers; benchmarks/virtual/gym.py trains it again.
SHIPPED: Final = Path(__file__).parent / "data" / "grasp_policy.json"
#: Features of a product that a tension depends on: 1, smallest size [0.1 m], mass [0.5 kg].
FEATURES: Final = 3
#: Tensions [N] and rates that a policy may ask for; a tendon that carries more is let out.
_MIN_TENSION_N, _MAX_TENSION_N = 1.0, 28.0
_SOFTNESS_N: Final = 2.0
_THUMB: Final = SLOTS.index("thumb")


@dataclass(frozen=True)
class GraspPolicy:
    """Tension of fingers and of thumb as affine functions of the product, and how fast to wind.

    Attributes:
        finger_set: that it was trained with.
        fingers_n: (3,) coefficients of the fingers' tension [N] for the features 1, size, mass.
        thumb_n: (3,) those of the thumb's.
        rate: of winding, as a share of the largest.
    """

    finger_set: str
    fingers_n: tuple[float, ...]
    thumb_n: tuple[float, ...]
    rate: float

    @classmethod
    def of(cls, finger_set: str, parameters: NDArray[np.float64]) -> GraspPolicy:
        """Return a policy of its seven parameters."""
        values = [float(value) for value in parameters]
        return cls(finger_set, tuple(values[:FEATURES]), tuple(values[FEATURES : 2 * FEATURES]), values[-1])

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action (3,) for an observation (17,) of GraspProduct-v0."""
        tensions_n = TENSION_UNIT_N * observation[6:9]
        features = np.array([1.0, observation[14], observation[15]])
        requested_n = np.full(len(SLOTS), features @ self.fingers_n)
        requested_n[_THUMB] = features @ self.thumb_n
        requested_n = np.clip(requested_n, _MIN_TENSION_N, _MAX_TENSION_N)
        rate = min(1.0, max(0.05, self.rate))
        return np.asarray(np.clip((requested_n - tensions_n) / _SOFTNESS_N, -0.2 * rate, rate), np.float32)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps({"kind": KIND, **asdict(self)}, indent=1) + "\n")

    @classmethod
    def load(cls, path: Path = SHIPPED) -> GraspPolicy:
        """Read what `save` wrote.

        Raises:
            ValueError: the file is no such policy; says what was expected.
        """
        try:
            raw = json.loads(path.read_text())
            if raw.pop("kind") != KIND:
                raise ValueError(f"kind {KIND}")
            policy = cls(str(raw["finger_set"]), tuple(map(float, raw["fingers_n"])), tuple(map(float, raw["thumb_n"])),
                         float(raw["rate"]))  # fmt: skip
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path}: expected a grasp policy (written by `train`), found {error!r}") from error
        if {len(policy.fingers_n), len(policy.thumb_n)} != {FEATURES} or not np.isfinite(
            [*policy.fingers_n, *policy.thumb_n, policy.rate]
        ).all():
            raise ValueError(f"{path}: expected {FEATURES} finite coefficients each, found {policy}")
        return policy
