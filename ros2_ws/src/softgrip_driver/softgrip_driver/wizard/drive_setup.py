# SPDX-License-Identifier: Apache-2.0
"""How drives of one make are led from their boxes to a chain: what wizard, `first_run`, `scan` and `setup` ask for.

A package that brings a backend (softgrip_driver.drives) may bring its set-up, too: it registers a function without
arguments that returns a `DriveSetup`, under the backend's name, in the entry point group `softgrip.drive_setups`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, TypeAlias

from softgrip_driver.drives import drive_names
from softgrip_driver.errors import ConfigurationError, NoSetupError
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.needs import TendonNeeds
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_time import Clock

#: entry point group
GROUP = "softgrip.drive_setups"
#: those of this package, by the name of their backend
SHIPPED = {
    "damiao": "softgrip_driver.wizard.setups.damiao:make_setup",
    "dynamixel": "softgrip_driver.wizard.setups.dynamixel:make_setup",
    "feetech": "softgrip_driver.wizard.setups.feetech:make_setup",
}
DEFAULT_DRIVE = "dynamixel"


@dataclass(frozen=True)
class FoundServo:
    """A servo that answered.

    Attributes:
        port, baud, servo_id: where.
        number: of its model. name: of its model, "unknown" where the number is.
        firmware: version.
        error: what it says is wrong with it; None = it did not say.
        is_shared: several servos seem to answer to this ID.
    """

    port: str
    baud: int
    servo_id: int
    number: int
    name: str
    firmware: str
    error: IntFlag | None
    is_shared: bool


@dataclass(frozen=True)
class ServoHealth:
    """Supply [V], temperature [degC] and error bits of one servo."""

    voltage_v: float
    temperature_degc: float
    error: IntFlag


@dataclass(frozen=True)
class BusMeasurement:
    """What was measured.

    Attributes:
        servos: how many answer.
        baud: [1/s]
        rate: [Hz] of cycles one after the other.
        median, p99: [s] of one cycle.
        turnaround: [s] that a reply takes beyond its bytes.
        lost_share: share of the answers that did not come.
        corrupt: damaged packets.
        return_delays: [s] by ID, of servos that have such a setting.
        latency_timer: [s] of the USB adapter; None where it has none.
        wire_time: [s] that the bytes of a cycle alone need.
    """

    servos: int
    baud: int
    rate: float
    median: float
    p99: float
    turnaround: float
    lost_share: float
    corrupt: int
    return_delays: Mapping[int, float]
    latency_timer: float | None
    wire_time: float = 0.0


class SetupModel(Protocol):
    """What set-up needs to know of a model."""

    @property
    def name(self) -> str:
        """Return its name."""

    @property
    def number(self) -> int:
        """Return the number by which it says who it is."""

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Return the supply [V] that it takes."""

    @property
    def temperature_limit(self) -> float:
        """Return the temperature [degC] at which it lets go."""

    @property
    def needs(self) -> TendonNeeds:
        """Return what it asks of the limits."""


#: a bus of a set-up's own kind: it has a clock, open() and close()
SetupBus: TypeAlias = Any


class SetupBackend(TendonBackend, Protocol):
    """A backend whose bus the wizard steps itself."""

    bus: SetupBus


@dataclass(frozen=True)
class ChainRow:
    """One servo of a chain, for a backend."""

    tendon: str
    servo_id: int
    model: Any
    spool: Spool
    limits: TendonLimits


class DriveSetup(Protocol):
    """Drives of one make. Buses are those of its own `make_bus`."""

    #: of the backend
    name: str
    #: [1/s] that drives may be set to, in the order in which they are looked for: as they come first
    bauds: Sequence[int]
    #: ID and [1/s] as they come
    factory: tuple[int, int]
    #: models that a tendon may hang on, and names of all numbers that are known
    models: Mapping[str, SetupModel]
    model_names: Mapping[int, str]
    #: what to do where nobody answers, and where several do to one ID
    supply_remedy: str
    shared_id_remedy: str

    def make_bus(self, port: str, baud: int, reply_margin_s: float, clock: Clock | None) -> SetupBus:
        """Return a bus, not open."""

    def find(self, bus: SetupBus, wait_s: float) -> Sequence[FoundServo]:
        """Return every servo that answers at the bus' rate, by ID; raises PortLostError."""

    def model_number(self, bus: SetupBus, servo_id: int) -> int:
        """Return the number of a servo's model; raises DriverError."""

    def is_shared(self, bus: SetupBus, servo_id: int) -> bool:
        """Return whether several servos answer to an ID."""

    def assign(self, bus: SetupBus, servo_id: int, new_id: int | None, new_baud: int | None) -> Sequence[str]:
        """Give a servo its ID and rate for good, verify both, and say what was done; raises DriverError."""

    def health(self, bus: SetupBus, servo_id: int) -> ServoHealth:
        """Return how a servo is; raises DriverError."""

    def error_causes(self, error: IntFlag, model: SetupModel) -> Sequence[str]:
        """Return what to remove before an error is ended."""

    def reset_remedy(self, port: str, baud: int, servo_id: int) -> str:
        """Return what ends an error whose cause is gone."""

    def turnaround(self, bus: SetupBus, servo_id: int) -> float:
        """Return how long [s] replies take beyond the time of their bytes; raises DriverError."""

    def who_answers(self, bus: SetupBus) -> str:
        """Return in words who answers, at this rate or at another one, and what to do about it."""

    def torque_of_data_sheet(self, model: Any, spool: Spool) -> TorqueModel:
        """Return what the data sheet says of tensions."""

    def required_parameters(self, servos: Sequence[tuple[Any, float]]) -> dict[str, float | int]:
        """Return the driver's parameters that (model, spool radius [m]) ask for beyond what is shipped."""

    def make_backend(
        self,
        bus: SetupBus,
        rows: Sequence[ChainRow],
        parameters: Mapping[str, float | int],
        report: Callable[[str], object],
    ) -> SetupBackend:
        """Return the backend of some servos, not connected."""

    def measure(self, bus: SetupBus, seconds: float) -> BusMeasurement:
        """Run the driver's cycles as fast as can be, without its orders; raises DriverError."""


def drive_setup(name: str | None) -> DriveSetup:
    """Return the set-up of a backend's drives; None = Dynamixel.

    Raises:
        NoSetupError: there is none; says how its drives get their IDs instead.
        ConfigurationError: it cannot be loaded.
    """
    name = name or DEFAULT_DRIVE
    found = {one: EntryPoint(one, value, GROUP) for one, value in SHIPPED.items()}
    found |= {one.name: one for one in entry_points(group=GROUP) if one.name not in found}
    if name not in found:
        known = f"a backend of {drive_names()} with a set-up of its own"
        raise NoSetupError(
            f"drive: expected {known} ({', '.join(sorted(found))}), found '{name}'; write its chain into the cell file "
            "by hand (docs/cell_file.md)"
        )
    try:
        make: Callable[[], DriveSetup] = found[name].load()
    except Exception as error:  # a stranger's module may raise anything when it is imported
        raise ConfigurationError(
            f"drive '{name}': expected to load {found[name].value}, found {type(error).__name__}: {error}"
        ) from error
    return make()


def setup_names() -> list[str]:
    """Return the names of all backends that have a set-up, those included that only say how it is done."""
    return sorted({*SHIPPED, *(one.name for one in entry_points(group=GROUP))})
