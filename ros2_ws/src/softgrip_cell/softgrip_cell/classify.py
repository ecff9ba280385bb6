# SPDX-License-Identifier: Apache-2.0
"""How a new product is to be grasped, from its dimensions and from a person's hand showing it (thesis 4.2.1)."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from softgrip_cell.errors import CatalogueError
from softgrip_cell.products import Fragility, GraspType, ProductShape

#: Share of the whole flexion in each joint, base to tip, that is typical of a grasp. The thesis has words only: power,
#: uniform over all joints; pinch, primarily the proximal joint; hook, middle and distal with little proximal. The
#: numbers are an assumption.
TYPICAL_SHARES: Final = {
    GraspType.POWER: (1 / 3, 1 / 3, 1 / 3),
    GraspType.PINCH: (0.70, 0.18, 0.12),
    GraspType.HOOK: (0.10, 0.52, 0.38),
}

#: Below this total flexion a demonstration shows nothing [rad].
MIN_FLEXION_RAD: Final = 0.35

#: Height over width from which a product is round in cross-section (assumption).
ROUND_FROM: Final = 0.75

#: Thickness below which even a round product is too small for three fingers to enclose (assumption) [m].
SMALL_BELOW_M: Final = 0.025

#: Widest opening of the hand (thesis 4.2.1: openings of 1 to 10 cm) [m].
OPENING_M: Final = 0.100

#: Confidence by dimensions alone; less for a fragile product in a power grasp, which squeezes most.
BY_SIZE: Final = 0.8
BY_SIZE_FRAGILE: Final = 0.6

#: Confidence with a demonstration: (base, slope) over its margin, where it agrees with the dimensions and where not.
AGREED: Final = (0.8, 0.2)
DISAGREED: Final = (0.3, 0.3)


@dataclass(frozen=True)
class Classification:
    """A grasp with the reasons for it.

    Attributes:
        confidence: 0..1, no probability; low when dimensions and demonstration disagree.
        reasons: in words, strongest first.
    """

    grasp: GraspType
    confidence: float
    reasons: tuple[str, ...]


def classify(
    shape: ProductShape,
    size_m: tuple[float, float, float],
    fragility: Fragility = Fragility.ROBUST,
    shares: Sequence[float] | None = None,
) -> Classification:
    """Return the grasp that Table 4.1 has for a product like this; the cell itself decides in `Cell.select`.

    Args:
        shape: coarse form.
        size_m: length >= width >= height [m].
        fragility: how much squeezing it forgives; lowers the confidence of a power grasp on fragile things.
        shares: share of flexion per joint in a demonstration (see flexion_shares), None without one.

    Raises:
        CatalogueError: the product is larger than the hand opens, or the numbers make no sense.
    """
    by_size, reason = _by_dimensions(shape, size_m)
    reasons = [reason]
    if shares is None:
        is_risky = fragility is Fragility.FRAGILE and by_size is GraspType.POWER
        reasons.append("no demonstration was given")
        return Classification(by_size, BY_SIZE_FRAGILE if is_risky else BY_SIZE, tuple(reasons))
    by_hand, margin, shown = _by_demonstration(shares)
    reasons.insert(0, shown)
    base, slope = AGREED if by_hand is by_size else DISAGREED
    if by_hand is not by_size:
        reasons.append("dimensions and demonstration disagree: the hand is believed; try before relying on it")
    return Classification(by_hand, base + slope * margin, tuple(reasons))


def flexion_shares(joint_angles_rad: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return each joint's share of the flexion in a demonstration.

    Args:
        joint_angles_rad: one row per frame, three columns base to tip [rad], from open to closed.

    Raises:
        CatalogueError: not three finite columns, or hardly any motion.
    """
    angles = np.asarray(joint_angles_rad, dtype=float)
    if angles.ndim != 2 or angles.shape[1] != 3 or len(angles) < 2 or not np.isfinite(angles).all():
        raise CatalogueError(
            f"demonstration: expected two or more frames of three finite joint angles, found shape {angles.shape}"
        )
    # The hand may tremble or start half closed: the middle of the first and last tenth stand for open and closed.
    tenth = max(1, len(angles) // 10)
    flexion = np.maximum(np.median(angles[-tenth:], axis=0) - np.median(angles[:tenth], axis=0), 0.0)
    total = float(flexion.sum())
    if total < MIN_FLEXION_RAD:
        raise CatalogueError(
            f"demonstration: expected a closing of {math.degrees(MIN_FLEXION_RAD):.0f} degrees or more over all "
            f"joints, found {math.degrees(total):.0f}; record from open to closed"
        )
    first, second, third = (float(value) for value in flexion / total)
    return (first, second, third)


def read_demonstration(path: Path) -> list[list[float]]:
    """Read joint angles [rad] from a CSV file whose last three columns are the joints, base to tip.

    Raises:
        CatalogueError: with the line, what was expected and what was found.
    """
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for number, cells in enumerate(csv.reader(line for line in file if not line.startswith("#")), start=1):
                try:
                    rows.append([float(cell) for cell in cells[-3:]])
                except ValueError:
                    if rows:  # the first line may be a heading
                        raise CatalogueError(f"{path}, row {number}: expected numbers, found {cells}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise CatalogueError(f"{path}: cannot be read: {error}") from error
    return rows


def _by_dimensions(shape: ProductShape, size_m: tuple[float, float, float]) -> tuple[GraspType, str]:
    """Return the grasp that form and size ask for, and the reason."""
    length, width, height = size_m
    if not (math.isfinite(length) and length >= width >= height > 0.0):
        raise CatalogueError(f"size: expected length >= width >= height > 0 in m, found {size_m}")
    if height > OPENING_M:
        raise CatalogueError(
            f"size: the smallest side is {height * 1e3:.0f} mm, the hand opens {OPENING_M * 1e3:.0f} mm: not graspable"
        )
    millimetres = " x ".join(f"{side * 1e3:.0f}" for side in size_m)
    if shape is ProductShape.CLUSTER:
        return GraspType.HOOK, f"{millimetres} mm cluster: fingertips go under its stem, so hook"
    if shape in (ProductShape.SLAB, ProductShape.BAG) or height < ROUND_FROM * width:
        return GraspType.PINCH, f"{millimetres} mm {shape.value}: flat, only its faces can be held, so pinch"
    if height < SMALL_BELOW_M:
        return GraspType.PINCH, f"{millimetres} mm {shape.value}: too small to enclose, so pinch"
    return GraspType.POWER, f"{millimetres} mm {shape.value}: round and large enough to enclose, so power"


def _by_demonstration(shares: Sequence[float]) -> tuple[GraspType, float, str]:
    """Return the grasp whose typical shares are nearest, its margin over the next one (0..1), and the reason."""
    if len(shares) != 3 or not all(math.isfinite(share) for share in shares) or abs(sum(shares) - 1.0) > 1e-3:
        raise CatalogueError(f"demonstration: expected three shares that add up to 1, found {list(shares)}")
    distances = sorted((math.dist(shares, typical), grasp) for grasp, typical in TYPICAL_SHARES.items())
    (nearest, grasp), (second, _) = distances[:2]
    margin = (second - nearest) / (second + nearest) if second > 0.0 else 0.0
    parts = ", ".join(f"{share:.0%}" for share in shares)
    return grasp, margin, f"the hand flexed its joints by {parts} (base to tip), which is nearest to {grasp.value}"
