# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver calibrate_tension`: the torque model of a servo, measured against a force gauge."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from softgrip_driver.commands.common import (
    DONE,
    add_bus_options,
    add_gauge_options,
    add_lockstep_option,
    clock_of,
    number,
    parser,
    run,
    stream_settings,
)
from softgrip_driver.commands.tension_recording import TensionSample, check_writable, read_csv, write_csv
from softgrip_driver.damiao import frames as damiao_frames
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, ServoModel
from softgrip_driver.errors import ConfigurationError, LimitError
from softgrip_driver.feetech import registers as feetech_registers
from softgrip_driver.rig.build import make_gauge
from softgrip_driver.rig.devices import Gauge
from softgrip_driver.tendon.backend import DriveReading, Setpoint
from softgrip_driver.tendon.needs import EARLY_SHUTDOWN_SHARE
from softgrip_driver.tendon.safety_store import check_port_is_free_to_move
from softgrip_driver.tendon.units import Spool, TorqueModel, fit_torque_model
from softgrip_driver.tendon.winding import MotorReading, Winding, fit_winding
from softgrip_driver.wizard.direction import read_drive
from softgrip_time import Clock

TEXT = """Fit the torque model of a servo, k current = tension radius + friction, against a force gauge or weights.

With --gauge: tie the tendon to the gauge through a spring (a few N/mm). The servo winds in and pays out slowly, several
times, at --speed and at a third of it. It turns round at --tension of the gauge or of its own estimate, whichever comes
first, or after --travel. With --weights: hang one after the other on the tendon when asked; each is lifted by --travel
and let down, at four times --speed, too.

XL330 and XC330 measure the current of their supply: resistance and back-EMF of the motor are fitted, too, and which
current they limit is found out. Ends with the lines for the parameters of tendon_driver. With --csv a recording is
fitted instead; --record writes one."""

PERIOD = 0.05
#: [s] after a turn-round in which friction still turns, and nothing is recorded
TURNING = 0.4
#: shares of --speed, one round after the other: at one speed alone back-EMF and friction look alike. Gears rub less the
#: faster they turn, so weights are lifted quickly as well; a gauge behind a spring would tell that force too late
PACES = (1.0, 1.0 / 3.0)
WEIGHT_PACES = (*PACES, 4.0)
#: [m/s^2]
GRAVITY = 9.80665
#: [s] that a servo may take to stand at its limit, [s] that it has to stand, [m] its goal is ahead of it meanwhile
LIMIT_TIMEOUT_S, LIMIT_STANDS_S, LIMIT_AHEAD_M = 4.0, 0.3, 0.002
#: a current this close to the goal current, relative, is the one that is limited
LIMIT_SHARE = 0.3


class Weight:
    """A mass that hangs on the tendon, where a gauge would be."""

    def __init__(self, mass: float) -> None:
        self._force = mass * GRAVITY

    def tension(self) -> float:
        """Return its weight [N]."""
        return self._force


