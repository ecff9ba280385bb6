# SPDX-License-Identifier: Apache-2.0
"""Where driver and emulated devices meet: in a time of their own, or on pseudo-terminals in real time.

In a time of its own (`OwnWorld`) nothing runs beside anything: the driver's own code waits for its replies, and while
it waits the time passes and the plant lives. The bytes, their pace on the wire and every time limit are those of the
real thing, so it is exact, however busy the machine. `RealWorld` has the same verbs over pseudo-terminals and threads.
"""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

from softgrip_driver.errors import DriverError
from softgrip_driver.tendon.loop import BusLoop, LoopSnapshot
from softgrip_emulator.clock import RealTimeClock
from softgrip_emulator.wire.pty import Line, PtyPort
from softgrip_testing.virtual_clock import PLANT_PERIOD_S, VirtualClock, VirtualRigClock

#: modules of the driver that make a clock where they are given none, or open a port
CLOCKED = ("dynamixel.bus", "serial_bus", "tendon.loop", "stage.backend", "rig.line_port", "commands.stage")
PORTS = ("dynamixel.port", "serial_bus", "rig.line_port")


class Cable:
    """Serves a device under a path, as a PtyPort does, without a terminal: bytes at their pace in the world's time."""

    def __init__(self, path, device, clock):
        self.path, self._device, self._clock = path, device, clock
        self.plugged = False
        self.handle = None
        self.plug()

    def plug(self):
        self.path.touch()
        self.plugged = True

    def unplug(self):
        self.path.unlink(missing_ok=True)
        self.plugged, self.handle = False, None

    def close(self):
        self.unplug()

    def open(self, baud):
        self.handle = Handle(self, self._device, self._clock, baud)
        return self.handle


class Handle:
    """Stands where pyserial's Serial does."""

    def __init__(self, cable, device, clock, baud):
        self._cable, self._device, self._clock = cable, device, clock
        self._line, self._heard = Line(paced=True), b""
        self._line.baud = baud
        self._line.queue(device.opened(clock.now_s()))
        #: what select is given
        self.fd = self

    def fileno(self):
        return self

    def write(self, data):
        self._hear()
        now = self._clock.now_s()
        arrival = self._line.arrival_s(len(data), now)
        self._line.queue(self._device.exchange(bytes(data), arrival, self._line.baud))
        return len(data)

    def read(self, size):
        self._hear()
        data, self._heard = self._heard[:size], self._heard[size:]
        return data

    def reset_input_buffer(self):
        self._hear()
        self._heard = b""

    def close(self):
        if self._cable.handle is self:
            self._cable.handle = None

    def wait(self, timeout):
        """Let time pass until bytes are there, at most ``timeout`` [s]; whether they are."""
        end = self._clock.now_s() + max(0.0, timeout)
        while True:
            self._hear()
            now = self._clock.now_s()
            if self._heard or now >= end:
                return bool(self._heard)
            due = [t for t in (self._line.next_s(), self._device.due_s()) if t is not None]
            self._clock.advance(min([end, *(max(t, now + 1e-6) for t in due)]))

    def _hear(self):
        if self._cable.handle is not self:
            raise OSError(5, "Input/output error")
        now = self._clock.now_s()
        while (due := self._device.due_s()) is not None and due <= now:
            self._line.queue(self._device.exchange(b"", due, self._line.baud))
            if self._device.due_s() == due:
                break
        self._heard += self._line.take_due(now)


class OwnLoop(BusLoop):
    """The driver's loop, cycle by cycle whenever somebody waits for it."""

    def __init__(self, clock, backend, controller, rate, history):
        super().__init__(backend, controller, rate, history, clock)
        self._clock, self._due, self._runs, self._count = clock, 0.0, False, 0

    def start(self):
        self._runs, self._due = True, self._clock.now_s()

    def stop(self, _timeout=2.0):
        if self._runs:
            self._runs = False
            self._leave()

    @property
    def running(self):
        return self._runs

    def call(self, request, _timeout=1.0, **_urgent):
        if not self._runs:
            raise DriverError("the bus loop does not run")
        return request(self._controller, self._clock.now_s())

    def since(self, sequence, timeout):
        end = self._clock.now_s() + timeout
        while self._runs and not self._newer(sequence) and self._clock.now_s() < end:
            self.tick()
        return [one for one in self._history if one.sequence > sequence]

    def wait_for(self, condition, timeout):
        end = self._clock.now_s() + timeout
        while True:
            if self._history and condition(self._history[-1]):
                return self._history[-1]
            if not self._runs or self._clock.now_s() >= end:
                return None
            self.tick()

    def tick(self):
        """One cycle."""
        self._clock.advance(self._due)
        now = self._clock.now_s()
        self._due = max(self._due + 1.0 / self._rate, now)
        self._cycle(now)
        self._count += 1
        self._publish(LoopSnapshot(
            self._count, now, self._controller.snapshots(), self._controller.estop, self._rate, 0.0, 0, self._port_lost
        ))  # fmt: skip


class OwnWorld:
    """A time of its own.

    Args:
        patch: pytest's monkeypatch, for the clock and the ports of the driver's modules.
    """

    quiet = True

    def __init__(self, patch):
        self.clock = VirtualClock(100.0)
        self._cables = {}
        for module in CLOCKED:
            patch.setattr(f"softgrip_driver.{module}.WallClock", lambda: self.clock)
        for module in PORTS:
            patch.setattr(f"softgrip_driver.{module}.serial", SimpleNamespace(Serial=self._serial, EIGHTBITS=8))
        patch.setattr("softgrip_driver.dynamixel.port._PatientSerial", self._serial)

    def port(self, path, device):
        """Serve a device under a path."""
        self._cables[str(path)] = Cable(path, device, self.clock)
        return self._cables[str(path)]

    def live(self, advance):
        """Have something live along."""
        self.clock.living.append(advance)

    def loop(self, backend, controller, rate, history):
        """The loop over a backend."""
        return OwnLoop(self.clock, backend, controller, rate, history)

    def now(self):
        """[s] by the driver's clock."""
        return self.clock.now_s()

    def rig_time(self):
        """The clock of a measurement."""
        return VirtualRigClock(self.clock)

    def breathe(self):
        """Let a moment pass, for who polls what takes no time by itself."""
        self.clock.advance(self.clock.now_s() + 1e-3)

    def close(self):
        """Nothing runs."""

    def _serial(self, port, baudrate, **_):
        cable = self._cables.get(str(port))
        if cable is None or not cable.plugged:
            raise OSError(2, f"could not open port {port}")
        return cable.open(baudrate)


class RealWorld:
    """Pseudo-terminals, threads and the machine's clock."""

    def __init__(self, quiet):
        self.quiet = quiet
        self.clock = RealTimeClock()
        self._stop = threading.Event()
        self._living = []

    def port(self, path, device):
        """Serve a device under a path."""
        return PtyPort(path, device, clock=self.clock).start()

    def live(self, advance):
        """Have something live along."""

        def run():
            while not self._stop.wait(PLANT_PERIOD_S):
                advance(self.clock.now_s())

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        self._living.append(thread)

    def loop(self, backend, controller, rate, history):
        """The loop over a backend."""
        return BusLoop(backend, controller, rate, history)

    def now(self):
        """[s] by the driver's clock."""
        return time.monotonic()

    def breathe(self):
        """Time passes by itself."""

    def close(self):
        """End all threads."""
        self._stop.set()
        for thread in self._living:
            thread.join(2.0)
