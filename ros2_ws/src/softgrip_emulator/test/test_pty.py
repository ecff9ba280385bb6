# SPDX-License-Identifier: Apache-2.0
"""The pseudo-terminal as a serial cable: pacing, plugging, faults on the way."""

import time
from pathlib import Path

import pytest
import serial

from softgrip_emulator.wire.device import Chunk
from softgrip_emulator.wire.faulty import FaultyWire
from softgrip_emulator.wire.pty import PtyPort


class Reverser:
    """Says hello when opened, sends back what it gets, reversed; tells the time on its own."""

    def __init__(self):
        self.bauds = set()
        self.next_s = None

    def opened(self, now_s):
        return [Chunk(b"hello", now_s)]

    def exchange(self, data, now_s, baud):
        self.bauds.add(baud)
        if not data:
            self.next_s = None
            return [Chunk(b"tick", now_s)]
        if data == b"fail":
            raise RuntimeError("device failed on purpose")
        return [Chunk(data[::-1], now_s)]

    def due_s(self):
        return self.next_s


@pytest.fixture
def device():
    return Reverser()


@pytest.fixture
def port(device, tmp_path):
    with PtyPort(tmp_path / "deep" / "wire", device) as port:
        yield port


def open_serial(port, baud=115_200):
    return serial.Serial(str(port.link), baud, timeout=2)


def test_greets_answers_and_knows_the_host_baud(port, device):
    with open_serial(port, 3_000_000) as host:
        assert host.read(5) == b"hello"
        host.write(b"\x00\r\n\xff\x03\x11\x13")
        assert host.read(7) == b"\x13\x11\x03\xff\n\r\x00"
        host.baudrate = 57_600
        host.write(b"ab")
        assert host.read(2) == b"ba"
    assert device.bauds == {3_000_000, 57_600}


def test_a_reply_takes_at_least_its_time_on_the_wire(port):
    with open_serial(port, 9600) as host:
        host.read(5)
        began_s = time.monotonic()
        host.write(bytes(48))
        assert host.read(48) == bytes(48)
        # 96 bytes of 10 bits at 9600 bit/s
        assert time.monotonic() - began_s >= 0.100


def test_speaks_unasked_when_due(port, device):
    with open_serial(port) as host:
        host.read(5)
        device.next_s = port.clock.now_s()
        host.write(b"x")
        assert host.read(5) == b"xtick"


def test_a_new_host_gets_nothing_of_the_old_ones_talk(port, until):
    with open_serial(port, 9600) as host:
        host.read(5)
        host.write(bytes(200))
    assert until(lambda: not port.attached)
    with open_serial(port, 9600) as host:
        assert host.read(5) == b"hello"


def test_unplugged_the_host_gets_an_error_and_plugged_in_again_it_works(port):
    host = open_serial(port)
    host.read(5)
    port.unplug()
    assert not port.link.exists()
    with pytest.raises((serial.SerialException, OSError)):
        host.read(1)
    host.close()
    port.plug()
    with open_serial(port) as again:
        assert again.read(5) == b"hello"


def test_a_failing_device_does_not_take_its_port_down(port, caplog):
    with open_serial(port) as host:
        host.read(5)
        host.write(b"fail")
        time_over_s = time.monotonic() + 2
        while "failed on this exchange" not in caplog.text and time.monotonic() < time_over_s:
            host.write(b"")
        host.write(b"ab")
        assert host.read(2) == b"ba"
    assert "device failed on purpose" in caplog.text


def test_closing_leaves_neither_link_nor_thread_nor_descriptor(device, tmp_path):
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        with PtyPort(tmp_path / "wire", device):
            pass
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        ({"lost": 1.0}, lambda _, got: got == b""),
        ({"lost": 0.3}, lambda sent, got: 0 < len(got) < len(sent)),
        ({"flipped": 1.0}, lambda sent, got: len(got) == len(sent) and got != sent),
        ({"duplicated": 1.0}, lambda sent, got: len(got) == 4 * len(sent)),
        ({"spoiled": 1.0}, lambda sent, got: got[:-1] == sent[:-1] and got[-1] != sent[-1]),
        ({"dead": True}, lambda _, got: got == b""),
        ({}, lambda sent, got: got == sent),
    ],
)
def test_a_bad_cable(device, fault, check):
    wire = FaultyWire(device, seed=1)
    for name, value in fault.items():
        setattr(wire.faults, name, value)
    sent = bytes(range(1, 41))
    got = b"".join(chunk.data for chunk in wire.exchange(sent[::-1], 0.0, 9600))
    assert check(sent, got)


def test_a_slow_cable(device):
    wire = FaultyWire(device, seed=1)
    wire.faults.delay_s = 0.25
    (chunk,) = wire.exchange(b"ab", 1.0, 9600)
    assert chunk.start_s == 1.25
