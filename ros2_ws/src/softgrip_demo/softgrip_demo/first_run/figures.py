# SPDX-License-Identifier: Apache-2.0
"""A figure beside its bound, and what a step of the checklist came to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum


class StepStatus(StrEnum):
    """How a step ended."""

    GOOD = "good"
    BAD = "bad"
    LEFT_OUT = "left out"


@dataclass(frozen=True)
class Figure:
    """One measured value beside its bound.

    Attributes:
        name: what was measured.
        found: with its unit.
        bound: what was expected.
        is_good: whether it is within.
        remedy: what to do where it is not.
        remark: what a reader must know of a figure that is within, such as that it was not measured; empty else.
    """

    name: str
    found: str
    bound: str
    is_good: bool
    remedy: str = ""
    remark: str = ""

    def with_remark(self, remark: str) -> Figure:
        """Return the figure with what a reader must know of it."""
        return replace(self, remark=remark)


def at_most(name: str, value: float, bound: float, unit: str, remedy: str) -> Figure:
    """Return the figure of a value that must not be above a bound."""
    return Figure(name, f"{value:.3g} {unit}".strip(), f"at most {bound:g} {unit}".strip(), value <= bound, remedy)


def at_least(name: str, value: float, bound: float, unit: str, remedy: str) -> Figure:
    """Return the figure of a value that must not be below a bound."""
    return Figure(name, f"{value:.3g} {unit}".strip(), f"at least {bound:g} {unit}".strip(), value >= bound, remedy)


def within(name: str, value: float, bounds: tuple[float, float], unit: str, remedy: str) -> Figure:
    """Return the figure of a value that must lie between two bounds."""
    low, high = bounds
    return Figure(name, f"{value:.3g} {unit}", f"{low:g} to {high:g} {unit}", low <= value <= high, remedy)


def equal_to(name: str, found: object, expected: object, remedy: str) -> Figure:
    """Return the figure of something that must be as expected."""
    return Figure(name, str(found), str(expected), found == expected, remedy)


@dataclass(frozen=True)
class StepReport:
    """What a step came to.

    Attributes:
        key, title: of the step.
        status: how it ended.
        figures: in the order they were measured.
        problem: why it could not be measured, or why it was left out; empty else.
        ended_at: UTC, ISO 8601.
    """

    key: str
    title: str
    status: StepStatus
    figures: tuple[Figure, ...] = ()
    problem: str = ""
    ended_at: str = ""

    @property
    def remarks(self) -> list[str]:
        """What a reader must know of figures that are within their bounds."""
        return [f"{one.name}: {one.remark}" for one in self.figures if one.is_good and one.remark]

    @property
    def complaints(self) -> list[str]:
        """What is wrong, each with its remedy."""
        bad = [
            f"{one.name}: expected {one.bound}, found {one.found}; {one.remedy}"
            for one in self.figures
            if not one.is_good
        ]
        return bad + ([self.problem] if self.status is StepStatus.BAD and self.problem else [])
