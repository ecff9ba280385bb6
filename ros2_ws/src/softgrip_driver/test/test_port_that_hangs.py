# SPDX-License-Identifier: Apache-2.0
"""A serial adapter that takes no bytes any more: a write ends, and says so."""

import os
import pty
import termios
import tty

import pytest

from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.errors import PortLostError
from softgrip_driver.rig.line_port import LinePort


@pytest.fixture
def hanging():
    """A pseudo-terminal whose output is stopped, as by flow control, with nobody who reads."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    termios.tcflow(slave, termios.TCOOFF)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def flood(write) -> None:
    """Write until the adapter takes no more."""
    for _ in range(2000):
        write()


def test_a_bus_whose_adapter_hangs_is_lost(hanging):
    bus = Bus(hanging, 1_000_000, 0.004)
    bus.open()
    with pytest.raises(PortLostError, match="imeout"):
        flood(lambda: bus.push_through(0.01))
    bus.close()


def test_a_line_port_whose_adapter_hangs_is_lost(hanging):
    port = LinePort(hanging, 115200)
    port.open()
    with pytest.raises(PortLostError):
        flood(lambda: port.write(b"x" * 1000))
    port.close()
