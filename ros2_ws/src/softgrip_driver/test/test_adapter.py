# SPDX-License-Identifier: Apache-2.0
"""USB adapters that keep bytes back, and numbers that change."""

import pytest

from softgrip_driver.dynamixel import port as port_module
from softgrip_driver.dynamixel.adapter import naming_advice, request_low_latency
from softgrip_driver.dynamixel.port import BusPort
from softgrip_driver.errors import PortLostError
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.wizard.setups.dynamixel import measure
from softgrip_emulator.wire.device import Chunk
from softgrip_emulator.wire.usb_adapter import UsbAdapter
from softgrip_time import WallClock


class Serial:
    """A pyserial port that may not know low latency, as a pseudo-terminal does not."""

    fd = 3

    def __init__(self, *_, error=None, **__):
        self.error, self.low_latency = error, False

    def set_low_latency_mode(self, on):
        if self.error:
            raise self.error
        self.low_latency = on

    def reset_input_buffer(self):
        pass


def test_an_open_port_is_asked_for_low_latency(monkeypatch):
    monkeypatch.setattr(port_module, "_PatientSerial", Serial)
    port = BusPort("/dev/ttyUSB0", 1_000_000, 0.004, WallClock())
    port.open()
    assert port.ser.low_latency is True


@pytest.mark.parametrize("error", [ValueError(25, "not a tty"), NotImplementedError(), PermissionError()])
def test_a_port_that_does_not_know_low_latency_is_used_all_the_same(error):
    assert request_low_latency(Serial(error=error)) is False
    assert request_low_latency(Serial()) is True


def test_a_port_is_named_by_what_it_is(tmp_path, monkeypatch):
    (tmp_path / "ttyUSB1").touch()
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "usb-FTDI_U2D2_FT1").symlink_to("../ttyUSB1")
    by_number = naming_advice(str(tmp_path / "ttyUSB1"), tmp_path / "by-id")
    assert "name it" in by_number
    assert "usb-FTDI_U2D2_FT1" in by_number
    gone = naming_advice(str(tmp_path / "ttyUSB0"), tmp_path / "by-id")
    assert "there is" in gone
    assert str(tmp_path / "ttyUSB1") in gone
    assert naming_advice("/dev/ttyACM0", tmp_path / "none") == ""
    monkeypatch.setattr(port_module, "naming_advice", lambda _: gone)
    with pytest.raises(PortLostError, match=r"there is .*usb-FTDI_U2D2_FT1"):
        BusPort(str(tmp_path / "ttyUSB0"), 1_000_000, 0.004, WallClock()).open()


class Talker:
    """Says so many bytes when spoken to."""

    def __init__(self, count):
        self.count = count

    def opened(self, _now_s):
        return []

    def due_s(self):
        return None

    def exchange(self, _data, now_s, _baud):
        return [Chunk(bytes(self.count), now_s)]


@pytest.mark.parametrize(
    ("count", "arrivals"),
    [
        # 20 bytes take 0.2 ms at 1 Mbaud; they wait for the timer. 62 go at once, the 8 of 70 wait.
        (20, [(20, 0.016)]),
        (62, [(62, 0.00062)]),
        (70, [(62, 0.00062), (8, 0.01662)]),
    ],
)
def test_an_emulated_ftdi_hands_over_62_bytes_or_what_there_is_after_its_timer(count, arrivals):
    """FTDI AN232B-04: 62 bytes of data a packet; every packet starts the timer again."""
    chunks = UsbAdapter(Talker(count), 0.016).exchange(b"?", 0.0, 1_000_000)
    reached = [(len(chunk.data), chunk.start_s + len(chunk.data) * 1e-5) for chunk in chunks]
    assert [size for size, _ in reached] == [size for size, _ in arrivals]
    assert [at for _, at in reached] == pytest.approx([at for _, at in arrivals], abs=1e-6)


@pytest.mark.parametrize("bench", [{"rate": 100.0, "latency": 0.016}], indirect=True)
def test_a_driver_behind_sixteen_milliseconds_works_and_names_them(bench):
    """Before, it did not start; with a longer margin every cycle cost so much that each servo was asked four times."""
    said = []
    bench.loop.stop()
    bench.backend.disconnect()
    bench.backend._report = said.append
    bench.backend.connect()
    assert any("16 ms: the USB adapter keeps bytes back" in text and "make udev" in text for text in said)
    bench.loop.start()
    bench.loop.power(on=True)
    asked = bench.backend.counters.transactions
    seen = bench.pass_time(2.0)
    rate = len(seen) / (seen[-1].time - seen[0].time)
    # one group read a cycle at least; a read of one servo in every fourth, and no more
    assert rate > 0.7 / 0.016
    assert (bench.backend.counters.transactions - asked) / len(seen) < 2.5
    assert not any(drive.fault for one in seen for drive in one.drives)
    assert bench.run(bench.loop.call(lambda c, now: c.home(now)), 30.0)[0] is MoveOutcome.REACHED
    assert bench.run(bench.move([0.015], 0.05))[0] is MoveOutcome.REACHED


@pytest.mark.parametrize("bench", [{"rate": 100.0, "latency": 0.016}], indirect=True)
def test_selftest_measures_the_rate_that_the_driver_reaches(bench):
    seen = bench.pass_time(2.0)
    driven = len(seen) / (seen[-1].time - seen[0].time)
    bench.loop.stop()
    found = measure(bench.backend.bus, 2.0)
    assert found.rate == pytest.approx(driven, rel=0.1)
    assert found.turnaround == pytest.approx(0.016, abs=0.002)


def test_every_question_feeds_the_watchdogs_not_the_group_read_alone(bench):
    before = bench.backend.bus.port.last_traffic
    bench.loop.stop()
    bench.world.breathe()
    bench.backend.bus.ping(1)
    assert bench.backend.bus.port.last_traffic > before
