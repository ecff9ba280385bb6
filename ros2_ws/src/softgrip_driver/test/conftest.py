# SPDX-License-Identifier: Apache-2.0
"""A bench: emulated servos and fingers on a pseudo-terminal, with the driver's own loop on the other end."""

from __future__ import annotations

import math
import os
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from softgrip_driver.configuration import STAGE_RATES
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import Servo
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS, OperatingMode
from softgrip_driver.rig.build import StreamSettings, make_gauge, make_stage
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Policies
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.clock import CellClock
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.faults import BUS_FAULTS
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.rig.amplifier import COUNTS_PER_NEWTON
from softgrip_emulator.rig.spring import SpringPlant
from softgrip_emulator.rig.truth import RigTruth
from softgrip_emulator.wire.faulty import FaultyWire
from softgrip_emulator.wire.pty import PtyPort
from softgrip_model.profile import load_directory

PROFILES = Path(__file__).parents[2] / "softgrip_bringup" / "profiles"
TENDONS = ("index", "middle", "thumb")
BAUD = 1_000_000
#: On a machine that others use too, the emulator's thread may sleep for longer than a servo may be silent. `make
#: faults` sets the variable and measures with the driver's real limits.
QUIET = os.environ.get("SOFTGRIP_QUIET_MACHINE") == "1"
LIMITS = TendonLimits(no_reply=0.05 if QUIET else 0.3)
#: for a bench in a time of its own
EXACT = TendonLimits()
POLICIES = Policies()
REPLY_MARGIN, WATCHDOG = (0.004, 0.08) if QUIET else (0.02, 0.6)


class RunningLoop:
    """What a test does with a loop that runs."""

    def run(self, ticket, deadline: float = 15.0):
        """Wait for the end of a request; return (outcome, reason)."""
        self.until(lambda _: self.result(ticket)[0] is not None, deadline)
        return self.result(ticket)

    def result(self, ticket):
        return self.controller.result(ticket)

    def until(self, condition, deadline: float = 3.0):
        """Wait until a snapshot meets a condition; the snapshot, or None."""
        return self.loop.wait_for(condition, deadline)

    def clear(self) -> None:
        """End all faults."""
        while self.undo:
            self.undo.pop()()

    def drive(self, name: str):
        """The last snapshot of one drive."""
        return next(drive for drive in self.loop.snapshot.drives if drive.tendon == name)


