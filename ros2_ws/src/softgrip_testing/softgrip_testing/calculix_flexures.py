# SPDX-License-Identifier: Apache-2.0
"""Random fingers closed in CalculiX (C3D8I): what mode F is fitted to, and fingers that its fit has not seen.

Every finger follows from its seed. tools/docs/flexure_study.py runs CalculiX and writes what is read here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger, JointModel, MomentLaw, Strip
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, mesh_finger

Array = NDArray[np.float64]

NAME = "flexure_calculix"
#: [MPa] NinjaFlex at rest (Table 5.1), neo-Hookean.
MODULUS_MPA = 11.03
#: CalculiX closed them without friction: fingers within the thesis' bounds, and others of other lengths, widths and
#: materials.
FRICTIONLESS_SEEDS, OTHER_SEEDS = range(2001, 2017), range(3001, 3008)
#: With friction, within the bounds: those that were looked at while mode F got its terms, and those run once terms and
#: constants were fixed.
KNOWN_SEEDS, UNSEEN_SEEDS = (*range(9001, 9021), *range(9201, 9221)), range(9301, 9321)
#: The constants of mode F were fitted to these, and to none of CalculiX'.
FITTED_SEEDS, FITTED_OTHER_SEEDS = range(8001, 8061), range(8101, 8141)
#: Links of the published index finger [mm].
_LINKS_MM = (45.0, 27.0, 23.0)


@dataclass(frozen=True, eq=False)
class Closing:
    """A finger's states in CalculiX, K of them.

    Attributes:
        seed: of `random_finger` or `other_finger`.
        friction: True: one state, its tensions from stretch to stretch are those of the kernel there; False: none.
        tension_n: (K,) at the actuator.
        pulled_mm: (K,).
        tip_mm: (K, 2).
    """

    seed: int
    friction: bool
    tension_n: Array
    pulled_mm: Array
    tip_mm: Array

    @property
    def finger(self) -> Finger:
        """The finger, in mode F."""
        return finger_of(self.seed)


def finger_of(seed: int) -> Finger:
    """Return the finger of a seed, in mode F."""
    return other_finger(seed) if seed in OTHER_SEEDS or seed in FITTED_OTHER_SEEDS else random_finger(seed)


def random_finger(seed: int) -> Finger:
    """Return a finger within the thesis' bounds: h 2.5 to 5 mm, r 5 to 13 mm, everything else as published."""
    rng = np.random.default_rng(seed)
    thickness, routing = rng.uniform(2.5, 5.0, 3), rng.uniform(5.0, 13.0, 6)
    return Finger(
        link_mm=_LINKS_MM,
        thickness_mm=tuple(thickness.tolist()),
        length_mm=(10.0,) * 3,
        routing_mm=tuple(routing.tolist()),
        width_mm=15.0,
        strip=Strip((0.0, 0.0, MODULUS_MPA), MomentLaw.LINEAR),
        joint_model=JointModel.FLEXURE,
    )


def other_finger(seed: int) -> Finger:
    """Return a finger of other lengths, width, depth, openings and Poisson's ratio, too."""
    rng = np.random.default_rng(seed)
    while True:
        body, width, poisson = rng.uniform(10, 14), rng.uniform(10, 20), float(rng.choice([0.2, 0.3, 0.4, 0.45]))
        finger = Finger(
            link_mm=tuple((np.array((45.0, 27.0, 25.0)) * rng.uniform(0.9, 1.25, 3)).tolist()),
            thickness_mm=tuple(rng.uniform(2.5, 5, 3).tolist()),
            length_mm=tuple(rng.uniform(7, 14, 3).tolist()),
            routing_mm=tuple(rng.uniform(5, min(13, body / np.cos(np.pi / 4) * 0.92), 6).tolist()),
            width_mm=width,
            opening_rad=tuple(np.radians(rng.uniform(80, 100, 3)).tolist()),
            strip=Strip((0.0, 0.0, MODULUS_MPA), MomentLaw.LINEAR, poisson=poisson),
            joint_model=JointModel.FLEXURE,
            body_mm=body,
        )
        try:
            mesh_finger(finger, RESOLUTIONS["coarse"], body)
        except GdfeError:  # grooves that meet: drawn again
            continue
        return finger


def closings() -> list[Closing]:
    """Return what CalculiX gave, finger by finger."""
    with resources.as_file(resources.files("softgrip_model.finger") / "reference" / f"{NAME}.npz") as file:
        data = np.load(file)
        ends = np.cumsum(data["states"])
        pieces = [slice(end - count, end) for end, count in zip(ends, data["states"], strict=True)]
        return [
            Closing(int(seed), bool(friction), data["tension_n"][p], data["pulled_mm"][p], data["tip_mm"][p])
            for seed, friction, p in zip(data["seed"], data["friction"], pieces, strict=True)
        ]


def save_closings(found: Iterable[Closing]) -> None:
    """Write what `closings` reads."""
    rows = sorted(found, key=lambda one: one.seed)
    with resources.as_file(resources.files("softgrip_model.finger") / "reference") as folder:
        np.savez_compressed(
            folder / f"{NAME}.npz",
            seed=np.array([one.seed for one in rows]),
            friction=np.array([one.friction for one in rows]),
            states=np.array([len(one.tension_n) for one in rows]),
            tension_n=np.concatenate([one.tension_n for one in rows]),
            pulled_mm=np.concatenate([one.pulled_mm for one in rows]),
            tip_mm=np.concatenate([one.tip_mm for one in rows]),
        )
