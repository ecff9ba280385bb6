# SPDX-License-Identifier: Apache-2.0
"""Steps on the ports and the servos' bus, before any node runs: the figures of scan, selftest and the wizard."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from stat import S_ISCHR

from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.figures import Figure, at_least, at_most, equal_to, within
from softgrip_description.cell_file import CellFile, ChainServo, ServoChain
from softgrip_driver.commands import selftest
from softgrip_driver.usb_adapter import LATENCY_REMEDY, SLOW_ADAPTER_S, naming_advice
from softgrip_driver.wizard.chain import (
    BAUD,
    chain_backend,
    chain_controller,
    chain_rate,
    homing_tension,
    is_calibrated,
    make_loop,
    model_of,
    open_bus,
    setup_of,
    spool_of,
    torque_of,
    torque_of_data_sheet,
)
from softgrip_driver.wizard.direction import measure_direction, reversed_spool_remedy
from softgrip_driver.wizard.drive_setup import BusMeasurement, DriveSetup, ServoHealth, SetupBackend, SetupBus
from softgrip_driver.wizard.tensioning import Tensioner, TensioningPlan, release
from softgrip_driver.wizard.wizard import WizardSettings
from softgrip_time import Clock

#: [s] of latency timer that `make udev` sets
MAX_LATENCY_TIMER_S = 0.001
#: share of answers that may be lost on a good cable
MAX_LOST_SHARE = 0.001
#: [m] by which the zero may move between two homings: each may be off by 0.3 mm, the furthest of 252 (docs/driver.md)
MAX_ZERO_SHIFT_M = 6e-4
CALIBRATE_REMEDY = (
    "`ros2 run softgrip_driver calibrate_tension` with a gauge in the tendon does better (docs/bench.md, section 6)"
)


@dataclass
class BenchBus:
    """What the steps on the bus share.

    Attributes:
        cell: the cell file.
        reply_margin_s: [s] for a reply beyond the time of its bytes.
        selftest_s: [s] of the self-test.
        clock: that is waited on; None = the computer's.
        say: told what happens.
    """

    cell: CellFile
    reply_margin_s: float = 0.02
    selftest_s: float = 3.0
    clock: Clock | None = None
    say: Callable[[str], object] = field(default=lambda _: None)

    @property
    def chain(self) -> ServoChain:
        """The servos; a step that needs them is left out without."""
        assert self.cell.servos is not None
        return self.cell.servos

    @property
    def setup(self) -> DriveSetup:
        """What is known of the servos' make; raises ConfigurationError where nothing is."""
        return setup_of(self.chain)

    def open(self) -> AbstractContextManager[SetupBus]:
        """Give the open bus, and close it; raises DriverError."""
        return open_bus(self.chain, self.reply_margin_s, self.clock)

    @cached_property
    def measured(self) -> BusMeasurement:
        """The self-test, measured once for the steps that look at it."""
        with self.open() as bus:
            return self.setup.measure(bus, self.selftest_s)

    def hardware_error(self, servo: ChainServo, who: str, health: ServoHealth) -> Figure:
        """Return what a servo says of itself; it says so until it is reset, also when the cause is gone."""
        chain, setup = self.chain, self.setup
        causes = "; ".join(setup.error_causes(health.error, model_of(chain, servo))) or "remove the cause"
        remedy = f"{causes}, then {setup.reset_remedy(chain.port, chain.baud or BAUD, servo.servo_id)}"
        return equal_to(f"{who}: hardware error", health.error.name or "none", "none", remedy)


@dataclass(frozen=True)
class PortsStep:
    """Every port of the cell file is there and may be opened."""

    bench: BenchBus
    key = "ports"
    title = "Ports"
    needs = ()

    def measure(self) -> Iterator[Figure]:
        """Yield a figure for each port."""
        cell = self.bench.cell
        ports = {"servos": cell.servos.port} if cell.servos else {}
        ports |= {"stage": cell.rig.stage.port, "gauge": cell.rig.gauge.port} if cell.rig else {}
        for name, port in ports.items():
            yield equal_to(name, _state_of(Path(port)), "a port that may be opened", _port_remedy(port))


