# SPDX-License-Identifier: Apache-2.0
"""Benches: emulated servos and fingers, or a stage, on wires, with the driver's own loop on the other end.

They run in a time of their own, exact on any machine; in real time, on pseudo-terminals, in `real_time/` and in
`make faults` (SOFTGRIP_QUIET_MACHINE=1).
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_driver.configuration import checked_configuration
from softgrip_driver.damiao import frames as damiao
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, OperatingMode
from softgrip_driver.feetech import registers as feetech
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.rig.build import StreamSettings, make_gauge, make_stage
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.stage.drive_set import STAGE_RATES
from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.blocking import block_of
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Policies
from softgrip_driver.tendon.limits import LIMIT_PARAMETERS, TendonLimits
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.needs import fitted_limits
from softgrip_driver.tendon.safety import Safety
from softgrip_driver.tendon.safety_store import SafetyStore
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.faults import BUS_FAULTS, Overrides
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.rig.amplifier import COUNTS_PER_NEWTON
from softgrip_emulator.rig.sketches import EmulatedBoard
from softgrip_emulator.rig.truth import RigTruth
from softgrip_emulator.servos import load_ratings, make_chain
from softgrip_emulator.wire.faulty import FaultyWire
from softgrip_emulator.wire.usb_adapter import UsbAdapter
from softgrip_model.friction.laws import GRAVITY
from softgrip_model.profile import load_directory
from softgrip_testing.scripts import load_script
from softgrip_testing.spring_plant import SpringPlant

PROFILES = Path(__file__).parents[2] / "softgrip_bringup" / "profiles"
TENDONS = ("index", "middle", "thumb")
BAUD = 1_000_000
#: `make faults` sets the variable and measures in real time with the driver's real limits.
QUIET = os.environ.get("SOFTGRIP_QUIET_MACHINE") == "1"
POLICIES = Policies()
#: models that are no Dynamixels, and the backend that drives them
OTHER_MODELS = dict.fromkeys(feetech.MODELS, "feetech") | dict.fromkeys(damiao.MODELS, "damiao")


def other_model(name):
    """The driver's table of a model that is no Dynamixel."""
    return (feetech.MODELS | damiao.MODELS)[name]


worlds = load_script(Path(__file__).with_name("worlds.py"))


def shipped_limits(model, no_reply=0.05):
    """The limits as shipped; of a model that is no Dynamixel, those that it can keep on a spool of 10 mm."""
    limits = TendonLimits(no_reply=no_reply)
    return limits if model in MODELS else fitted_limits(limits, other_model(model), 0.010)


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

    def watched(self, ticket, deadline: float = 15.0):
        """Wait as `run` does; return the snapshots of every cycle until the end."""
        first = self.loop.snapshot.sequence
        self.run(ticket, deadline)
        return self.loop.since(first, 0.0)

    def pass_time(self, duration: float):
        """Wait; return the snapshots of every cycle."""
        first, end = self.loop.snapshot.sequence, self.loop.snapshot.time + duration
        assert self.until(lambda seen: seen.time >= end, duration + 5.0)
        return self.loop.since(first, 0.0)

    def move(self, targets, speed=None, tension_limit=None, tendons=(), mode=MoveMode.LENGTH, **order):
        limits = next(iter(self.controller.drives.values())).limits
        limit = limits.tension_soft if tension_limit is None else tension_limit
        speed = min(0.02, limits.speed) if speed is None else speed
        request = MoveRequest(list(tendons), mode, list(targets), speed, limit, **order)
        return self.loop.call(lambda controller, now: controller.move(request, now))

    def stop(self) -> str:
        """Stop as the service does: latch, enforce, put on disk; return what could not be done."""
        self.safety.latch_stop("a test")
        undone = self.loop.enforce_block()
        assert self.safety.persist() == ""
        return undone

    def reset(self, *, power=True) -> str:
        """Reset as the service does."""
        self.safety.reset_stop()
        return self.loop.reset(power=power)

    def now(self) -> float:
        """[s] by the driver's clock."""
        return self.world.now()

    def clear(self) -> None:
        """End all faults."""
        while self.undo:
            self.undo.pop()()

    def drive(self, name: str):
        """The last snapshot of one drive."""
        return next(drive for drive in self.loop.snapshot.drives if drive.tendon == name)


