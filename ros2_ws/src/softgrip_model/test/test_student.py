# SPDX-License-Identifier: Apache-2.0
"""Quantiles and tails against closed forms."""

from __future__ import annotations

import math

import pytest

from softgrip_model.friction.student import f_tail, t_quantile, t_tail


def test_student_t_with_one_two_and_infinite_degrees_of_freedom() -> None:
    assert t_quantile(0.975, 1) == pytest.approx(math.tan(math.pi * 0.475))  # Cauchy
    assert t_quantile(0.9, 2) == pytest.approx(0.8 / math.sqrt(2 * 0.9 * 0.1))
    assert t_quantile(0.975, math.inf) == pytest.approx(1.959963984540054)
    assert t_tail([0.0, 1.0, 3.0], 1) == pytest.approx([0.5, 0.25, 0.5 - math.atan(3.0) / math.pi])


def test_f_with_two_numerator_degrees_of_freedom() -> None:
    assert f_tail(1.7, (2, 8)) == pytest.approx((1 + 2 * 1.7 / 8) ** -4)
