# SPDX-License-Identifier: Apache-2.0
"""USB adapters that keep bytes back, and numbers that change."""

from dataclasses import replace

import pytest

from softgrip_driver.damiao import frames
from softgrip_driver.damiao.frames import DamiaoState
from softgrip_driver.dynamixel import port as port_module
from softgrip_driver.dynamixel.port import BusPort
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError, PortLostError
from softgrip_driver.feetech import registers as feetech
from softgrip_driver.feetech.backend import FeetechBackend
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.usb_adapter import naming_advice, request_low_latency
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
    adapter = UsbAdapter(Talker(count), 0.016)
    chunks = [*adapter.exchange(b"?", 0.0, 1_000_000)]
    while (due := adapter.due_s()) is not None:
        chunks += adapter.exchange(b"", due, 1_000_000)
    reached = [(len(chunk.data), chunk.start_s + len(chunk.data) * 1e-5) for chunk in chunks]
    assert [size for size, _ in reached] == [size for size, _ in arrivals]
    assert [at for _, at in reached] == pytest.approx([at for _, at in arrivals], abs=1e-6)


def test_an_emulated_ftdi_hands_over_what_two_questions_brought_when_its_timer_runs_out():
    adapter = UsbAdapter(Talker(20), 0.016)
    assert not adapter.exchange(b"?", 0.0, 1_000_000)
    assert not adapter.exchange(b"?", 0.005, 1_000_000)
    assert adapter.due_s() == pytest.approx(0.016)
    (chunk,) = adapter.exchange(b"", adapter.due_s(), 1_000_000)
    assert len(chunk.data) == 40
    assert adapter.due_s() is None


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


LATENCIES_S = (0.001, 0.002, 0.004, 0.008, 0.016)
OTHER_MODELS = ("STS3215", "DM-J4310-2EC")


@pytest.fixture
def late_bench(tmp_path, world, benches, request):
    """An opened bench behind an adapter that keeps bytes back, with what its driver has said."""
    said = []
    one = benches[0](tmp_path, world, report=said.append, **request.param)
    one.said = said
    try:
        yield one.open()
    finally:
        one.close()


def behind(*latencies_s, models=OTHER_MODELS):
    settings = [{"model": model, "latency": late, "rate": 200.0} for model in models for late in latencies_s]
    ids = [f"{one['model']}-{one['latency'] * 1e3:g}ms" for one in settings]
    return pytest.mark.parametrize("late_bench", settings, ids=ids, indirect=True)


@behind(*LATENCIES_S)
def test_other_drives_behind_an_adapter_lose_nothing_home_and_name_it(late_bench):
    late = late_bench.bus_port._device.latency_s
    late_bench.loop.power(on=True)
    seen = late_bench.pass_time(2.0)
    rate = (len(seen) - 1) / (seen[-1].time - seen[0].time)
    assert rate > min(195.0, 0.5 / late)
    outcome, reason = late_bench.run(late_bench.loop.call(lambda c, now: c.home(now)), 40.0)
    assert outcome is MoveOutcome.REACHED, reason
    taut = late_bench.plant.wound_m() - late_bench.plant.bank.slack_m
    assert [drive.pulled_length_m for drive in late_bench.loop.snapshot.drives] == pytest.approx(taut, abs=2e-3)
    assert not any(drive.fault for one in late_bench.loop.since(0, 0.0) for drive in one.drives)
    assert (late_bench.backend.counters.lost, late_bench.backend.counters.corrupt) == (0, 0)
    named = [text for text in late_bench.said if "the USB adapter keeps bytes back" in text and "make udev" in text]
    assert len(named) == (late > 0.003)


@behind(0.008, 0.016)
def test_a_silent_drive_behind_an_adapter_takes_no_other_with_it(late_bench):
    late_bench.loop.power(on=True)
    late_bench.cause("servo_silent", slot="index")
    assert late_bench.until(lambda seen: seen.drives[0].fault == "no_reply", 0.3)
    others = [drive for one in late_bench.pass_time(1.0) for drive in one.drives[1:]]
    assert {drive.fault for drive in others} == {""}
    late_bench.clear()
    assert late_bench.until(lambda seen: not seen.drives[0].fault, 2.0)


