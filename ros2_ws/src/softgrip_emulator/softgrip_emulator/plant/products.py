# SPDX-License-Identifier: Apache-2.0
"""The products and the hand's geometry as data (plant/data), and one copy of a product as it really is."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import yaml

import softgrip_description
from softgrip_emulator.errors import EmulatorError

_DATA: Final = Path(__file__).parent / "data"
_SLOT_STDDEV_M: Final = 0.15e-3
"""A slot beside the drawing: 0.2 mm of play each side of a foot (docs/parts.md), uniform, and 0.1 mm of the printer."""
_SLOT_STDDEV_RAD: Final = 0.01
"""The same play at both ends of a foot of 16 mm: sqrt(2) 0.2 mm / sqrt(3) / 16 mm."""


@dataclass(frozen=True)
class PlantProduct:
    """One product in the grasp plane; units are in the names (data/products.yaml explains them)."""

    name: str
    width_m: float
    height_m: float
    length_m: float
    corner_m: float
    mass_kg: float
    friction: float
    stiffness_n_per_m: float
    crush_n: float
    stem_above_table_m: float = 0.0

    @property
    def round_in_length(self) -> bool:
        """Whether it is a ball rather than a bar: then it gets thinner away from its middle."""
        return self.length_m < 1.6 * self.width_m and self.corner_m > 0.3 * self.width_m

    def copy_of(self, rng: np.random.Generator) -> PlantProduct:
        """Another item from the same crate: a few per cent larger or smaller, heavier or lighter, drier or moister."""
        size = rng.normal(1.0, 0.03)
        return replace(
            self,
            width_m=self.width_m * size,
            height_m=self.height_m * size,
            length_m=self.length_m * size,
            corner_m=self.corner_m * size,
            mass_kg=self.mass_kg * size**3 * rng.normal(1.0, 0.02),
            friction=self.friction * rng.normal(1.0, 0.06),
            stiffness_n_per_m=self.stiffness_n_per_m * rng.normal(1.0, 0.10),
            crush_n=self.crush_n * rng.normal(1.0, 0.08),
        )


@dataclass(frozen=True)
class SlotPlace:
    """Where a finger starts in the grasp plane: side +1 = fingers, -1 = thumb; `across_m` out of that plane."""

    side: int
    along_m: float
    out_m: float
    rest_angle_rad: float
    across_m: float

    def assembled(self, rng: np.random.Generator) -> SlotPlace:
        """The place of a finger in a palm that was printed and put together."""
        along_m, out_m, across_m = rng.normal(0.0, _SLOT_STDDEV_M, 3)
        return replace(
            self,
            along_m=self.along_m + along_m,
            out_m=self.out_m + out_m,
            across_m=self.across_m + across_m,
            rest_angle_rad=self.rest_angle_rad + rng.normal(0.0, _SLOT_STDDEV_RAD),
        )


@dataclass(frozen=True)
class GraspWorld:
    """The described hand in its grasp plane (along, out of the palm) and the world around it (data/hand.yaml)."""

    palm_m: float
    finger_width_m: float
    slots: dict[str, SlotPlace]
    description: softgrip_description.Hand
    clearance_m: float
    table_m: float

    def assembled(self, seed: int) -> GraspWorld:
        """The hand of a cell as it was put together: each slot a little beside the drawing, the same for one seed."""
        slots = {
            name: place.assembled(np.random.default_rng([seed, zlib.crc32(f"slot/{name}".encode())]))
            for name, place in self.slots.items()
        }
        return replace(self, slots=slots)

    def presented_at(self, product: PlantProduct, profile: str) -> tuple[float, float]:
        """Centre of a product (along, out) [m] when the arm has gone down with a finger set."""
        along, _, depth = self.description.tool_centre_point_m(profile)
        depth = max(depth, self.palm_m + self.clearance_m + product.height_m / 2.0)
        lowest = self.table_m - max(product.height_m / 2.0, product.stem_above_table_m)
        if product.height_m / 2.0 + self.clearance_m < lowest:
            depth = min(depth, lowest)
        return along, depth


@cache
def products() -> dict[str, PlantProduct]:
    """All products by name."""
    return _read("products.yaml")


@cache
def published_products() -> dict[str, PlantProduct]:
    """The same products by published masses and dimensions, frozen: not tuned towards Table 4.2."""
    return _read("products_published.yaml")


def _read(file: str) -> dict[str, PlantProduct]:
    rows = yaml.safe_load((_DATA / file).read_text(encoding="utf-8"))
    return {name: PlantProduct(name=name, **row) for name, row in rows.items()}


def product(name: str) -> PlantProduct:
    """One product.

    Raises:
        EmulatorError: no such product.
    """
    known = products()
    if name not in known:
        raise EmulatorError(f"product: expected one of {sorted(known)}, found '{name}'")
    return known[name]


@cache
def hand() -> GraspWorld:
    """The hand as it is described."""
    data = yaml.safe_load((_DATA / "hand.yaml").read_text(encoding="utf-8"))
    described = softgrip_description.shipped_hand()
    slots = {
        name: SlotPlace(
            side=-slot.closes_towards_x,
            along_m=slot.position_m[0],
            out_m=slot.position_m[2],
            rest_angle_rad=slot.rest_angle_rad,
            across_m=slot.position_m[1],
        )
        for name, slot in described.slots.items()
    }
    # The surface of the palm is the plane z = 0 of its frame.
    return GraspWorld(palm_m=0.0, slots=slots, description=described, **data)