class Bench(RunningLoop):
    """Emulator and driver with the serial wire between them."""

    def __init__(
        self, folder: Path, *, rate=200.0, limits=LIMITS, policies=POLICIES, seed=3, history=4096, grippers=None,
        model="XL330-M288", mode=OperatingMode.CURRENT_BASED_POSITION,
    ) -> None:  # fmt: skip
        self.clock = CellClock()
        chain = [ServoPlace(name, number, model) for number, name in enumerate(TENDONS, start=1)]
        supply = Supply(load_model(model).motor.nominal_voltage_v)
        self.plant = CellPlant(load_directory(PROFILES), seed=seed, chain=chain, supply=supply)
        self.plant.mount(list(TENDONS), ["a", "b", "c"], ["power"] * 3)
        self.bus_wire = FaultyWire(
            DynamixelChain(self.plant.servos, lock=self.plant.lock, before=self.plant.catch_up), seed
        )
        self.bus_port = PtyPort(folder / "servos", self.bus_wire, clock=self.clock)
        self._stop = threading.Event()
        self._living = threading.Thread(target=self._live, daemon=True)
        table = MODELS[model]
        torque = TorqueModel(table.torque_per_ampere, table.no_load_current)
        self.servos = [Servo(name, i, table, Spool(0.010, 1), torque, mode) for i, name in enumerate(TENDONS, start=1)]
        self.bus = Bus(str(folder / "servos"), BAUD, reply_margin=REPLY_MARGIN)
        self.backend = DynamixelBackend(self.bus, self.servos, watchdog=WATCHDOG)
        self.controller = GripperController(dict.fromkeys(TENDONS, limits), policies, grippers, 1.0 / rate)
        self.loop = BusLoop(self.backend, self.controller, rate, history)
        self.identities = ()
        self.undo = []

    def _live(self) -> None:
        while not self._stop.wait(0.003):
            self.plant.advance_to(self.clock.now_s())

    def open(self) -> Bench:
        self.bus_port.start()
        self._living.start()
        self.identities = self.backend.connect()
        self.loop.start()
        assert self.until(lambda seen: all(drive.time > 0.0 for drive in seen.drives), 5.0)
        return self

    def close(self) -> None:
        self.clear()
        self.loop.stop()
        self.backend.disconnect()
        self._stop.set()
        self._living.join(2.0)
        self.bus_port.close()

    def hold_taut(self, tension: float = 5.0) -> None:
        """Take hold with the true zeros, as after a homing, and pull every tendon to a tension."""
        self.loop.power(on=True)
        slack = self.plant.bank.slack_m - self.plant.wound_m()
        for index, name in enumerate(TENDONS):
            self.loop.mark_session(name, index + 1)
            here = self.loop.call(lambda c, _, n=name: c.drives[n].position)
            zero = here + float(slack[index])
            self.loop.call(lambda c, _, n=name, z=zero, m=index + 1: c.drives[n].set_zero(z, m))
        if tension:
            request = MoveRequest([], MoveMode.TENSION, [tension], 0.03)
            outcome, reason = self.run(self.loop.call(lambda c, now: c.move(request, now)))
            assert outcome == 0, reason

    def cause(self, fault: str, **arguments) -> float:
        """Start a fault by the emulator's name; return the time [s, monotonic] it began."""
        began = time.monotonic()
        self.undo.append(BUS_FAULTS[fault](self, **arguments))
        return began


@pytest.fixture
def benches():
    """The classes of benches, for who opens one himself: servos, or a stage."""
    return Bench, StageBench


@pytest.fixture
def bench(tmp_path, request):
    """An opened bench; `@pytest.mark.parametrize("bench", [{...}], indirect=True)` changes its settings."""
    settings = getattr(request, "param", None)
    if settings is None and "bench_settings" in request.fixturenames:
        settings = request.getfixturevalue("bench_settings")
    one = Bench(tmp_path, **(settings or {}))
    try:
        yield one.open()
    finally:
        one.close()


class StageBench(RunningLoop):
    """One tendon on an emulated stage with a gauge in its line, and the driver's loop."""

    LIMITS = TendonLimits(
        travel=0.030, speed=0.015, acceleration=0.2, release_speed=0.006, lead=0.003, slack_travel=0.009,
        tension_soft=20.0, tension_hard=25.0, homing_tension=4.0, homing_speed=0.005, homing_travel=0.025,
        no_reply=0.05 if QUIET else 0.3, stall_time=1.0, break_confirm=0.08,
    )  # fmt: skip

    def __init__(self, folder: Path, stage: str, gauge: str) -> None:
        self.plant = SpringPlant(RigTruth.from_seed(1))
        self.rig = EmulatedRig(1, stage=stage, gauge=gauge, plant=self.plant)
        self.rig.open_ports(folder)
        stream = StreamSettings(line=gauge, counts_per_newton=COUNTS_PER_NEWTON)
        reply = 0.04 if QUIET else 0.15
        self.backend = StageBackend(
            "pull",
            make_stage(stage, str(folder / "stand"), reply),
            make_gauge("gcl2" if gauge == "gcl2" else "stream", str(folder / "gauge"), stream, reply),
            1.2 * self.LIMITS.speed,
        )
        rate = STAGE_RATES[stage]
        self.controller = GripperController({"pull": self.LIMITS}, POLICIES, period=1.0 / rate)
        self.loop = BusLoop(self.backend, self.controller, rate)
        self.undo = []

    def open(self) -> StageBench:
        self.identities = self.backend.connect()
        self.loop.start()
        assert self.until(lambda seen: seen.drives[0].time > 0.0, 5.0)
        return self

    def close(self) -> None:
        self.clear()
        self.loop.stop()
        self.backend.disconnect()
        self.rig.close()

    def hold_taut(self, tension: float) -> None:
        """Take hold with the true zero, as after a homing, and pull to a tension."""
        self.loop.power(on=True)
        self.loop.mark_session("pull", 1)
        self.loop.call(lambda c, _: c.drives["pull"].set_zero(self.plant.slack, 1))
        ticket = self.loop.call(lambda c, now: c.move(MoveRequest([], MoveMode.TENSION, [tension], 0.01), now))
        outcome, reason = self.run(ticket)
        assert outcome == 0, reason

    def cause(self, fault: str, **arguments) -> float:
        """Start a fault of the rig, or of the tendon; return the time [s, monotonic] it began."""
        began = time.monotonic()
        if fault == "tendon_break":
            self.plant.cut(True)
            self.undo.append(lambda: self.plant.cut(False))
        elif fault == "slack":
            self.plant.loosen(0.02)
            self.undo.append(lambda: self.plant.loosen(-0.02))
        else:
            self.rig.inject(fault, **arguments)
            self.undo.append(lambda: self.rig.clear(fault))
        return began


