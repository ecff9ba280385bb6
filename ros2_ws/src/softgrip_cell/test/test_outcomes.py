# SPDX-License-Identifier: Apache-2.0
"""Success estimates against closed forms of the Beta distribution and against simulated grasping."""

from __future__ import annotations

import random

import pytest
from scipy import stats

from softgrip_cell.outcomes import Tally, estimate
from softgrip_cell.products import TableMark


@pytest.mark.parametrize("mark", list(TableMark))
def test_without_grasps_the_mark_stands(mark: TableMark) -> None:
    assert estimate(mark).mark is mark


def test_counted_grasps_overrule_the_table() -> None:
    assert estimate(TableMark.SUCCESS, Tally(0, 20)).mark is TableMark.FAILURE
    assert estimate(TableMark.FAILURE, Tally(40, 2)).mark is TableMark.SUCCESS


def test_posterior_is_beta_with_jeffreys_prior_and_four_grasps_for_the_mark() -> None:
    found = estimate(TableMark.PARTIAL, Tally(7, 3))
    posterior = stats.beta(0.5 + 2 + 7, 0.5 + 2 + 3)
    assert found.mean == pytest.approx(posterior.mean())
    assert (found.low, found.high) == pytest.approx(posterior.interval(0.95))
    assert found.grasps == 10


def test_interval_covers_the_true_rate_as_often_as_it_says() -> None:
    """Frequentist coverage of Jeffreys' interval is near its nominal 95 % when no mark is known."""
    rng = random.Random(3)
    hits = 0
    for _ in range(2000):
        rate = rng.uniform(0.1, 0.9)
        gripped = sum(rng.random() < rate for _ in range(40))
        found = estimate(None, Tally(gripped, 40 - gripped))
        hits += found.low <= rate <= found.high
    assert 0.93 <= hits / 2000 <= 0.97


def test_negative_counts_are_refused() -> None:
    with pytest.raises(ValueError, match="counts >= 0"):
        Tally(-1, 0)
