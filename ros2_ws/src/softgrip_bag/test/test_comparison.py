# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

from softgrip_bag.comparison import first_difference

NONE: frozenset[str] = frozenset()


def test_equal_trees_have_no_difference_and_nan_equals_nan() -> None:
    tree = {"a": 1.0, "b": [math.nan, {"c": "x"}], "d": []}
    assert first_difference(tree, {"a": 1.0, "b": [math.nan, {"c": "x"}], "d": []}, NONE) is None


def test_one_bit_is_found_with_its_path() -> None:
    value = 0.1
    other = math.nextafter(value, 1.0)
    assert first_difference({"a": {"b": [0.0, value]}}, {"a": {"b": [0.0, other]}}, NONE) == ("a.b[1]", value, other)


def test_other_length_and_nan_against_number_differ() -> None:
    assert first_difference({"a": [1, 2]}, {"a": [1]}, NONE) == ("a.length", 2, 1)
    found = first_difference({"a": math.nan}, {"a": 0.0}, NONE)
    assert found is not None
    assert found[0] == "a"


def test_skipped_fields_are_not_compared() -> None:
    assert first_difference({"t": 1.0, "x": 2}, {"t": 9.0, "x": 2}, frozenset({"t"})) is None


def test_a_tolerance_is_relative_with_a_floor_and_for_numbers_with_a_fraction_only() -> None:
    assert first_difference({"a": 100.0}, {"a": 100.00005}, NONE, tolerance=1e-6) is None
    assert first_difference({"a": 100.0}, {"a": 100.0002}, NONE, tolerance=1e-6) is not None
    assert first_difference({"a": 1e-12}, {"a": -1e-12}, NONE, tolerance=1e-6) is None
    assert first_difference({"a": 1_000_000_000}, {"a": 1_000_000_001}, NONE, tolerance=1e-6) is not None
    assert first_difference({"a": math.nan}, {"a": 1.0}, NONE, tolerance=1e-6) is not None
