# SPDX-License-Identifier: Apache-2.0
"""Closings beside calm ones: the numbers are those of means of independent normal deviations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softgrip_model.finger.closing_difference import ClosingDifference, ClosingResidual, ClosingScatter

SAMPLES, CALM = 4, 12
#: Of one closing about the calm mean: tips [mm], tension [N].
STDDEV = np.concatenate([np.full(2 * SAMPLES, 0.3), np.full(SAMPLES, 0.05)])
USUAL = ClosingScatter(np.linspace(-1.0, 1.0, 3 * SAMPLES), np.diag(STDDEV**2))
#: One standard deviation of one tip.
ONE = np.eye(3 * SAMPLES)[2] * STDDEV


def closing(change: np.ndarray) -> ClosingResidual:
    """Return a closing that differs so from the calm mean."""
    lengths = np.arange(1.0, SAMPLES + 1.0)
    return ClosingResidual(lengths, lengths, USUAL.mean + change, np.zeros((3 * SAMPLES, 3)), 0)


@pytest.mark.parametrize("count", [1, 2, 5, 12])
def test_a_small_change_shows_in_the_mean_of_many(count: int) -> None:
    """Means of n and of m closings differ by a standard deviation of sqrt(1/n + 1/m) by chance."""
    found = ClosingDifference.of(USUAL, CALM, [closing(2.0 * ONE)] * count)
    assert found.squared == pytest.approx(4.0 / (1.0 / count + 1.0 / CALM))
    assert found.beyond_chance == pytest.approx(found.squared - 3 * SAMPLES)
    assert found.residual == pytest.approx(2.0 * ONE)
    assert found.root == pytest.approx(math.sqrt(1.0 / count + 1.0 / CALM) * np.diag(STDDEV))


def test_closings_that_differ_among_themselves_have_no_mean() -> None:
    """The squares of n normal deviations about their mean are n - 1 by chance, give or take sqrt(2 (n - 1))."""
    chance, deviation = 11, math.sqrt(22.0)
    same = ClosingDifference.of(USUAL, CALM, [closing(8.0 * ONE)] * 12)
    assert same.spread == pytest.approx(-chance / deviation)
    half = ClosingDifference.of(USUAL, CALM, [closing(0.0 * ONE)] * 6 + [closing(8.0 * ONE)] * 6)
    assert half.spread == pytest.approx((12 * 4.0**2 - chance) / deviation)
    once = ClosingDifference.of(USUAL, CALM, [closing(8.0 * ONE)] + [closing(0.0 * ONE)] * 11)
    assert once.spread == pytest.approx((64.0 - 64.0 / 12.0 - chance) / deviation)
    assert ClosingDifference.of(USUAL, CALM, [closing(8.0 * ONE)]).spread == 0.0
    assert ClosingDifference.of(USUAL, CALM, [closing(0.0 * ONE)] * 2).spread == pytest.approx(-1.0 / math.sqrt(2.0))
