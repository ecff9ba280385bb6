# SPDX-License-Identifier: Apache-2.0
"""The time server and its clients over a real socket, without a cell."""

import os
import socket
import threading
import time
import tty
from itertools import pairwise
from pathlib import Path

import pytest

from softgrip_emulator.clock import ScaledCellClock, SetClock
from softgrip_emulator.time_server import TICK_S, TimeServer
from softgrip_time import Follower, SimulatedClock
from softgrip_time.connection import Connection
from softgrip_time.protocol import Join


class PortWithAlarms:
    """A port of a device whose own time is faster, and that has something to do at given times of its own [s]."""

    terminal, received = "/dev/pts/nowhere", 0

    def __init__(self, clock, alarms):
        self.clock, self.alarms, self.served = clock, list(alarms), []

    def files(self):
        return []

    def next_due_s(self):
        return self.alarms[0] if self.alarms else None

    def is_service_due(self, _readable):
        return True

    def serve(self, _announce):
        while self.alarms and self.alarms[0] <= self.clock.now_s():
            self.served.append((self.alarms.pop(0), self.clock.now_s()))


class SendingPort(PortWithAlarms):
    """A port whose device sends a byte at given times [s]; the first of them get lost on their way."""

    def __init__(self, clock, alarms, lost=0):
        super().__init__(clock, alarms)
        self.master, self.host = os.openpty()
        tty.setraw(self.host)
        self.terminal, self.lost = os.ttyname(self.host), lost

    def serve(self, announce):
        while self.alarms and self.alarms[0] <= self.clock.now_s():
            self.alarms.pop(0)
            announce(self.terminal)
            if self.lost:
                self.lost -= 1
            else:
                os.write(self.master, b"x")

    def close(self):
        os.close(self.master)
        os.close(self.host)


@pytest.fixture
def serve(tmp_path):
    servers = []

    def start(ports=lambda _: [], **options):
        advanced, clock = [], SetClock()
        served = ports(clock)
        server = TimeServer(tmp_path / "time", clock, lambda: served, advanced.append, **options)
        server.open()
        server.start()
        servers.append(server)
        return server, advanced

    yield start
    for server in servers:
        server.close()


def test_without_participants_the_time_is_the_computers(serve, until):
    server, advanced = serve(speed=0.0, expected=["driver"])
    began = time.monotonic()
    assert until(lambda: server.clock.now_s() > 0.2)
    assert time.monotonic() - began > 0.15
    assert advanced == sorted(advanced)