class LoopbackSerial:
    """Stands where pyserial's Serial does; the servos answer at once, in a time that only `VirtualBench` moves."""

    def __init__(self, chain, now, baud):
        self._chain, self._now, self._baud = chain, now, baud
        self.fd, self._writer = os.pipe()
        os.set_blocking(self.fd, False)

    def write(self, data):
        for chunk in self._chain.exchange(bytes(data), self._now(), self._baud):
            os.write(self._writer, chunk.data)
        return len(data)

    def read(self, size):
        try:
            return os.read(self.fd, size)
        except BlockingIOError:
            return b""

    def reset_input_buffer(self):
        while self.read(4096):
            pass

    def close(self):
        os.close(self.fd)
        os.close(self._writer)


class VirtualBench:
    """The driver's whole control cycle on emulated servos and fingers in a time of its own: no thread, no load, exact.

    Args:
        patch: monkeypatch, for the clock of the modules that read one.
        others: settings of `Bench`.
    """

    PERIOD = 0.005
    CLOCKED = ("dynamixel.backend", "dynamixel.port", "tendon.loop")

    def __init__(self, patch, *, limits=EXACT, policies=POLICIES, seed=3, grippers=None,
                 model="XL330-M288", mode=OperatingMode.CURRENT_BASED_POSITION):  # fmt: skip
        self.now = 100.0
        for module in self.CLOCKED:
            patch.setattr(f"softgrip_driver.{module}.time", SimpleNamespace(monotonic=lambda: self.now))
        chain = [ServoPlace(name, number, model) for number, name in enumerate(TENDONS, start=1)]
        supply = Supply(load_model(model).motor.nominal_voltage_v)
        self.plant = CellPlant(load_directory(PROFILES), seed=seed, chain=chain, supply=supply)
        self.plant.mount(list(TENDONS), ["a", "b", "c"], ["power"] * 3)
        self.plant.now_s = self.now
        table = MODELS[model]
        torque = TorqueModel(table.torque_per_ampere, table.no_load_current)
        servos = [
            Servo(name, i, table, Spool(0.010, 1), torque, mode, limits.tension_hard)
            for i, name in enumerate(TENDONS, start=1)
        ]
        self.bus = Bus("virtual", BAUD)
        self.serial = LoopbackSerial(
            DynamixelChain(self.plant.servos, lock=self.plant.lock, before=self.plant.catch_up), lambda: self.now, BAUD
        )
        patch.setattr(self.bus.port, "open", self._open)
        self.backend = DynamixelBackend(self.bus, servos)
        self.controller = GripperController(dict.fromkeys(TENDONS, limits), policies, grippers, self.PERIOD)
        self.loop = BusLoop(self.backend, self.controller, 1.0 / self.PERIOD)
        self.backend.connect()
        self.pass_time(0.05)
        self.loop._power_all(self.controller, on=True)
        slack = self.plant.bank.slack_m - self.plant.wound_m()
        for index, name in enumerate(TENDONS):
            self.backend.mark_session(name, index + 1)
            self.drive(name).set_zero(self.drive(name).position + float(slack[index]), index + 1)

    def _open(self):
        self.bus.port.ser, self.bus.port.is_open, self.bus.port.tx_time_per_byte = self.serial, True, 0.01

    def drive(self, name):
        return self.controller.drives[name]

    def pass_time(self, seconds, watch=lambda: None):
        """Live for a while; ``watch`` is called after each cycle."""
        for _ in range(round(seconds / self.PERIOD)):
            self.now += self.PERIOD
            self.plant.advance_to(self.now)
            self.loop._cycle(self.now)
            watch()

    def run(self, ticket, deadline=10.0, watch=lambda: None):
        """Live until a request has ended; (outcome, reason)."""
        end = self.now + deadline
        while self.controller.result(ticket)[0] is None and self.now < end:
            self.pass_time(self.PERIOD, watch)
        return self.controller.result(ticket)

    def move(self, targets, speed=0.02, tension_limit=0.0, tendons=(), mode=MoveMode.LENGTH):
        return self.controller.move(MoveRequest(list(tendons), mode, list(targets), speed, tension_limit), self.now)


