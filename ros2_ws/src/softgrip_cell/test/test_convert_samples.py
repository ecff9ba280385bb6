# SPDX-License-Identifier: Apache-2.0
"""What of a tendon/state becomes a sample: one that lacks a slot or holds a number that is none becomes nothing."""

from __future__ import annotations

import math

import pytest
from sensor_msgs.msg import JointState

from softgrip_cell.nodes.convert import tendon_sample

SLOTS = ("index", "middle", "thumb")


def message(**columns: list[object]) -> JointState:
    made = JointState()
    made.header.stamp.sec, made.header.stamp.nanosec = 3, 7
    made.name = columns.get("name", ["thumb", "index", "middle"])
    made.position = columns.get("position", [0.003, 0.001, 0.002])
    made.effort = columns.get("effort", [3.0, 1.0, 2.0])
    return made


def test_columns_are_put_into_slot_order() -> None:
    sample = tendon_sample(message(), SLOTS)
    assert sample is not None
    assert sample.stamp_ns == 3_000_000_007
    assert (sample.pulled_m, sample.tension_n) == ((0.001, 0.002, 0.003), (1.0, 2.0, 3.0))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", ["position", "effort"])
@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_none_makes_no_sample(column: str, place: int, value: float) -> None:
    """A comparison with NaN is false: a touch would never be felt, a broken tendon never be seen."""
    values = [0.001, 0.002, 0.003]
    values[place] = value
    assert tendon_sample(message(**{column: values}), SLOTS) is None


@pytest.mark.parametrize(
    "columns",
    [
        {"name": ["thumb", "index"]},
        {"name": ["thumb", "index", "toe"]},
        {"name": ["thumb", "index", "index"]},
        {"position": [0.001, 0.002]},
        {"effort": []},
    ],
    ids=["a name short", "another name", "a name twice", "a length short", "no tensions"],
)
def test_a_message_that_does_not_fit_makes_no_sample(columns: dict[str, list[object]]) -> None:
    assert tendon_sample(message(**columns), SLOTS) is None