def measure(
    backend: DynamixelBackend,
    gauge: Gauge | Weight,
    tension: float,
    travel: float,
    speed: float,
    rounds: int,
    paces: Sequence[float] = PACES,
) -> list[TensionSample]:
    """Wind in and pay out several times, and return what was seen while moving steadily.

    Args:
        backend: of one servo.
        gauge: what pulls on its tendon.
        tension: [N] at which it turns round, of the gauge or of its own estimate.
        travel: [m] after which it turns round at the latest.
        speed: [m/s] of the first round.
        rounds: in and out.
        paces: shares of the speed, one round after the other.

    Raises:
        DriverError: of servo or gauge, or the servo lets go by itself; it is let go on every path.
    """
    (name,) = backend.tendons
    samples: list[TensionSample] = []
    backend.power(name, True)
    try:
        start = here = read_drive(backend).position
        for turn in range(2 * rounds):
            inward = turn % 2 == 0
            pace = speed * paces[turn // 2 % len(paces)] * (1.0 if inward else -1.0)
            ramp = _Ramp(here, pace, 1.2 * tension, backend.bus.clock)
            while True:
                reading = ramp.follow(backend, PERIOD)
                check_it_pulls(reading, name)
                here, force = ramp.goal(), gauge.tension()
                if ramp.elapsed() > TURNING and abs(reading.velocity) > 0.3 * abs(pace):
                    samples.append(_sampled(backend.motor(name), reading.velocity, force))
                if inward and (max(force, reading.tension) >= tension or here - start >= travel):
                    break
                if not inward and here <= start:
                    break
            print(f"round {turn // 2 + 1}/{rounds} {'in ' if inward else 'out'}: {force:.2f} N, {len(samples)} samples")
    finally:
        backend.power(name, False)
    return samples


def check_it_pulls(reading: DriveReading, tendon: str) -> None:
    """Raise LimitError where a servo has let go by itself: a falling weight is no calibration."""
    if reading.faults or reading.powered is False:
        found = ", ".join(reading.faults) or "its torque off"
        raise LimitError(
            f"tendon '{tendon}': expected it to go on pulling, found {found}; reboot it, let it cool, and take lighter "
            "weights, a lower --tension or a higher --speed"
        )


def _sampled(motor: MotorReading, velocity: float, force: float) -> TensionSample:
    return TensionSample(motor.current, velocity, force, motor.duty, motor.voltage, motor.temperature)


class _Ramp:
    """A goal that moves evenly: steps would accelerate the motor, and its inertia would look like tension."""

    def __init__(self, start: float, pace: float, tension_limit: float, clock: Clock) -> None:
        self._start, self._pace, self._limit, self._clock = start, pace, tension_limit, clock
        self._began = clock.now_s()

    def elapsed(self) -> float:
        """Return the time [s] since it began."""
        return self._clock.now_s() - self._began

    def goal(self) -> float:
        """Return where it is [m]."""
        return self._start + self._pace * self.elapsed()

    def follow(self, backend: DynamixelBackend, duration: float) -> DriveReading:
        """Write the goal for a duration [s] as fast as the bus goes; return the last reading."""
        (name,) = backend.tendons
        end = self.elapsed() + duration
        reading = None
        while reading is None or self.elapsed() < end:
            backend.write({name: Setpoint(self.goal(), self._limit)})
            reading = read_drive(backend)
        return reading


def find_limited_current(backend: DynamixelBackend, tension: float) -> CurrentSensing | None:
    """Let a servo that senses its supply pull up to its limit; return which current that acts on, None if unclear.

    The limit is the supply's current for a tension [N]: should it act on the winding, the servo pulls next to nothing.
    One current near the limit decides; none, or both, do not (LIMIT_SHARE).
    """
    (name,) = backend.tendons
    backend.power(name, True)
    try:
        deadline = backend.bus.clock.now_s() + LIMIT_TIMEOUT_S
        stood_since = began = backend.bus.clock.now_s()
        while stood_since + LIMIT_STANDS_S > began < deadline:
            reading = read_drive(backend)
            backend.write({name: Setpoint(reading.position + LIMIT_AHEAD_M, tension)})
            began = backend.bus.clock.now_s()
            if abs(reading.velocity) > TorqueModel.STANDING_SPEED:
                stood_since = began
        motor, goal = backend.motor(name), backend.goal_current(name)
        winding, _ = backend.winding(name).current(motor)
    finally:
        backend.power(name, False)
    currents = {CurrentSensing.SUPPLY: motor.current, CurrentSensing.WINDING: winding}
    at_limit = [kind for kind, current in currents.items() if abs(current - goal) <= LIMIT_SHARE * goal]
    return at_limit[0] if len(at_limit) == 1 else None


@dataclass(frozen=True)
class TorqueCalibration:
    """What a recording shows of a servo.

    Attributes:
        torque: torque model.
        winding: resistance and back-EMF; None where the servo senses the winding's current itself.
        scatter: [N] root mean square of what the model leaves over.
    """

    torque: TorqueModel
    winding: Winding | None
    scatter: float

    def lines(self) -> Iterator[str]:
        """Yield the lines for the parameters of tendon_driver."""
        if self.winding is not None:
            yield f"winding_resistances_ohm: [{self.winding.resistance:.4f}]"
            yield f"back_emfs_v_s: [{self.winding.back_emf:.5f}]"
            yield f"winding_stddev_share: [{self.winding.relative_stddev:.4f}]"
        yield f"torque_per_ampere_nm_a: [{self.torque.torque_per_ampere:.5f}]"
        yield f"friction_currents_a: [{self.torque.friction_current:.5f}]"
        yield f"friction_slopes_a_s_m: [{self.torque.friction_slope:.5f}]"
        yield f"gear_load_shares: [{self.torque.load_share:.4f}]"
        yield f"quick_stddevs_n_s2_m2: [{self.torque.quick_stddev:.1f}]"
        yield f"tension_stddev_share: [{self.torque.relative_stddev:.4f}]"


def calibrate(samples: Sequence[TensionSample], model: ServoModel, radius: float, source: str) -> TorqueCalibration:
    """Fit what a recording shows.

    Args:
        samples: of a servo that wound in and paid out under tensions that vary.
        model: of the servo.
        radius: [m] of its spool.
        source: what to write into the model.

    Raises:
        ConfigurationError: the recording does not show it.
    """
    winding = None
    currents = [sample.current_a for sample in samples]
    if model.senses is not CurrentSensing.WINDING and not any(math.isnan(sample.duty) for sample in samples):
        motors = [sample.motor(radius) for sample in samples]
        winding = Winding(model.resistance, model.back_emf)
        if model.senses is CurrentSensing.SUPPLY:
            winding = fit_winding(motors, winding)
        currents = [winding.current(motor)[0] for motor in motors]
    speeds = [sample.speed_m_s for sample in samples]
    tensions = [sample.tension_n for sample in samples]
    torque = fit_torque_model(currents, speeds, tensions, radius, source)
    squares = [
        (torque.pull(current, speed, radius)[0] - tension) ** 2
        for current, speed, tension in zip(currents, speeds, tensions, strict=True)
    ]
    return TorqueCalibration(torque, winding, math.sqrt(math.fsum(squares) / len(squares)))


def _measured(options: argparse.Namespace) -> list[TensionSample]:
    """Measure with the servo and the gauge or weights that the options name."""
    if not options.port or bool(options.gauge) == bool(options.weights):
        raise ConfigurationError("expected --port and either --gauge or --weights, or --csv; see --help")
    if options.record:
        check_writable(options.record)
    model = MODELS[options.model]
    torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
    servo = ServoConfiguration("tendon", options.id, model, Spool(options.radius, options.direction), torque)
    check_port_is_free_to_move(options.port)
    clock = clock_of(options)
    backend = DynamixelBackend(
        Bus(options.port, options.baud, options.reply_margin, clock), [servo], watchdog=0.5, report=print
    )
    with clock.stepping():
        try:
            if options.weights:
                return _measured_with_weights(backend, options)
            return _measured_with_gauge(backend, options)
        finally:
            backend.disconnect()


def _measured_with_gauge(backend: DynamixelBackend, options: argparse.Namespace) -> list[TensionSample]:
    gauge = make_gauge(options.gauge_kind, options.gauge, stream_settings(options), clock=backend.bus.clock)
    gauge.open()
    try:
        backend.connect()
        gauge.tare()
        samples = measure(backend, gauge, options.tension, options.travel, options.speed, options.rounds)
        _print_limited_current(backend, options, 0.5 * options.tension)
        return samples
    finally:
        gauge.close()


def _measured_with_weights(backend: DynamixelBackend, options: argparse.Namespace) -> list[TensionSample]:
    backend.connect()
    samples: list[TensionSample] = []
    model = MODELS[options.model]
    lasting_kg = EARLY_SHUTDOWN_SHARE * model.stall_torque / options.radius / GRAVITY
    for mass in chain.from_iterable(options.weights):
        weight = Weight(mass)
        if mass > lasting_kg:
            print(f"# of more than {lasting_kg:.1f} kg a {model.name} may let go after some seconds: stand clear")
        input(f"hang {mass:g} kg on the tendon, so that it swings free, then press Enter: ")
        # Never turned round by tension: the servo's own estimate is what is to be measured.
        limit = 2.0 * weight.tension() + 10.0
        samples += measure(backend, weight, limit, options.travel, options.speed, options.rounds, WEIGHT_PACES)
    _print_limited_current(backend, options, 0.5 * weight.tension())
    return samples


def _print_limited_current(backend: DynamixelBackend, options: argparse.Namespace, tension: float) -> None:
    if MODELS[options.model].senses is not CurrentSensing.SUPPLY:
        return
    found = find_limited_current(backend, tension)
    if found is None:
        print("# which current the servo limits did not show: it did not come to stand; measure against a spring")
    else:
        print(f"limited_currents: [{found.value}]")


def work(options: argparse.Namespace) -> int:
    """Measure or read, fit, print."""
    samples = read_csv(options.csv) if options.csv else _measured(options)
    model = MODELS[options.model]
    try:
        found = calibrate(samples, model, options.radius, str(options.csv or "measured"))
        print(f"# {len(samples)} samples; data sheet: {model.torque_per_ampere:.4f} N m/A, {model.resistance:.3f} ohm")
        print(f"# the model leaves {found.scatter:.2f} N of the gauge's reading over (root mean square)")
        if found.winding is None and model.senses is CurrentSensing.SUPPLY:
            print(
                f"# the recording lacks duty, voltage_v and temperature_degc: the current of an {model.name} is its "
                "supply's, and tension does not follow it; measure again"
            )
        print("\n".join(found.lines()))
    finally:
        # Also what shows no model is worth a look, and a full disk costs the recording alone.
        if options.record:
            write_csv(options.record, samples)
    return DONE


def masses(text: str) -> list[float]:
    """Return masses [kg], several with commas between; argparse reports what is wrong."""
    return [number(0.01, 50.0)(one) for one in text.split(",")]


def dynamixel_model(text: str) -> str:
    """Return the name of a model that can be measured; argparse reports what is wrong with any other."""
    if text in MODELS:
        return text
    known = f"expected one of {', '.join(sorted(MODELS))}, found '{text}'"
    for backend, models in (("feetech", feetech_registers.MODELS), ("damiao", damiao_frames.MODELS)):
        if text in models:
            raise argparse.ArgumentTypeError(
                f"{known}: this command moves Dynamixel servos only. With the backend {backend} tensions are those of "
                "the maker's values; tension_stddev in tendon/status says how far to trust them"
            )
    raise argparse.ArgumentTypeError(known)


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("calibrate_tension", TEXT)
    add_bus_options(arguments, required=False)
    arguments.add_argument(
        "--id", type=number(0, 252, int), default=1, metavar="0..252", help="servo ID, default %(default)s"
    )
    arguments.add_argument(
        "--model",
        type=dynamixel_model,
        default="XL330-M288",
        metavar="MODEL",
        help=f"{', '.join(sorted(MODELS))}; default %(default)s",
    )
    arguments.add_argument(
        "--radius", type=number(1e-3, 0.1), default=0.010, metavar="M", help="spool radius, default %(default)s m"
    )
    arguments.add_argument("--direction", type=int, choices=(-1, 1), default=1, help="+1: positive rotation pulls")
    add_gauge_options(arguments)
    arguments.add_argument(
        "--weights", type=masses, nargs="+", default=[], metavar="KG", help="hang these instead of using a gauge"
    )
    arguments.add_argument(
        "--tension", type=number(0.1, 500.0), default=15.0, metavar="N", help="turn round at, default %(default)s N"
    )
    arguments.add_argument(
        "--travel", type=number(1e-3, 0.5), default=0.02, metavar="M", help="wind in at most, default %(default)s m"
    )
    arguments.add_argument(
        "--speed", type=number(5e-4, 0.1), default=0.006, metavar="M/S", help="default %(default)s m/s"
    )
    arguments.add_argument(
        "--rounds", type=number(1, 100, int), default=4, metavar="N", help="in and out, default %(default)s"
    )
    add_lockstep_option(arguments)
    arguments.add_argument("--csv", type=Path, help="fit a recording instead of measuring")
    arguments.add_argument("--record", type=Path, help="write the samples to this file")
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