def test_a_stepper_gets_exactly_the_times_it_asks_for_and_the_time_stands_meanwhile(serve, tmp_path):
    server, advanced = serve(speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        began = clock.now_s()
        for k in range(1, 50):
            clock.wait(began + 0.0137 * k)
            assert clock.now_s() == began + 0.0137 * k
        time.sleep(0.25)  # a computer with other things to do
        assert server.clock.now_s() == clock.now_s()
        late = clock.now_s() + 0.001
        clock.wait(late)
        assert clock.now_s() == late
    # steps of at most a tick, up to where nobody held it any more
    times = [time_s for time_s in advanced if began <= time_s <= late]
    assert max(b - a for a, b in pairwise(times)) <= TICK_S + 1e-9


def test_simulated_time_runs_faster_than_the_computers_where_it_can(serve, tmp_path):
    serve(speed=0.0, expected=["driver"])
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        began = time.monotonic()
        clock.wait(clock.now_s() + 30.0)
        assert time.monotonic() - began < 15.0


def test_after_a_rest_who_is_behind_is_told_the_time_at_once(serve, tmp_path, monkeypatch):
    """A follower that is further behind than work allows reports when it hears the time, and not before."""
    monkeypatch.setattr(TimeServer, "_hold", lambda server, *_: server._wait(0.01))  # which tells after a while, too
    server, advanced = serve(speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    follower = Follower(tmp_path / "time", "manager", lag_s=0.04)
    end = threading.Event()

    def follow():
        heard = 0
        while not end.is_set():
            if len(advanced) > heard:
                heard = len(advanced)
                behind_s = 0.1 if server.participants.is_resting else 0.0
                follower.report(clock.epoch_ns(advanced[heard - 1] - behind_s))
            time.sleep(0.001)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    with clock.stepping():
        rest_s = clock.now_s() + 3.0
        while clock.now_s() < rest_s:
            clock.wait(clock.now_s() + 0.04)
        assert server.participants.is_resting
        before, asked_s = len(advanced), clock.now_s()
        clock.wait(asked_s + 0.01)
        assert not server.participants.is_resting
        assert asked_s in advanced[before:]  # told again, though the time had not gone on
    end.set()
    thread.join()
    follower.close()


def test_a_wait_ends_when_a_file_can_be_read(serve, tmp_path):
    serve(speed=1.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    read, write = os.pipe()
    with clock.stepping():
        threading.Timer(0.05, os.write, (write, b"x")).start()
        until_s = clock.now_s() + 60.0
        assert clock.wait_readable([read], until_s) == [read]
        assert clock.now_s() < until_s
        assert clock.wait_readable([read], until_s) == [read]  # at once
    os.close(read)
    os.close(write)


@pytest.fixture
def sending(serve):
    """A server with a port whose device sends; the function returns the file that the host reads."""
    ports = []

    def start(alarms, **options):
        serve(lambda clock: ports.append(SendingPort(clock, alarms, **options)) or ports, speed=0.0)
        return ports[0].host

    yield start
    for port in ports:
        port.close()


def test_bytes_of_the_device_end_a_wait_at_the_time_when_they_came(sending, tmp_path):
    sends = [5.0 + 0.0037 * k for k in range(1, 60)]
    host = sending(sends)
    clock = SimulatedClock(tmp_path / "time", "driver")
    clock.attach(host)
    seen = []
    with clock.stepping():
        clock.wait(5.0)
        while len(seen) < 59:
            assert clock.wait_readable([host], 6.0) == [host]
            seen.append(clock.now_s())
            assert os.read(host, 10) == b"x"
        clock.wait(5.5)  # no answer to an earlier wait is left over
        assert clock.now_s() == 5.5
    assert seen == sends


def test_a_wait_for_bytes_that_got_lost_goes_on_to_its_time(sending, tmp_path):
    host = sending([5.1, 5.3], lost=1)
    clock = SimulatedClock(tmp_path / "time", "driver")
    clock.attach(host)
    with clock.stepping():
        clock.wait(5.0)
        assert clock.wait_readable([host], 5.2) == []
        assert clock.now_s() == 5.2
        assert clock.wait_readable([host], 5.4) == [host]
        assert clock.now_s() == 5.3


def test_detached_the_time_goes_on_without_a_stepper(serve, tmp_path, until):
    server, _ = serve(speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        with clock.detached():
            assert until(lambda: server.clock.now_s() > clock.now_s() + 0.5)
        now_s = clock.now_s()
        assert server.clock.now_s() == now_s
    assert until(lambda: server.clock.now_s() > now_s)


def test_the_time_is_never_further_than_its_lag_ahead_of_a_follower(serve, tmp_path, until):
    server, advanced = serve(speed=0.0)
    follower = Follower(tmp_path / "time", "manager", lag_s=0.05)
    joined_s = server.participants.all[0].progress_s
    epoch_ns = round(server.epoch_s * 1e9)
    time.sleep(0.2)
    assert max(advanced) <= joined_s + 0.05 + 1e-9
    for k in range(1, 40):
        follower.report(epoch_ns + round(1e9 * (joined_s + 0.01 * k)))
        assert until(lambda reached=joined_s + 0.01 * k + 0.05: server.clock.now_s() >= reached - 1e-5)
    time.sleep(0.1)
    assert server.clock.now_s() <= joined_s + 0.39 + 0.05 + 1e-5
    follower.close()
    assert until(lambda: server.clock.now_s() > joined_s + 1.0)


def test_the_time_goes_on_without_who_is_silent_and_it_is_back_with_its_next_packet(serve, tmp_path, until):
    server, _ = serve(speed=0.0, give_up_s=0.3)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        stands_s = server.clock.now_s()
        assert until(lambda: server.clock.now_s() > stands_s + 0.1)
        assert server.participants.names() == set()
        clock.wait(server.clock.now_s() + 1.0)
        assert server.participants.names() == {"driver"}
        assert server.clock.now_s() == clock.now_s()
    assert server.held_s["driver"] == pytest.approx(0.3, abs=0.25)


def test_when_the_server_ends_the_time_is_the_computers(serve, tmp_path):
    server, _ = serve(speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        last_s = clock.now_s()
        server.close()
        began = time.monotonic()
        clock.wait(last_s + 0.2)
        assert clock.now_s() >= last_s + 0.2
        assert 0.1 < time.monotonic() - began < 3.0
    with clock.stepping():
        clock.wait(clock.now_s() + 0.01)


def test_a_client_without_a_server_is_told_what_to_do(tmp_path):
    with pytest.raises(OSError, match="start emulated_cell first"):
        SimulatedClock(tmp_path / "time", "driver")


def test_a_participant_that_sends_something_else_is_dropped_and_the_others_are_served(serve, tmp_path, until, caplog):
    server, _ = serve(speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping(), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.connect(str(tmp_path / "time"))
        stranger.send(b"hello")
        clock.wait(clock.now_s() + 0.5)
        assert stranger.recv(10) == b""
    assert "expected a packet" in caplog.text
    assert until(lambda: server.participants.all == [])


def test_times_and_names_of_several(serve, tmp_path, until):
    server, _ = serve(speed=0.0)
    clocks = [SimulatedClock(tmp_path / "time", name) for name in ("driver", "rig")]
    seen, barrier = [], threading.Barrier(2)

    def step(clock, period_s):
        with clock.stepping():
            barrier.wait()
            for k in range(1, 60):
                clock.wait(5.0 + k * period_s)
                seen.append(server.clock.now_s() - clock.now_s())

    threads = [threading.Thread(target=step, args=pair) for pair in zip(clocks, (0.003, 0.005), strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    assert len(seen) == 2 * 59
    assert set(seen) == {0.0}  # nobody's time was another than the cell's when it worked
    assert until(lambda: server.participants.all == [])


@pytest.mark.parametrize("scale", [60.0, 0.7, 3.3])
def test_a_faster_devices_time_comes_exactly_whatever_is_rounded(serve, tmp_path, scale):
    alarms = [5.0 + 0.0137 * k for k in range(1, 400)]
    made = []

    def ports(clock):
        made.append(PortWithAlarms(ScaledCellClock(clock, scale), alarms))
        return made

    serve(ports, speed=0.0)
    clock = SimulatedClock(tmp_path / "time", "driver")
    with clock.stepping():
        clock.wait(alarms[-1] / scale + 0.1)
    assert [alarm for alarm, _ in made[0].served] == alarms
    assert max(now_s - alarm for alarm, now_s in made[0].served) < 1e-9


def test_closing_leaves_neither_socket_nor_descriptor(tmp_path):
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        server = TimeServer(tmp_path / "time", SetClock(), list, lambda _: None)
        server.open()
        server.start()
        Connection(tmp_path / "time", Join("driver")).close()
        server.close()
        server.close()
    assert list(tmp_path.iterdir()) == []
    assert len(list(Path("/proc/self/fd").iterdir())) == before