class Bench(RunningLoop):
    """Emulator and driver with the serial wire between them.

    On a machine that others use too, the emulator's thread may sleep for longer than a servo may be silent: in real
    time the limits are the driver's own only where the machine is quiet.
    """

    def __init__(
        self, folder: Path, world, *, rate=200.0, limits=None, policies=POLICIES, seed=3, history=4096, grippers=None,
        model="XL330-M288", mode=OperatingMode.CURRENT_BASED_POSITION, limits_current=None,
        latency=None, tendons=TENDONS, report=lambda _: None, radius=0.010, around=lambda wire: wire,
        trips_early=False,
    ) -> None:  # fmt: skip
        self.world, self.undo, self.identities = world, [], ()
        self.overrides = Overrides()
        limits = limits or shipped_limits(model, 0.05 if world.quiet else 0.3)
        chain = [
            ServoPlace(
                name,
                number,
                model,
                spool_radius_m=radius,
                trips_early=trips_early,
                limits_winding=limits_current is CurrentSensing.WINDING,
            )
            for number, name in enumerate(tendons, start=1)
        ]
        supply = Supply(load_ratings(model).nominal_voltage_v)
        self.plant = CellPlant(load_directory(PROFILES), seed=seed, chain=chain, supply=supply)
        fingers = [name for name in tendons if name in TENDONS]
        self.plant.mount(fingers, list("abc"), ["power"] * 3)
        self.plant.now_s = world.clock.now_s()
        self.bus_wire = FaultyWire(make_chain(self.plant.servos, self.plant.lock, self.plant.advance_to), seed)
        wire = self.bus_wire if latency is None else UsbAdapter(self.bus_wire, latency)
        self.bus_port = world.port(folder / "servos", around(wire))
        self.model, self.mode, self.limits_current, self.report = model, mode, limits_current, report
        self.radius = radius
        make = self._dynamixel if model in MODELS else self._configured
        self.backend = make(str(folder / "servos"), model, tendons, limits, rate)
        self.safety = Safety(SafetyStore(folder / "safety.yaml"))
        self.controller = GripperController(
            dict.fromkeys(tendons, limits), policies, grippers, 1.0 / rate, lambda: block_of(self.safety, policies)
        )
        self.loop = world.loop(self.backend, self.controller, rate, history)

    def _dynamixel(self, port, model, tendons, limits, _rate):
        table = MODELS[model]
        torque = TorqueModel(table.torque_per_ampere, table.no_load_current)
        self.servos = [
            ServoConfiguration(
                name, i, table, Spool(self.radius, 1), torque, self.mode, limits.tension_hard, limits.speed,
                limits=self.limits_current,
            )
            for i, name in enumerate(tendons, start=1)
        ]  # fmt: skip
        self.bus = Bus(port, BAUD, reply_margin=0.004 if self.world.quiet else 0.02)
        watchdog = 0.08 if self.world.quiet else 0.6
        return DynamixelBackend(self.bus, self.servos, watchdog=watchdog, report=self.report)

    def _configured(self, port, model, tendons, limits, rate):
        """The backend that brings the model, from the node's own parameters."""
        values = {row.name: row.default for row in PARAMETERS.rows} | {
            LIMIT_PARAMETERS[name]: value for name, value in vars(limits).items()
        }
        values |= {
            "backend": OTHER_MODELS[model], "port": port, "tendons": list(tendons), "servo_models": [model],
            "servo_ids": list(range(1, len(tendons) + 1)), "loop_rate": rate, "spool_radii_m": [self.radius],
            "reply_margin_s": 0.004 if self.world.quiet else 0.02,
            "bus_watchdog_s": 0.08 if self.world.quiet else 0.6,
        }  # fmt: skip
        self.drives = checked_configuration(values).drives
        return self.drives.backend(self.report, self.world.clock)

    def open(self) -> Bench:
        self.world.live(self.plant.advance_to)
        self.identities = self.backend.connect()
        self.loop.start()
        assert self.until(lambda seen: all(drive.time > 0.0 for drive in seen.drives), 5.0)
        return self

    def close(self) -> None:
        self.clear()
        self.loop.stop()
        self.backend.disconnect()
        self.world.close()
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
            speed = min(0.03, self.controller.drives[TENDONS[0]].limits.speed)
            outcome, reason = self.run(self.move([tension], speed, mode=MoveMode.TENSION))
            assert outcome is MoveOutcome.REACHED, reason

    def cause(self, fault: str, **arguments) -> float:
        """Start a fault by the emulator's name; return the time [s] it began, by the driver's clock."""
        began = self.now()
        self.undo.append(BUS_FAULTS[fault](self, **arguments))
        return began


