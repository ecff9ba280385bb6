# SPDX-License-Identifier: Apache-2.0
"""Seconds and nanoseconds."""

from __future__ import annotations

import numpy as np
import pytest

from softgrip_time.units import NANOSECONDS, to_ns, to_s


@pytest.mark.parametrize(("time_s", "time_ns"), [(0.0, 0), (0.25, 250_000_000), (-1.5, -1_500_000_000), (1e-9, 1)])
def test_there_and_back(time_s: float, time_ns: int) -> None:
    assert to_ns(time_s) == time_ns
    assert to_s(time_ns) == pytest.approx(time_s, abs=1e-12)


def test_arrays_keep_their_shape() -> None:
    found = to_s(np.array([[0, NANOSECONDS], [2 * NANOSECONDS, 1]]))
    assert found == pytest.approx(np.array([[0.0, 1.0], [2.0, 1e-9]]))
