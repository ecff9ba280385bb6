# SPDX-License-Identifier: Apache-2.0
"""How often a finger set holds a product: the table's mark as prior knowledge, counted grasps on top."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from softgrip_cell.products import TableMark

#: Success rate that a mark of Table 4.2 stands for.
MARK_RATE: Final = {TableMark.SUCCESS: 1.0, TableMark.PARTIAL: 0.5, TableMark.FAILURE: 0.0}

#: How many counted grasps a mark weighs as much as: the thesis does not say how often each was tried.
MARK_WEIGHT: Final = 4.0

#: Jeffreys' prior of a rate: half a success and half a failure.
JEFFREYS: Final = 0.5

#: Rates from which a finger set is marked as succeeding or as succeeding in part.
SUCCESS_FROM: Final = 0.75
PARTIAL_FROM: Final = 0.25


@dataclass(frozen=True)
class Tally:
    """Counted grasps of one product with one finger set; aborted ones and tendon faults say nothing about it."""

    gripped: int = 0
    failed: int = 0

    def __post_init__(self) -> None:
        if self.gripped < 0 or self.failed < 0:
            raise ValueError(f"expected counts >= 0, found {self.gripped} gripped, {self.failed} failed")


@dataclass(frozen=True)
class SuccessEstimate:
    """Probability that a grasp holds: a Beta distribution.

    Attributes:
        a, b: its parameters.
        grasps: counted grasps behind it.
    """

    a: float
    b: float
    grasps: int

    @property
    def mean(self) -> float:
        """Posterior mean [0..1]."""
        return self.a / (self.a + self.b)

    @property
    def low(self) -> float:
        """Lower end of the equal-tailed 95 % credible interval [0..1]."""
        return self._quantile(0.025)

    @property
    def high(self) -> float:
        """Upper end of the equal-tailed 95 % credible interval [0..1]."""
        return self._quantile(0.975)

    def _quantile(self, share: float) -> float:
        # 30 MB and a third of a second that a plan has and a grasp has not.
        from scipy.special import betaincinv  # noqa: PLC0415

        return float(betaincinv(self.a, self.b, share))

    @property
    def mark(self) -> TableMark:
        """The mark of Table 4.2 that this rate stands for."""
        if self.mean >= SUCCESS_FROM:
            return TableMark.SUCCESS
        return TableMark.PARTIAL if self.mean >= PARTIAL_FROM else TableMark.FAILURE


def estimate(mark: TableMark | None, tally: Tally = Tally()) -> SuccessEstimate:
    """Combine a mark (None: never tried) with counted grasps by Bayes' rule for a rate (Beta-binomial)."""
    weight = 0.0 if mark is None else MARK_WEIGHT
    rate = 0.0 if mark is None else MARK_RATE[mark]
    return SuccessEstimate(
        a=JEFFREYS + weight * rate + tally.gripped,
        b=JEFFREYS + weight * (1.0 - rate) + tally.failed,
        grasps=tally.gripped + tally.failed,
    )