class StageBench(RunningLoop):
    """One tendon on an emulated stage with a gauge in its line, and the driver's loop."""

    LIMITS = TendonLimits(
        travel=0.030, speed=0.015, acceleration=0.2, release_speed=0.006, max_following_error=0.003, slack_travel=0.009,
        tension_soft=20.0, tension_hard=25.0, homing_tension=4.0, homing_speed=0.005, homing_travel=0.025,
        stall_time=1.0, break_confirm=0.08,
    )  # fmt: skip

    def __init__(self, folder: Path, world, stage: str, gauge: str, proof: float = 0.0, stage_settings=None) -> None:
        self.world, self.undo = world, []
        limits = replace(self.LIMITS, no_reply=0.05 if world.quiet else 0.3)
        self.plant = SpringPlant(RigTruth.from_seed(1))
        self.rig = EmulatedRig(
            1, stage=stage, gauge=gauge, plant=self.plant, clock=world.clock, stage_settings=stage_settings
        )
        if gauge == "olkal_read":
            # Its sketch shows grams, and its HX711 has the pin RATE pulled up, or the loop would be too slow.
            self.rig.gauge = EmulatedBoard(self.rig.cell, gauge, rate_hz=80.0)
            stream = StreamSettings(line="hx711_adc", counts_per_newton=1e3 / GRAVITY)
        else:
            stream = StreamSettings(line=gauge, counts_per_newton=COUNTS_PER_NEWTON)
        self.rig.open_ports(folder, world.port)
        reply = 0.04 if world.quiet else 0.15
        self.backend = StageBackend(
            "pull",
            make_stage(stage, str(folder / "stand"), reply),
            make_gauge("gcl2" if gauge == "gcl2" else "stream", str(folder / "gauge"), stream, reply),
            1.2 * limits.speed,
            proof,
        )
        rate = STAGE_RATES[stage]
        self.safety = Safety(SafetyStore(folder / "safety.yaml"))
        self.controller = GripperController(
            {"pull": limits}, POLICIES, period=1.0 / rate, block=lambda: block_of(self.safety, POLICIES)
        )
        self.loop = world.loop(self.backend, self.controller, rate, 256)

    def open(self) -> StageBench:
        self.identities = self.backend.connect()
        self.loop.start()
        assert self.until(lambda seen: seen.drives[0].time > 0.0, 5.0)
        return self

    def close(self) -> None:
        self.clear()
        self.loop.stop()
        self.backend.disconnect()
        self.world.close()
        self.rig.close()

    def hold_taut(self, tension: float) -> None:
        """Take hold with the true zero, as after a homing, and pull to a tension."""
        self.loop.power(on=True)
        self.loop.mark_session("pull", 1)
        self.loop.call(lambda c, _: c.drives["pull"].set_zero(self.plant.slack, 1))
        outcome, reason = self.run(self.move([tension], 0.01, mode=MoveMode.TENSION))
        assert outcome is MoveOutcome.REACHED, reason

    def cause(self, fault: str, **arguments) -> float:
        """Start a fault of the rig, or of the tendon; return the time [s] it began, by the driver's clock."""
        began = self.now()
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


@pytest.fixture
def world(monkeypatch):
    """Where the benches stand."""
    return worlds.RealWorld(quiet=True) if QUIET else worlds.OwnWorld(monkeypatch)


@pytest.fixture
def real_world():
    """Pseudo-terminals and the machine's clock."""
    return worlds.RealWorld(QUIET)


@pytest.fixture
def benches():
    """The classes of benches, for who opens one himself: servos, or a stage."""
    return Bench, StageBench


@pytest.fixture
def bench(tmp_path, request, world):
    """An opened bench; `@pytest.mark.parametrize("bench", [{...}], indirect=True)` changes its settings."""
    settings = getattr(request, "param", None)
    if settings is None and "bench_settings" in request.fixturenames:
        settings = request.getfixturevalue("bench_settings")
    one = Bench(tmp_path, world, **(settings or {}))
    try:
        yield one.open()
    finally:
        one.close()


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
            self.broken, self.goal = False, position

        @property
        def tension(self):
            return 0.0 if self.broken else max(0.0, self.stiffness * (self.position - self.taut))

        def advance(self, dt, setpoint):
            """Follow a setpoint with a lag of 20 ms, never beyond its tension limit."""
            if setpoint.position is not None:
                self.goal = setpoint.position
            goal = self.goal
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


@pytest.fixture
def make_rig(tmp_path, world):
    """Make a rig whose ports stand in the folder of the test."""
    rigs = []

    def make(**settings):
        rigs.append(EmulatedRig(clock=world.clock, **settings).open_ports(tmp_path, world.port))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()
    world.close()
