# SPDX-License-Identifier: Apache-2.0
"""Tests that run by the machine's clock, on pseudo-terminals: one after another, each with the machine to itself."""

import pytest


@pytest.fixture
def world(real_world):
    """Where the benches stand."""
    return real_world


@pytest.fixture
def wire(bench):
    """The bench's servos, given up by the bench's own driver."""
    bench.loop.stop()
    bench.backend.disconnect()
    return bench
