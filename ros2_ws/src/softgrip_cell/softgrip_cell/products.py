# SPDX-License-Identifier: Apache-2.0
"""Products, finger sets and recipes as frozen values (thesis Tables 4.1 and 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


class GraspType(StrEnum):
    """How a hand takes a product (thesis 4.2.1)."""

    POWER = "power"
    PINCH = "pinch"
    HOOK = "hook"


class ProductShape(StrEnum):
    """Coarse form, as far as it decides a grasp."""

    BALL = "ball"
    ROD = "rod"
    SLAB = "slab"
    BAG = "bag"
    CLUSTER = "cluster"  # parts hanging from a stem that a finger can go under


class ProductSurface(StrEnum):
    """What the fingers touch."""

    SMOOTH = "smooth"
    DIMPLED = "dimpled"
    RUGGED = "rugged"
    FILM = "film"
    FROST = "frost"


class Fragility(StrEnum):
    """How much squeezing the product forgives."""

    ROBUST = "robust"
    DELICATE = "delicate"
    FRAGILE = "fragile"


class TableMark(StrEnum):
    """One cell of thesis Table 4.2."""

    SUCCESS = "success"
    PARTIAL = "partial"
    FAILURE = "failure"


@dataclass(frozen=True)
class Recipe:
    """How one product is grasped; every change makes a new version of its product.

    Attributes:
        hold_contact_tension_n: tension above the free motion that counts as holding, per finger [N].
        force_limit_n: contact force that the product bears from one finger [N].
        pull_limit_m: pulled length that a closing never exceeds [m].
        closing_speed_m_per_s: pulled length per second while closing [m/s].
    """

    hold_contact_tension_n: float
    force_limit_n: float
    pull_limit_m: float
    closing_speed_m_per_s: float


@dataclass(frozen=True)
class Product:
    """One product as the catalogue knows it.

    Attributes:
        id: short name used on services, e.g. "frozen_pizza".
        size_m: length >= width >= height of the bounding box [m].
        mass_kg: mass [kg].
        recipe: how it is grasped with a finger set that has no recipe of its own.
        marks: what Table 4.2 (or a trial) says per finger set.
        own_recipes: per finger set, where it differs.
        version: grows by one with every stored change.
    """

    id: str
    name: str
    grasp: GraspType
    shape: ProductShape
    size_m: tuple[float, float, float]
    mass_kg: float
    surface: ProductSurface
    fragility: Fragility
    recipe: Recipe
    marks: Mapping[str, TableMark] = field(default_factory=dict)
    own_recipes: Mapping[str, Recipe] = field(default_factory=dict)
    version: int = 1

    def recipe_for(self, finger_set: str) -> Recipe:
        """Return how it is grasped with a finger set."""
        return self.own_recipes.get(finger_set, self.recipe)


@dataclass(frozen=True)
class FingerSet:
    """One profile in every slot."""

    id: str
    grasp: GraspType
    profile: str


@dataclass(frozen=True)
class Catalogue:
    """Everything a catalogue file holds."""

    finger_sets: Mapping[str, FingerSet]
    products: Mapping[str, Product]

    def success_rate(self, finger_set: str) -> float:
        """Share of the products marked SUCCESS for a finger set, as the last row of Table 4.2 counts [0..1]."""
        marks = [product.marks.get(finger_set) for product in self.products.values()]
        return marks.count(TableMark.SUCCESS) / len(marks)
