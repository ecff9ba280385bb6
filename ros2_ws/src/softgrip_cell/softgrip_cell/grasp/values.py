# SPDX-License-Identifier: Apache-2.0
"""What a grasp is asked for, what it tells the driver, and what comes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.products import Product, Recipe


class GraspPhase(StrEnum):
    """Where a grasp stands (Grasp.action feedback)."""

    APPROACH = "approach"
    CLOSE = "close"
    HOLD = "hold"
    LIFT = "lift"
    DONE = "done"


class GraspOutcome(StrEnum):
    """How a grasp ended (Grasp.action result)."""

    GRIPPED = "GRIPPED"
    EMPTY = "EMPTY"
    SLIPPED = "SLIPPED"
    TENDON_FAULT = "TENDON_FAULT"
    ABORTED = "ABORTED"


@dataclass(frozen=True)
class GraspTask:
    """A product to be taken with verified fingers.

    Attributes:
        slots: names, in slot order.
        references: free motion of the finger in each slot.
        thumb: index of the slot that presses against the others.
        opposed: the thumb has to press; a hook carries with the fingers alone.
        confirm_lift: watch the hold for the lift window before saying GRIPPED.
    """

    product: Product
    recipe: Recipe
    slots: tuple[str, ...]
    references: tuple[FreeReference, ...]
    thumb: int
    confirm_lift: bool
    opposed: bool = True


@dataclass(frozen=True)
class Open:
    """Let the fingers go back to straight."""


@dataclass(frozen=True)
class Close:
    """Pull these slots to these lengths; the others stay where they are."""

    slots: tuple[int, ...]
    targets_m: tuple[float, ...]
    speed_m_per_s: float
    tension_limit_n: float


@dataclass(frozen=True)
class Press:
    """Keep a tension [N] in these slots and follow an object that gives way, at most so fast [m/s]."""

    slots: tuple[int, ...]
    tensions_n: tuple[float, ...]
    speed_m_per_s: float


@dataclass(frozen=True)
class Stop:
    """Stop all slots and keep them where they are."""


Command = Open | Close | Press | Stop


@dataclass(frozen=True)
class GraspVerdict:
    """How a grasp ended and why.

    Attributes:
        reason: evidence in words.
        latency_s: from the first sample that showed the deciding event to the sample that decided [s].
        evidence: the numbers behind it, plain data.
    """

    outcome: GraspOutcome
    reason: str
    latency_s: float
    evidence: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class GraspStep:
    """What follows from one observation; usually nothing."""

    phase: GraspPhase
    commands: tuple[Command, ...] = ()
    verdict: GraspVerdict | None = None
    contact: bool = False
