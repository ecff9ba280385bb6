# SPDX-License-Identifier: Apache-2.0
"""Feetech STS servos from their boxes to a chain (DriveSetup)."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import IntFlag

from softgrip_driver.errors import (
    MISSING_SERVO_REMEDY,
    ConfigurationError,
    CorruptReplyError,
    DeviceNotFoundError,
    DriverError,
    NoReplyError,
    PortLostError,
    WrongDeviceError,
)
from softgrip_driver.feetech import packets
from softgrip_driver.feetech import registers as reg
from softgrip_driver.feetech.backend import FeetechBackend
from softgrip_driver.feetech.bringup import identify
from softgrip_driver.feetech.bus import FeetechBus
from softgrip_driver.feetech.drive_set import torque_of, winding_of
from softgrip_driver.feetech.registers import BAUD_CODES, MODEL_NAMES, MODELS, FeetechModel, FeetechStatusBits
from softgrip_driver.feetech.servo import FeetechServo
from softgrip_driver.serial_bus import BITS_PER_BYTE
from softgrip_driver.tendon.needs import required_limits
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.usb_adapter import latency_timer
from softgrip_driver.wizard.drive_setup import BusMeasurement, ChainRow, FoundServo, ServoHealth, SetupModel
from softgrip_time import Clock

#: IDs that a servo may have (memory table, ID (5))
_IDS = range(254)
#: as they come (memory table, ID (5) and baud rate (6))
FACTORY_ID, FACTORY_BAUD = 1, 1_000_000
#: reads of what a servo measures, of which most are damaged where two answer at once
_SHARED_READS = 5
#: [N] of no consequence: a servo is only read
_HARD_N, _SPEED_M_S = 45.0, 0.05


class FeetechSetup:
    """See `DriveSetup`."""

    name = "feetech"
    bauds: Sequence[int] = sorted(BAUD_CODES, reverse=True)
    factory = (FACTORY_ID, FACTORY_BAUD)
    models: Mapping[str, FeetechModel] = MODELS
    model_names = MODEL_NAMES
    supply_remedy = (
        "check that the servos' supply is on (the adapter's USB feeds no servo), the cable, and that its LED lights up "
        "when power comes"
    )
    shared_id_remedy = (
        "connect them one at a time; the wizard gives each an ID of its own then, and without the wizard "
        "`ros2 run softgrip_driver setup --drive feetech --id 1 --new-id N` does"
    )

    def make_bus(self, port: str, baud: int, reply_margin_s: float, clock: Clock | None) -> FeetechBus:
        """See `DriveSetup`."""
        return FeetechBus(port, baud, reply_margin_s, clock)

    def find(self, bus: FeetechBus, wait_s: float) -> Sequence[FoundServo]:
        """See `DriveSetup`; several are asked for by each ID, which takes some seconds."""
        del wait_s  # each answers alone, within the bus' own margin
        found = []
        for servo_id in self._ids(bus):
            number, firmware, error = 0, "?", None
            try:
                number = bus.get(servo_id, reg.MODEL_NUMBER, attempts=3)
                version = bus.get(servo_id, reg.FIRMWARE, attempts=3)
                firmware = f"{version & 0xFF}.{version >> 8}"
                error = FeetechStatusBits(bus.get(servo_id, reg.STATUS, attempts=3))
            except PortLostError:
                raise
            except DriverError:
                pass  # what it did say is shown
            name = MODEL_NAMES.get(number, "unknown")
            is_shared = self.is_shared(bus, servo_id)
            found.append(FoundServo(bus.link.path, bus.link.baud, servo_id, number, name, firmware, error, is_shared))
        return found

    def model_number(self, bus: FeetechBus, servo_id: int) -> int:
        """See `DriveSetup`."""
        return bus.get(servo_id, reg.MODEL_NUMBER, attempts=3)

    def is_shared(self, bus: FeetechBus, servo_id: int) -> bool:
        """See `DriveSetup`: pings are alike, but what they measure is not."""
        damaged = 0
        for _ in range(_SHARED_READS):
            try:
                bus.read(servo_id, *reg.CYCLE_BLOCK)
            except CorruptReplyError:
                damaged += 1
            except NoReplyError:
                return False
        return 2 * damaged > _SHARED_READS

    def assign(self, bus: FeetechBus, servo_id: int, new_id: int | None, new_baud: int | None) -> Sequence[str]:
        """See `DriveSetup`: torque off, EPROM unlocked, written, locked again, read back."""
        number = self.model_number(bus, servo_id)
        if self.is_shared(bus, servo_id):
            raise ConfigurationError(f"expected one servo with ID {servo_id}, found several; {self.shared_id_remedy}")
        if new_baud is not None and new_baud not in BAUD_CODES:
            raise ConfigurationError(f"baud rate: expected one of {list(BAUD_CODES)}, found {new_baud}")
        bus.put(servo_id, reg.TORQUE_ENABLE, 0, attempts=3)
        done = [f"ID {servo_id} ({MODEL_NAMES.get(number, number)}): torque off"]
        if new_id is not None and new_id != servo_id:
            self._refuse_taken(bus, new_id)
            bus.put(servo_id, reg.LOCK, 0, attempts=3)
            self._put_unanswered(bus, servo_id, reg.ID, new_id)
            servo_id = new_id
            self._lock(bus, servo_id)
            done.append(f"ID is now {servo_id}, EPROM locked")
        if new_baud is not None and new_baud != bus.link.baud:
            bus.put(servo_id, reg.LOCK, 0, attempts=3)
            self._put_unanswered(bus, servo_id, reg.BAUD_RATE, BAUD_CODES[new_baud])
            bus.close()
            bus.link.baud = new_baud
            bus.open()
            self._lock(bus, servo_id)
            done.append(f"baud rate is now {new_baud}")
        return done

    def health(self, bus: FeetechBus, servo_id: int) -> ServoHealth:
        """See `DriveSetup`."""
        return ServoHealth(
            bus.get(servo_id, reg.PRESENT_VOLTAGE, attempts=3) * reg.VOLT_PER_UNIT,
            float(bus.get(servo_id, reg.PRESENT_TEMPERATURE, attempts=3)),
            FeetechStatusBits(bus.get(servo_id, reg.STATUS, attempts=3)),
        )

    def error_causes(self, error: IntFlag, model: SetupModel) -> Sequence[str]:
        """See `DriveSetup`."""
        low, high = model.voltage_range
        causes = {
            FeetechStatusBits.VOLTAGE: f"its supply is not {low:g} to {high:g} V: use one that is",
            FeetechStatusBits.ENCODER: "replace the servo",
            FeetechStatusBits.TEMPERATURE: "let it cool down",
            FeetechStatusBits.CURRENT: "free its tendon",
            FeetechStatusBits.OVERLOAD: "free its tendon",
        }
        return list(dict.fromkeys(text for bit, text in causes.items() if bit in error))

    def reset_remedy(self, port: str, baud: int, servo_id: int) -> str:
        """See `DriveSetup`."""
        del port, baud
        return f"switch the supply of ID {servo_id} off and on"

    def turnaround(self, bus: FeetechBus, servo_id: int) -> float:
        """See `DriveSetup`."""
        return bus.turnaround(servo_id)

    def who_answers(self, bus: FeetechBus) -> str:
        """See `DriveSetup`."""
        here = self.find(bus, 0.0)
        shared = [one.servo_id for one in here if one.is_shared]
        if shared:
            return f"several servos with ID {shared[0]}; {self.shared_id_remedy}"
        listed = f"ID {_listed(here)} instead" if here else ""
        for baud, others in self._at_other_rates(bus):
            options = (
                f"--drive feetech --port {bus.link.path} --baud {baud} --id {others[0].servo_id} "
                f"--new-baud {bus.link.baud}"
            )
            return (
                f"{listed + ', and ' * bool(listed)}ID {_listed(others)} at {baud} baud; set each with `ros2 run "
                f"softgrip_driver setup {options}`"
            )
        if listed:
            return f"{listed}; {MISSING_SERVO_REMEDY} with `ros2 run softgrip_driver setup --drive feetech --new-id`"
        return f"nobody at any baud rate; {self.supply_remedy}"

    def torque_of_data_sheet(self, model: FeetechModel, spool: Spool) -> TorqueModel:
        """See `DriveSetup`."""
        return torque_of(model, spool)

    def required_parameters(self, servos: Sequence[tuple[FeetechModel, float]]) -> dict[str, float | int]:
        """See `DriveSetup`."""
        return required_limits(servos)

    def make_backend(
        self,
        bus: FeetechBus,
        rows: Sequence[ChainRow],
        parameters: Mapping[str, float | int],
        report: Callable[[str], object],
    ) -> FeetechBackend:
        """See `DriveSetup`."""
        del parameters  # limits are in the rows
        servos = [
            FeetechServo(
                row.tendon,
                row.servo_id,
                row.model,
                row.spool,
                torque_of(row.model, row.spool),
                winding_of(row.model),
                row.limits.tension_hard,
                row.limits.speed,
            )
            for row in rows
        ]
        return FeetechBackend(bus, servos, report=report)

    def measure(self, bus: FeetechBus, seconds: float) -> BusMeasurement:
        """See `DriveSetup`."""
        ids = [one.servo_id for one in self.find(bus, 0.0)]
        if not ids:
            raise DeviceNotFoundError(
                f"{bus.link.path}: expected servos at {bus.link.baud} baud, found none; run scan --drive feetech"
            )
        turnaround = self.turnaround(bus, ids[0])
        bus.allow_lateness(turnaround)
        backend = FeetechBackend(bus, [identify(bus, self._reading_servo(bus, one))[0] for one in ids])
        lost, corrupt = bus.counters.lost, bus.counters.corrupt
        durations: list[float] = []
        began = bus.clock.now_s()
        while bus.clock.now_s() - began < seconds:
            start = bus.clock.now_s()
            backend.read()
            durations.append(bus.clock.now_s() - start)
        ordered = sorted(durations)
        question, block = packets.OVERHEAD + 2 + len(ids), packets.OVERHEAD + reg.CYCLE_BLOCK[1]
        return BusMeasurement(
            servos=len(ids),
            baud=bus.link.baud,
            rate=1.0 / statistics.fmean(durations),
            median=statistics.median(durations),
            p99=ordered[int(0.99 * (len(ordered) - 1))],
            turnaround=turnaround,
            lost_share=(bus.counters.lost - lost) / (len(durations) * len(ids)),
            corrupt=bus.counters.corrupt - corrupt,
            return_delays={},
            latency_timer=latency_timer(bus.link.path),
            wire_time=(question + len(ids) * block) * BITS_PER_BYTE / bus.link.baud,
        )

    # --- helpers ---------------------------------------------------------------------------------------------------

    @staticmethod
    def _ids(bus: FeetechBus) -> Sequence[int]:
        """Return the IDs that answer at the bus' rate."""
        heard = bus.broadcast_ping()
        if not heard:
            return ()
        answers, _ = packets.decode(heard)
        if len(answers) == 1 and len(heard) == packets.OVERHEAD:
            return (answers[0].servo_id,)
        found = []
        for servo_id in _IDS:
            try:
                bus.ping(servo_id)
            except NoReplyError:
                continue
            except CorruptReplyError:
                pass  # several have it
            found.append(servo_id)
        return found

    def _at_other_rates(self, bus: FeetechBus) -> Iterator[tuple[int, Sequence[FoundServo]]]:
        """Yield each other rate at which anybody answers, and who."""
        for baud in self.bauds:
            if baud == bus.link.baud:
                continue
            other = FeetechBus(bus.link.path, baud, bus.link.reply_margin, bus.clock)
            bus.close()
            try:
                other.open()
                found = self.find(other, 0.0)
            finally:
                other.close()
                bus.open()
            if found:
                yield baud, found

    @staticmethod
    def _refuse_taken(bus: FeetechBus, new_id: int) -> None:
        try:
            bus.ping(new_id)
        except NoReplyError:
            return
        except CorruptReplyError:
            pass  # several have it
        raise ConfigurationError(f"expected a free ID, found a servo with ID {new_id} already; choose another")

    @staticmethod
    def _put_unanswered(bus: FeetechBus, servo_id: int, item: reg.FeetechItem, value: int) -> None:
        """Write an item after which the answer may come from another ID, or at another rate."""
        with suppress(NoReplyError, CorruptReplyError):  # what follows finds out
            bus.put(servo_id, item, value)

    @staticmethod
    def _lock(bus: FeetechBus, servo_id: int) -> None:
        """Lock the EPROM; raises WrongDeviceError where it stays open: any write would be for good."""
        bus.put(servo_id, reg.LOCK, 1, attempts=3)
        if bus.get(servo_id, reg.LOCK, attempts=3) != 1 or bus.get(servo_id, reg.ID, attempts=3) != servo_id:
            raise WrongDeviceError(f"ID {servo_id}: expected an EPROM that is locked, found it open; try again")

    def _reading_servo(self, bus: FeetechBus, servo_id: int) -> FeetechServo:
        """Return a configuration that is good for reading."""
        number = self.model_number(bus, servo_id)
        model = next((model for model in MODELS.values() if model.number == number), None)
        if model is None:
            name = MODEL_NAMES.get(number, "an unknown one")
            raise ConfigurationError(f"ID {servo_id}: expected a model of {sorted(MODELS)}, found {name} ({number})")
        spool = Spool(0.01, 1)
        return FeetechServo(
            f"ID {servo_id}", servo_id, model, spool, torque_of(model, spool), winding_of(model), _HARD_N, _SPEED_M_S
        )


def make_setup() -> FeetechSetup:
    """Return the set-up."""
    return FeetechSetup()


def _listed(found: Iterable[FoundServo]) -> str:
    return ", ".join(str(one.servo_id) for one in found)
