# SPDX-License-Identifier: Apache-2.0
"""One row of a parameter table at its bounds, without a node."""

from __future__ import annotations

import array
import math
from typing import Any

import pytest

from softgrip_nodekit import Parameter

LIMIT = Parameter("limit", 20.0, "of a tension", "N", 0.5, 35.0)
COUNT = Parameter("count", 3, "of something", minimum=1, maximum=8)
POLICY = Parameter("policy", "hold", "what a stop does", choices=("hold", "let_go"))


@pytest.mark.parametrize("value", [0.5, 20.0, 35.0, [0.5, 35.0], array.array("d", [0.5, 35.0]), (1.0,)])
def test_bounds_themselves_are_allowed(value: Any) -> None:
    assert LIMIT.problem(value) is None


@pytest.mark.parametrize("value", [0.4999, 35.0001, math.nan, math.inf, -math.inf, -1.0])
def test_what_lies_beyond_or_is_no_number_is_named_wherever_it_stands(value: float) -> None:
    expected = f"parameter 'limit': expected 0.5 .. 35 N, found {value}"
    assert LIMIT.problem(value) == expected
    for place in range(3):
        values = [1.0, 1.0, 1.0]
        values[place] = value
        assert LIMIT.problem(values) == expected
        assert LIMIT.problem(array.array("d", values)) == expected


@pytest.mark.parametrize(("value", "allowed"), [(0, False), (1, True), (8, True), (9, False)])
def test_counts_have_bounds_too(value: int, allowed: bool) -> None:
    assert (COUNT.problem(value) is None) is allowed


def test_one_choice_out_of_those_there_are() -> None:
    assert POLICY.problem("hold") is None
    assert POLICY.problem("Hold") == "parameter 'policy': expected one of ['hold', 'let_go'], found 'Hold'"


@pytest.mark.parametrize("changeable", [True, False])
def test_what_may_not_change_while_the_node_runs_says_so(changeable: bool) -> None:
    assert Parameter("port", "/dev/x", "of the bus", changeable=changeable).descriptor().read_only is not changeable
