# SPDX-License-Identifier: Apache-2.0
"""Measured minus predicted over the last hour, with the limits that decide."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from softgrip_panel.model.facts import ResidualView
from softgrip_panel.model.residuals import (
    EVERY_S,
    MAX_SAMPLES,
    ResidualHistory,
    ResidualSample,
    WatchKind,
    WatchLimits,
)
from softgrip_panel.web.charts import check_chart, statistic_chart, tip_chart

INDEX = ResidualView("index", 0.001, 1.0, 0.5, 0.25, "OK", "")
WORDS = ("CUSUM", "friction", "stiffness", "watch", "decided")


def test_a_statistic_that_changes_is_kept_at_once_and_one_that_stays_every_ten_seconds() -> None:
    history = ResidualHistory()
    history.observe(INDEX, 0.0)
    history.observe(INDEX, EVERY_S - 0.1)
    assert [one.at_s for one in history.samples("index")] == [0.0]
    history.observe(replace(INDEX, cusum_friction=3.0), EVERY_S - 0.05)
    assert [one.friction for one in history.samples("index")] == [0.5, 3.0]
    history.observe(replace(INDEX, cusum_friction=3.0), 2 * EVERY_S)
    assert [one.at_s for one in history.samples("index")] == [0.0, EVERY_S - 0.05, 2 * EVERY_S]
    assert history.fingers == ("index",)
    assert history.samples("thumb") == ()


def test_an_hour_is_kept_and_no_more() -> None:
    history = ResidualHistory()
    for number in range(MAX_SAMPLES + 10):
        history.observe(INDEX, EVERY_S * number)
    samples = history.samples("index")
    assert (len(samples), samples[0].at_s) == (MAX_SAMPLES, 10 * EVERY_S)
    assert samples[-1].at_s - samples[0].at_s == pytest.approx(3600.0, abs=EVERY_S)


@pytest.mark.parametrize(
    ("watch", "kind", "low", "high"),
    [("shifts", WatchKind.SHIFTS, 2.5, 5.0), ("causes", WatchKind.CAUSES, 6.0, 15.0)],
)
def test_the_limits_are_those_of_what_the_predictor_watches(
    watch: str, kind: WatchKind, low: float, high: float
) -> None:
    assert WatchLimits.of(watch, 6.0, 15.0, 5.0) == WatchLimits(kind, low, high)


def test_what_is_not_known_has_no_limit() -> None:
    assert not WatchLimits.of("something else", 6.0, 15.0, 5.0).kind
    drawn = statistic_chart([ResidualSample(0.0, 0.001, 0.5, 0.25)], WatchLimits(), "", "", WORDS)
    assert 'class="limit"' not in drawn


def heights(drawn: str, name: str) -> list[float]:
    """Return the height of the last point of each line of a kind [px]."""
    found = re.findall(rf'class="{name}" d="[^"]* L[0-9.]+ ([0-9.]+)"', drawn)
    return [float(one) for one in found]


def test_a_statistic_at_its_limit_is_drawn_on_the_limits_line() -> None:
    samples = [ResidualSample(0.0, 0.001, 0.0, 0.0), ResidualSample(60.0, 0.001, 5.0, 2.5)]
    drawn = statistic_chart(samples, WatchLimits.of("shifts", 6.0, 15.0, 5.0), "", "", WORDS)
    friction, stiffness = heights(drawn, "statistic")
    low, high = heights(drawn, "limit")
    assert (friction, stiffness) == (high, low)
    assert high < low  # up is less, on a screen
    for word in ("watch 2.5", "decided 5"):
        assert f">{word}<" in drawn


def test_the_tip_is_drawn_in_millimetres_of_every_finger() -> None:
    samples = [ResidualSample(0.0, 0.002, 0.0, 0.0), ResidualSample(30.0, 0.004, 0.0, 0.0)]
    drawn = tip_chart([("index", samples), ("thumb", samples[:1])], "", "", "")
    assert drawn.count('class="tip"') == 2
    assert ">4<" in drawn  # of the axis


def test_a_value_that_is_none_is_left_out() -> None:
    samples = [ResidualSample(0.0, 0.001, math.nan, 1.0), ResidualSample(60.0, 0.001, math.nan, 2.0)]
    drawn = statistic_chart(samples, WatchLimits(), "", "", WORDS)
    assert drawn.count('class="statistic"') == 1
    assert "nan" not in drawn


def test_a_check_is_drawn_in_millimetres_and_newtons() -> None:
    drawn = check_chart([(0.0, 0.0), (0.01, 4.0), (0.02, 9.0)], "", "", "")
    assert ">20<" in drawn
    assert ">8<" in drawn
