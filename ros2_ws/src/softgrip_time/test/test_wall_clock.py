# SPDX-License-Identifier: Apache-2.0
"""The computer's clock: the same calls as simulated time."""

import os
import time

import pytest

from softgrip_time import WallClock


@pytest.fixture
def pipe():
    read, write = os.pipe()
    yield read, write
    os.close(read)
    os.close(write)


def test_its_time_is_the_monotonic_one_and_its_epoch_the_computers():
    clock = WallClock()
    assert clock.now_s() == pytest.approx(time.monotonic(), abs=0.5)
    assert clock.epoch_ns(clock.now_s() - 10.0) * 1e-9 == pytest.approx(time.time() - 10.0, abs=0.5)


def test_a_wait_ends_with_the_time_or_with_bytes(pipe):
    clock = WallClock()
    read, write = pipe
    until_s = clock.now_s() + 0.02
    with clock.stepping():
        assert clock.wait_readable([read], until_s) == []
        assert clock.now_s() >= until_s
        os.write(write, b"x")
        assert clock.wait_readable([read], until_s - 1.0) == [read]
        with clock.detached():
            clock.wait(clock.now_s() - 1.0)