@behind(*LATENCIES_S, models=("DM-J4310-2EC",))
def test_an_answer_to_an_order_that_nobody_waited_for_answers_no_later_question(late_bench):
    """The first says that the motor holds, the second that it does not."""
    bus = late_bench.backend.bus
    late_bench.loop.power(on=True)
    late_bench.loop.stop()
    for _ in range(3):
        assert bus.order(frames.enable(1), 1).state == DamiaoState.ENABLED
        bus.send([frames.force_position(1, 0.0, 0.0, 0.0)])
        assert bus.order(frames.disable(1), 1).state == DamiaoState.DISABLED
    assert 1 in bus.take_order_feedbacks()
    assert bus.counters.lost == 0


@behind(0.002, models=("DM-J4310-2EC",))
def test_a_lost_answer_to_an_order_costs_one_reading_and_no_more(late_bench):
    bus = late_bench.backend.bus
    late_bench.loop.stop()
    end = late_bench.cause("bus_dead") and late_bench.undo.pop()
    bus.send([frames.force_position(1, 0.0, 0.0, 0.0)])
    end()
    assert bus.feedbacks([frames.refresh(1)], [1]) == {}
    assert set(bus.feedbacks([frames.refresh(1)], [1])) == {1}
    assert bus.counters.lost == 1


@behind(0.001, models=("STS3215",))
@pytest.mark.parametrize("delay_s", [0.0042, 0.0045, 0.005, 0.0055, 0.006])
def test_a_reply_that_was_given_up_answers_no_later_question(late_bench, delay_s):
    """Two items of one size, whose values differ, asked with a margin of 4 ms."""
    bus = late_bench.backend.bus
    late_bench.loop.stop()
    bus.link.lateness, late_bench.bus_wire.faults.delay_s = 0.0, delay_s
    for _ in range(3):
        assert bus.get(1, feetech.MODEL_NUMBER, attempts=3) == feetech.MODELS["STS3215"].number
        assert bus.get(1, feetech.GOAL_SPEED, attempts=3) != feetech.MODELS["STS3215"].number
    late_bench.bus_wire.faults.delay_s = 0.0


@behind(0.001, models=("DM-J4310-2EC",))
def test_a_line_that_is_cut_by_a_question_is_one_line(late_bench, monkeypatch):
    bus = late_bench.backend.bus
    late_bench.loop.stop()
    answer = b"t0118010000000000001919\r"
    with monkeypatch.context() as patch:
        patch.setattr(bus.link, "send", lambda _: answer[:9])
        patch.setattr(bus.link, "receive", lambda *_: answer[9:])
        assert set(bus.feedbacks([frames.refresh(1)], [1])) == {1}
    assert (bus.counters.lost, bus.counters.corrupt) == (0, 0)


@behind(0.016, models=("DM-J4310-2EC",))
def test_no_motor_times_out_while_others_are_switched_on_or_marked(late_bench):
    """Each takes three questions of 16 ms, a motor lets go after 80 ms without an order."""
    late_bench.loop.stop()
    late_bench.backend._timeout = 0.08
    late_bench.backend.connect()
    late_bench.loop.start()
    late_bench.loop.power(on=True)
    late_bench.pass_time(0.5)
    for number, tendon in enumerate(late_bench.backend.tendons, start=1):
        late_bench.backend.mark_session(tendon, number)
    late_bench.pass_time(0.5)
    assert {drive.fault for one in late_bench.loop.since(0, 0.0) for drive in one.drives} == {""}
    assert all(servo.holds for servo in late_bench.plant.servos)


@behind(0.016, models=("STS3215",))
def test_a_chain_with_other_ids_is_found_behind_an_adapter(late_bench):
    late_bench.loop.stop()
    late_bench.backend.disconnect()
    bus = late_bench.backend.bus
    bus.allow_lateness(0.0)
    elsewhere = [replace(servo, servo_id=servo.servo_id + 10) for servo in late_bench.drives.servos]
    with pytest.raises(DeviceNotFoundError, match="found ID 1, 2, 3 instead"):
        FeetechBackend(bus, elsewhere).connect()


@behind(0.016, models=("DM-J4310-2EC",))
def test_an_adapter_too_slow_for_a_motor_by_its_own_timer_is_refused(late_bench, monkeypatch):
    """What is slow without a timer may be a busy computer, and is only said."""
    late_bench.loop.stop()
    late_bench.backend.disconnect()
    monkeypatch.setattr("softgrip_driver.damiao.backend.latency_timer", lambda _: 0.016)
    with pytest.raises(ConfigurationError, match=r"200 goals a second of a DM-J4310-2EC.*16 ms.*make udev"):
        late_bench.backend.connect()
    monkeypatch.setattr("softgrip_driver.damiao.backend.latency_timer", lambda _: 0.001)
    late_bench.backend.connect()