@pytest.fixture
def virtual(monkeypatch):
    """Make a VirtualBench from settings."""
    made = []

    def make(**settings):
        made.append(VirtualBench(monkeypatch, **settings))
        return made[-1]

    yield make
    for one in made:
        one.serial.close()


@pytest.fixture
def reading():
    """Make a DriveReading from what matters."""

    def make(time_s, position, velocity=0.0, tension=0.0, **others):
        values = {"tension_stddev": 0.5, "pull": tension, "powered": True, "session_mark": 1, "temperature": 30.0}
        return DriveReading(time_s, position, velocity, tension, **(values | others))

    return make


@pytest.fixture
def spring_finger():
    """A closed-form finger: slack up to `taut` [m], then a spring; the servo follows its setpoint."""

    class SpringFinger:
        def __init__(self, taut=0.003, stiffness=1000.0, position=0.0):
            self.taut, self.stiffness, self.position, self.velocity, self.time = taut, stiffness, position, 0.0, 0.0
            self.broken = False

        @property
        def tension(self):
            return 0.0 if self.broken else max(0.0, self.stiffness * (self.position - self.taut))

        def advance(self, dt, setpoint):
            """Follow a setpoint with a lag of 20 ms, never beyond its tension limit."""
            goal = setpoint.position
            if not self.broken:
                goal = min(goal, self.taut + setpoint.tension_limit / self.stiffness)
            moved = (goal - self.position) * (1.0 - math.exp(-dt / 0.02))
            self.position += moved
            self.velocity = moved / dt
            self.time += dt

        def read(self, make, **others):
            return make(self.time, self.position, self.velocity, self.tension, **others)

    return SpringFinger


def pytest_terminal_summary(terminalreporter, config):
    """Print the fault matrix and what the soak saw."""
    heads = ("fault", "while", "named", "state and time to safe", "aim", "recovers by")
    for title, rows in getattr(config, "fault_tables", {}).items():
        if not rows:
            continue
        widths = [max(len(row[i]) for row in [heads, *rows]) for i in range(len(heads))]
        terminalreporter.write_sep("=", f"fault matrix: {title}")
        for row in [heads, *rows]:
            terminalreporter.write_line("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)))
    if report := getattr(config, "soak_report", ""):
        terminalreporter.write_sep("=", "soak")
        terminalreporter.write_line(report)
