# SPDX-License-Identifier: Apache-2.0
"""The wizard: each step does what the cell file lacks, and writes it back, so that it can be left at any time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from softgrip_description.cell_file import (
    CellFile,
    ChainServo,
    ServoChain,
    cell_text,
    load_cell,
    parse_cell,
    save_cell,
)
from softgrip_description.errors import CellFileError
from softgrip_driver.commands import selftest
from softgrip_driver.commands.person import Terminal
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError, DriverError
from softgrip_driver.tendon.gripper import GripperController
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.needs import SHIPPED_LOOP_RATE
from softgrip_driver.usb_adapter import LATENCY_REMEDY, SLOW_ADAPTER_S
from softgrip_driver.wizard.chain import (
    chain_backend,
    chain_controller,
    chain_parameters,
    chain_rate,
    homing_tension,
    make_loop,
    open_bus,
    setup_of,
)
from softgrip_driver.wizard.direction import SpoolPull, measure_direction, reversed_spool_remedy
from softgrip_driver.wizard.drive_setup import DEFAULT_DRIVE, SetupBackend
from softgrip_driver.wizard.naming import describe_past, find_new_servo, is_verified, model_found, name_servo
from softgrip_driver.wizard.sections import CellSections, Fill, FoundDevices, find_devices
from softgrip_driver.wizard.tensioning import Tensioner, TensioningPlan, release
from softgrip_time import Clock

Result = TypeVar("Result")


@dataclass(frozen=True)
class WizardSettings:
    """What is asked for.

    Attributes:
        file: the cell file, read where it is there.
        port: of the bus; empty = that of the file.
        drive: backend of the servos; empty = that of the file, else Dynamixel.
        baud: [1/s] that the chain gets.
        tendons: in order of the chain; none = those of the file.
        spool_radius_m: [m] of every spool.
        slack_m: [m] of loose tendon at the end.
        pull, tensioning: how it is pulled.
        reply_margin_s: [s] for a reply beyond that of its bytes.
        selftest_s: [s] of the self-test. rate_hz: [Hz] that it must reach.
        clock: that is waited on; None = the computer's.
    """

    file: Path
    port: str = ""
    drive: str = ""
    baud: int = 1_000_000
    tendons: tuple[str, ...] = ()
    spool_radius_m: float = 0.010
    slack_m: float = 0.005
    pull: SpoolPull = field(default_factory=SpoolPull)
    tensioning: TensioningPlan = field(default_factory=TensioningPlan)
    reply_margin_s: float = 0.02
    selftest_s: float = 3.0
    rate_hz: float = SHIPPED_LOOP_RATE
    clock: Clock | None = None


class SetupWizard:
    """Leads from servos as they come to a cell file of a cell that is ready.

    Args:
        settings: what is asked for.
        person: who does what a hand must do.
        make_loop: the driver's loop over a backend, a controller and a rate [Hz].
        find_devices: what is plugged in besides the servos' port.
    """

    def __init__(
        self,
        settings: WizardSettings,
        person: Terminal,
        make_loop: Callable[[SetupBackend, GripperController, float], BusLoop] = make_loop,
        find_devices: Callable[[str], FoundDevices] = find_devices,
    ) -> None:
        self._settings, self._person, self._make_loop = settings, person, make_loop
        self._find_devices = find_devices
        self._cell = load_cell(settings.file) if settings.file.exists() else CellFile("real")
        chain = self._cell.servos or ServoChain("", settings.baud)
        drive = settings.drive or chain.drive or DEFAULT_DRIVE
        if chain.chain and drive != (chain.drive or DEFAULT_DRIVE):
            raise ConfigurationError(
                f"--drive: expected that of the chain in {settings.file}, {chain.drive or DEFAULT_DRIVE}, found {drive}"
                "; one bus has servos of one make"
            )
        self._chain = replace(
            chain,
            port=settings.port or chain.port,
            baud=chain.baud or settings.baud,
            drive=None if drive == DEFAULT_DRIVE else drive,
        )
        self._setup = setup_of(self._chain)
        self._tendons = settings.tendons or tuple(servo.tendon for servo in chain.chain)
        #: whose directions this run has found; those of the file may be of a tendon that was wound again since
        self._turned = set[str]()

    @property
    def baud(self) -> int:
        """[1/s] of the chain."""
        return self._chain.baud or self._settings.baud

    def run(self) -> bool:
        """Do what is missing; return whether the self-test is good.

        Raises:
            DriverError: of a step that the person does not try again.
            CellFileError: the cell file.
        """
        if not self._chain.port or not self._tendons:
            raise ConfigurationError(
                "expected a port and tendons, found none in the cell file; give --port and --tendons"
            )
        self._until_done("port", self._check_port)
        for number, tendon in enumerate(self._tendons, start=1):
            self._until_done(f"connect.{tendon}", partial(self._name, tendon, number))
        self._check_chain()
        for tendon in self._tendons:
            self._until_done(f"tie.{tendon}", partial(self._turn, tendon))
        self._until_done("straight", self._tension)
        is_good = self._test()
        self._describe_cell()
        return is_good

    # --- steps -----------------------------------------------------------------------------------------------------

    def _check_port(self) -> None:
        """See that the port can be opened before anybody is asked to put servos on it."""
        with open_bus(self._chain, self._settings.reply_margin_s, self._settings.clock):
            self._person.print_line(f"port: {self._chain.port} is open")

    def _name(self, tendon: str, number: int) -> None:
        """Give the servo of a tendon its ID."""
        if self._servo(tendon) is not None:
            return
        known = {servo.servo_id for servo in self._chain.chain}
        others = "alone on the cable" if not known else "at the end of the chain"
        self._person.confirm(
            f"connect.{tendon}", f"Switch the supply off, put the servo of '{tendon}' {others}, switch it on"
        )
        found = find_new_servo(self._setup, self._chain.port, self.baud, known, self._settings.clock)
        model = model_found(self._setup, found)
        if past := describe_past(self._setup, found):
            self._person.print_line(past)
        # the next new one must not come with the ID and rate of one that is in the chain
        taken = known | ({self._setup.factory[0]} if self._setup.factory[1] == self.baud else set())
        new_id = next(one for one in range(number, 253) if one not in taken)
        done = name_servo(self._setup, found, new_id, self.baud, self._settings.reply_margin_s, self._settings.clock)
        radius = self._settings.spool_radius_m
        self._keep(ChainServo(tendon, model.name, new_id, spool_radius_m=radius))
        self._person.print_line(f"{tendon}: {model.name}; {'; '.join(done)}")

    def _check_chain(self) -> None:
        """See that every servo of the chain answers, once, and how soon."""
        with open_bus(self._chain, self._settings.reply_margin_s, self._settings.clock) as bus:
            for servo in self._chain.chain:
                if not is_verified(self._setup, bus, servo.servo_id, servo.model):
                    raise DeviceNotFoundError(
                        f"{servo.tendon}: expected one {servo.model} with ID {servo.servo_id} at {self.baud} baud, "
                        f"found {self._setup.who_answers(bus)}"
                    )
            late_s = self._setup.turnaround(bus, self._chain.chain[0].servo_id)
        self._person.print_line(f"chain: {', '.join(f'{one.tendon} = ID {one.servo_id}' for one in self._chain.chain)}")
        if late_s > SLOW_ADAPTER_S:
            self._person.print_line(
                f"! the adapter keeps bytes back: expected replies within {SLOW_ADAPTER_S * 1e3:.0f} ms, found "
                f"{late_s * 1e3:.0f} ms; {LATENCY_REMEDY}"
            )

    def _turn(self, tendon: str) -> None:
        """Find the direction of a spool."""
        servo = self._servo(tendon)
        if servo is None or servo.direction is not None:
            return
        self._person.confirm(
            f"tie.{tendon}",
            f"Tie the tendon of '{tendon}' to its spool and finger, take up most of its slack, keep your hands away",
        )
        direction = self._measured_direction(servo)
        self._turned.add(tendon)
        self._keep(replace(servo, direction=direction))
        self._person.print_line(
            f"{tendon}: a {'positive' if direction > 0 else 'negative'} rotation pulls (direction {direction})"
        )

    def _measured_direction(self, servo: ChainServo) -> int:
        return measure_direction(self._chain, servo, lambda one: self._backend([one]), self._settings.pull)

    def _check_directions(self, servos: Sequence[ChainServo]) -> None:
        """See that tendons whose direction the file says are wound that way: homing would pay the others out."""
        for servo in servos:
            if servo.tendon in self._turned or servo.direction is None:
                continue
            found = self._measured_direction(servo)
            if found != servo.direction:
                raise ConfigurationError(
                    f"{servo.tendon}: expected a spool that pulls in direction {servo.direction}, found {found}; "
                    f"{reversed_spool_remedy(servo)}"
                )
            self._turned.add(servo.tendon)

    def _tension(self) -> None:
        """Wind, hold, release all tendons."""
        servos = [servo for servo in self._servos() if servo.slack_m is None]
        if not servos:
            return
        self._person.confirm("straight", "See that the fingers are straight and free, keep your hands away")
        self._check_directions(servos)
        plan = self._settings.tensioning
        # a hold that is not felt over what the gears hide would bed nothing
        taut_n = homing_tension(self._chain, self._cell.parameters.get("tendon_driver", {}))
        plan = replace(plan, tension_n=max(plan.tension_n, taut_n))
        backend, controller = self._backend(servos), chain_controller(self._chain, servos)
        try:
            with backend.bus.clock.stepping():
                backend.connect()
            loop = self._make_loop(backend, controller, chain_rate(self._chain))
            zeros = Tensioner(loop, controller, plan, self._person.print_line).settle()
            goals = {name: one.zero_m - self._settings.slack_m for name, one in zeros.items()}
            with backend.bus.clock.stepping():
                rest = release(backend, goals, plan)
        finally:
            backend.disconnect()
        for servo in servos:
            zero, slack_m = zeros[servo.tendon], zeros[servo.tendon].zero_m - rest[servo.tendon]
            self._keep(replace(servo, slack_m=round(slack_m, 5)))
            settled = (
                ""
                if zero.has_settled
                else "; it has not settled: look for a knot that slips, take the tendon's slack_m out of "
                f"{self._settings.file} and run the wizard again"
            )
            self._person.print_line(
                f"{servo.tendon}: slack {slack_m * 1e3:.1f} mm, zero within {abs(zero.shift_m) * 1e3:.2f} mm{settled}"
            )

    def _test(self) -> bool:
        """Measure the bus with the driver's own cycles."""
        with open_bus(self._chain, self._settings.reply_margin_s, self._settings.clock) as bus:
            found = self._setup.measure(bus, self._settings.selftest_s)
        is_good = found.rate >= self._settings.rate_hz and found.servos == len(self._chain.chain)
        self._person.print_line(
            f"self-test: {found.servos} servos, {found.rate:.0f} Hz (at least {self._settings.rate_hz:.0f}), "
            f"lost answers {found.lost_share:.2%}: {'good' if is_good else 'not good'}"
        )
        for cause in selftest.causes(found, self._settings.rate_hz):
            self._person.print_line(f"-> {cause}")
        return is_good

    def _describe_cell(self) -> None:
        """Ask for what the file lacks besides servos, and keep each answer at once."""
        folder = self._settings.file.expanduser().resolve().parent
        found = self._find_devices(self._chain.port)
        sections = CellSections(self._person, found, folder, self._settings.clock)
        for key, fill in [*sections.missing(self._cell)]:
            self._until_done(key, partial(self._fill, fill))

    def _fill(self, fill: Fill) -> None:
        cell = fill(self._cell)
        path = self._settings.file
        parse_cell(cell_text(cell), path)  # a name or a port that no cell file may have is refused, not written
        save_cell(cell, path)
        self._cell = cell

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _until_done(self, key: str, step: Callable[[], None]) -> None:
        while True:
            try:
                step()
            except (DriverError, CellFileError) as error:
                if not self._person.try_again(key, str(error)):
                    raise
            else:
                return

    def _servo(self, tendon: str) -> ChainServo | None:
        return next((servo for servo in self._chain.chain if servo.tendon == tendon), None)

    def _servos(self) -> Sequence[ChainServo]:
        return [servo for servo in self._chain.chain if servo.tendon in self._tendons]

    def _backend(self, servos: Sequence[ChainServo]) -> SetupBackend:
        return chain_backend(
            self._chain, servos, self._settings.reply_margin_s, self._person.print_line, self._settings.clock
        )

    def _keep(self, servo: ChainServo) -> None:
        """Put a servo into the cell file."""
        self._chain = self._chain.with_servo(servo)
        parameters = {node: dict(values) for node, values in self._cell.parameters.items()}
        if required := chain_parameters(self._chain):
            parameters["tendon_driver"] = required | parameters.get("tendon_driver", {})
        self._cell = replace(self._cell, servos=self._chain, parameters=parameters)
        save_cell(self._cell, self._settings.file)
