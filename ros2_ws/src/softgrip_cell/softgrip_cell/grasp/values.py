# SPDX-License-Identifier: Apache-2.0
"""What a grasp is asked for and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from softgrip_cell.grasp.contact import ContactState, FingerContact
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

    @property
    def paths_m(self) -> tuple[float, ...]:
        """End of each finger's path [m]: what the recipe allows, but never beyond what was checked."""
        return tuple(min(self.recipe.pull_limit_m, reference.reach_m) for reference in self.references)


@dataclass(frozen=True)
class FingerEvidence:
    """What a verdict knew of one finger.

    Attributes:
        finger: name of the slot.
        contact_tension_n: tension beside the free motion [N]; threshold_n: from which it is a contact [N];
            stddev_n: its standard deviation while nothing is touched [N].
        peak_contact_tension_n: greatest one short of the finger's end [N].
        max_force_n: greatest contact force that it can mean [N].
        tip_deviation_m: distance of the seen from the predicted fingertip [m]; None when not seen just now.
    """

    finger: str
    state: ContactState
    contact_tension_n: float
    threshold_n: float
    stddev_n: float
    peak_contact_tension_n: float
    max_force_n: float
    tip_deviation_m: float | None = None


@dataclass(frozen=True)
class GraspEvidence:
    """The numbers behind a verdict; no fingers before the first sample.

    Attributes:
        phase: in which it was decided.
        decided_ns: stamp of the deciding sample; 0 when no sample decided.
    """

    phase: GraspPhase = GraspPhase.DONE
    decided_ns: int = 0
    fingers: tuple[FingerEvidence, ...] = ()


@dataclass(frozen=True)
class GraspVerdict:
    """How a grasp ended and why.

    Attributes:
        reason: evidence in words.
        latency_s: from the first sample that showed the deciding event to the sample that decided [s].
        evidence: the numbers behind it; None when nothing was observed.
    """

    outcome: GraspOutcome
    reason: str
    latency_s: float
    evidence: GraspEvidence | None = None


def contact_text(slots: tuple[str, ...], contacts: tuple[FingerContact, ...]) -> str:
    """Return the contact tension of every finger in words."""
    parts = [
        f"{name} {contact.contact_tension_n:+.1f} (contact from {contact.threshold_n:.1f})"
        for name, contact in zip(slots, contacts, strict=True)
    ]
    return "contact tension [N] " + ", ".join(parts)


def pulled_text(slots: tuple[str, ...], contacts: tuple[FingerContact, ...]) -> str:
    """Return the pulled length of every finger in words."""
    parts = [f"{name} {contact.pulled_length_m * 1e3:.1f}" for name, contact in zip(slots, contacts, strict=False)]
    return "pulled length [mm] " + ", ".join(parts)