def _state_of(path: Path) -> str:
    try:
        if not S_ISCHR(path.stat().st_mode):
            return "something that is no port"
    except OSError:
        return "nothing there"
    return "a port that may be opened" if os.access(path, os.R_OK | os.W_OK) else "a port of others"


def _port_remedy(port: str) -> str:
    return naming_advice(port) or (
        f"{port}: plug it in, see `ls /dev/serial/by-id`; be in the group dialout (`sudo usermod -aG dialout $USER`)"
    )


@dataclass(frozen=True)
class IdsStep:
    """Every servo of the chain answers, once, as the model that it is said to be, without an error."""

    bench: BenchBus
    key = "ids"
    title = "Servos: IDs and models"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield three figures for each servo."""
        chain, setup = self.bench.chain, self.bench.setup
        baud = chain.baud or BAUD
        with self.bench.open() as bus:
            found = {one.servo_id: one for one in setup.find(bus, 0.5)}
            if not found:
                raise FirstRunError(f"{chain.port}: expected servos at {baud} baud, found {setup.who_answers(bus)}")
            for servo in chain.chain:
                model, one = model_of(chain, servo), found.get(servo.servo_id)
                shown = "nobody" if one is None else setup.model_names.get(one.number, f"model {one.number}")
                who = f"{servo.tendon}, ID {servo.servo_id}"
                remedy = "correct its model in the cell file" if one else f"on the bus: {setup.who_answers(bus)}"
                yield equal_to(who, shown, model.name, remedy)
                if one is not None:
                    several = "several" if one.is_shared else "1"
                    yield equal_to(f"{who}: servos with this ID", several, "1", setup.shared_id_remedy)
                    yield self.bench.hardware_error(servo, who, setup.health(bus, servo.servo_id))


@dataclass(frozen=True)
class RateStep:
    """The bus carries the driver's cycles at the wanted rate, without loss."""

    bench: BenchBus
    key = "rate"
    title = "Bus: rate and losses"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield rate and losses."""
        found, rate = self.bench.measured, chain_rate(self.bench.chain)
        remedy = "; ".join(selftest.causes(found, rate)) or "close other programs"
        yield at_least("the driver's cycles", found.rate, rate, "Hz", remedy)
        yield at_most("lost answers", found.lost_share, MAX_LOST_SHARE, "", remedy)
        yield equal_to("damaged packets", found.corrupt, 0, remedy)


@dataclass(frozen=True)
class LatencyStep:
    """The adapter hands bytes over at once."""

    bench: BenchBus
    key = "latency"
    title = "Bus: latency"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield how late replies are, and the adapter's timer where it has one."""
        found = self.bench.measured
        yield at_most("replies beyond their bytes", found.turnaround * 1e3, SLOW_ADAPTER_S * 1e3, "ms", LATENCY_REMEDY)
        if found.latency_timer is not None:
            timer = found.latency_timer * 1e3
            yield at_most("latency timer of the adapter", timer, MAX_LATENCY_TIMER_S * 1e3, "ms", LATENCY_REMEDY)


