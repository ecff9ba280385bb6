# SPDX-License-Identifier: Apache-2.0
"""Waiting in tests: for a condition, with a deadline."""

from __future__ import annotations

import time
from collections.abc import Callable

#: [s] for whatever a test waits for; a busy machine takes its time
TEST_TIMEOUT_S = 60.0


def wait_until(
    condition: Callable[[], object],
    expected: object = "what it waits for",
    timeout_s: float = TEST_TIMEOUT_S,
    period_s: float = 0.01,
) -> None:
    """Wait until a condition holds.

    Args:
        condition: asked again and again.
        expected: shown where the time is up.
        timeout_s: [s] it may take.
        period_s: [s] between two questions.

    Raises:
        AssertionError: the time is up.
    """
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s, f"expected {expected} within {timeout_s} s"
        time.sleep(period_s)
