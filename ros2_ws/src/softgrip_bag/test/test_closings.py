# SPDX-License-Identifier: Apache-2.0
"""Which frames are a free closing: by hand."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from softgrip_bag.closings import FingerFrame, free_closings

SECOND = 1_000_000_000


def frames(pulled_mm: Sequence[float], *, can_close: bool = True, begin_s: int = 0) -> list[FingerFrame]:
    return [
        FingerFrame((begin_s + i) * SECOND, 1e-3 * mm, (0.09, 0.0), (0.09, 0.0), (0.0,), (0.0,), can_close)
        for i, mm in enumerate(pulled_mm)
    ]


def pulled_mm(runs: list[list[FingerFrame]]) -> list[list[float]]:
    return [[round(1e3 * frame.pulled_m, 3) for frame in run] for run in runs]


def test_a_closing_is_what_moves_between_two_rests() -> None:
    found = free_closings(frames([0.1, 0.1, 2.0, 4.0, 8.0, 8.0, 8.01, 5.0, 1.0, 0.0]))
    assert pulled_mm(found) == [[2.0, 4.0, 8.0]]


def test_two_closings_are_two() -> None:
    assert pulled_mm(free_closings(frames([0.0, 3.0, 6.0, 0.0, 4.0, 8.0]))) == [[3.0, 6.0], [4.0, 8.0]]


def test_a_tremor_ends_no_closing() -> None:
    assert pulled_mm(free_closings(frames([0.0, 3.0, 2.95, 6.0]))) == [[3.0, 6.0]]


@pytest.mark.parametrize(
    "pulled",
    [
        pytest.param([0.0, -4.0, -7.7, -3.0, 0.0, 5.5], id="homing: let out until slack, then wound in"),
        pytest.param([14.0, 9.0, 4.0, 0.0], id="opening"),
        pytest.param([5.0, 7.0, 9.0, 12.0], id="on from half way"),
        pytest.param([0.0, 1.0, 3.0], id="a twitch"),
    ],
)
def test_what_is_no_closing(pulled: list[float]) -> None:
    assert free_closings(frames(pulled)) == []


def test_a_grasp_or_a_fault_on_the_way_ends_it() -> None:
    assert free_closings(frames([0.0, 4.0, 8.0], can_close=False)) == []
    parts = frames([0.0, 2.0]), frames([4.0], can_close=False, begin_s=2), frames([6.0, 9.0], begin_s=3)
    assert free_closings([frame for part in parts for frame in part]) == []


def test_nothing_seen_is_no_closing() -> None:
    assert free_closings([]) == []
