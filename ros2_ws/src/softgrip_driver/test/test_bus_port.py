# SPDX-License-Identifier: Apache-2.0
"""Writing to the servos' port: a computer that pauses is no port that hangs."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Iterator

import pytest
import serial

from softgrip_driver.dynamixel import port as port_module
from softgrip_driver.dynamixel.port import BusPort
from softgrip_time import WallClock


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[BusPort, int]]:
    """Return an open port with a short limit, and the device's end of it."""
    monkeypatch.setattr(port_module, "WRITE_TIMEOUT_S", 0.05)
    master, slave = os.openpty()
    tty.setraw(slave)
    port = BusPort(os.ttyname(slave), 1_000_000, 0.004, WallClock())
    port.open()
    yield port, master
    port.close()
    os.close(master)
    os.close(slave)


def test_a_computer_that_pauses_after_a_write_loses_no_port(
    ends: tuple[BusPort, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    port, device = ends
    write = os.write

    def pausing(file: int, data: bytes) -> int:
        written = write(file, data[:5])
        time.sleep(0.1)  # longer than the limit
        return written

    monkeypatch.setattr(os, "write", pausing)
    assert port.writePort(list(range(14))) == 14
    assert os.read(device, 100) == bytes(range(14))


def test_a_port_that_takes_nothing_hangs(ends: tuple[BusPort, int]) -> None:
    port, _ = ends
    with pytest.raises(serial.SerialTimeoutException, match="Write timeout"):
        port.writePort(bytes(1_000_000))  # more than a terminal holds