@dataclass(frozen=True)
class SupplyStep:
    """Each servo has the supply that its model takes, and is cool."""

    bench: BenchBus
    key = "supply"
    title = "Servos: supply and temperature"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield voltage and temperature of each servo."""
        chain, setup = self.bench.chain, self.bench.setup
        with self.bench.open() as bus:
            for servo in chain.chain:
                model, health = model_of(chain, servo), setup.health(bus, servo.servo_id)
                volts = health.voltage_v
                low, high = model.voltage_range
                remedy = (
                    f"a {model.name} takes {low:g} to {high:g} V: switch off and use another supply"
                    if volts > high
                    else "use a stronger supply and shorter leads, or one of a higher voltage"
                )
                yield within(f"{servo.tendon}: supply", volts, model.voltage_range, "V", remedy)
                degc = health.temperature_degc
                remedy = "let it cool down; something may press on its tendon"
                yield at_most(f"{servo.tendon}: temperature", degc, model.temperature_limit - 15.0, "degC", remedy)
                yield self.bench.hardware_error(servo, servo.tendon, health)


@dataclass(frozen=True)
class ZeroStep:
    """Directions are known and right, slack was left, and homing finds the same zero twice."""

    bench: BenchBus
    key = "zero"
    title = "Tendons: zero"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield direction, slack of the tensioning and shift of the zero for each tendon."""
        chain = self.bench.chain
        for servo in chain.chain:
            remedy = "run `ros2 run softgrip_driver wizard` with this cell file"
            yield equal_to(f"{servo.tendon}: direction", "known" if servo.direction else "unknown", "known", remedy)
            yield equal_to(f"{servo.tendon}: tensioned", "no" if servo.slack_m is None else "yes", "yes", remedy)
        if any(servo.direction is None for servo in chain.chain):
            return
        are_right = True
        for servo in chain.chain:
            found = measure_direction(chain, servo, lambda one: self._backend([one]))
            are_right &= found == servo.direction
            yield equal_to(f"{servo.tendon}: pulls in direction", found, servo.direction, reversed_spool_remedy(servo))
        if are_right:  # homing would pay out a tendon that is wound the other way round
            yield from self._shifts()

    def _backend(self, servos: Sequence[ChainServo]) -> SetupBackend:
        bench = self.bench
        return chain_backend(bench.chain, servos, bench.reply_margin_s, bench.say, bench.clock)

    def _shifts(self) -> Iterator[Figure]:
        chain = self.bench.chain
        backend = self._backend(chain.chain)
        controller = chain_controller(chain, chain.chain)
        taut_n = homing_tension(chain, self.bench.cell.parameters.get("tendon_driver", {}))
        plan = TensioningPlan(tension_n=max(TensioningPlan.tension_n, taut_n), rounds=3)
        try:
            with backend.bus.clock.stepping():
                backend.connect()
            loop = make_loop(backend, controller, chain_rate(chain))
            zeros = Tensioner(loop, controller, plan, self.bench.say).settle()
            # a finger that is left taut is bent: the camera's steps want it straight
            slack = {servo.tendon: servo.slack_m or WizardSettings.slack_m for servo in chain.chain}
            with backend.bus.clock.stepping():
                release(backend, {name: zero.zero_m - slack[name] for name, zero in zeros.items()}, plan)
        finally:
            backend.disconnect()
        for name, zero in zeros.items():
            shift = abs(zero.shift_m) * 1e3
            remedy = (
                "look for a knot that slips, a turn on a turn, a finger that sticks; then take slack_m of this tendon "
                "out of the cell file and run the wizard"
            )
            yield at_most(f"{name}: zero moved by", shift, MAX_ZERO_SHIFT_M * 1e3, "mm", remedy)


@dataclass(frozen=True)
class TensionStep:
    """How well tensions are known: by a calibration, or by the data sheet alone, which the record says."""

    bench: BenchBus
    key = "tension"
    title = "Servos: tension constants"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield what each tendon's tension is known to: a share of it, and what standing gears hide."""
        chain = self.bench.chain
        homing_n = homing_tension(chain, self.bench.cell.parameters.get("tendon_driver", {}))
        for servo in chain.chain:
            torque, radius = torque_of(chain, servo), spool_of(servo).radius
            share = torque.relative_stddev
            _, hidden_n = torque.pull(0.0, 0.0, radius)
            remedy = "run calibrate_tension with a gauge in the tendon, and put its lines into the cell file"
            known = f"+-{100.0 * share:.0f} % and {hidden_n:.1f} N"
            remark = "" if is_calibrated(servo) else f"not calibrated: data-sheet values, {known}; {CALIBRATE_REMEDY}"
            yield at_most(
                f"{servo.tendon}: uncertainty, from {torque.source}",
                100.0 * share,
                100.0 * torque_of_data_sheet(chain, servo).relative_stddev,
                "%",
                remedy,
            ).with_remark(remark)
            yield at_most(f"{servo.tendon}: hidden by standing gears", hidden_n, homing_n, "N", remedy)
