# SPDX-License-Identifier: Apache-2.0
"""What may pull the tendons: backends by name, those of this package and any that an installed package registers.

A package registers one in the entry point group `softgrip.drives`: a name, and a function from a `DriveRequest` to a
`DriveSet` (docs/how-to/write-a-backend.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, TypeVar

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_time import Clock

#: entry point group
GROUP = "softgrip.drives"
#: those of this package, by name; written here, so that they are there also where it runs from its sources
SHIPPED = {
    "damiao": "softgrip_driver.damiao.drive_set:configure",
    "dynamixel": "softgrip_driver.dynamixel.drive_set:configure",
    "feetech": "softgrip_driver.feetech.drive_set:configure",
    "grbl": "softgrip_driver.stage.drive_set:configure",
    "mark10": "softgrip_driver.stage.drive_set:configure",
}

Model = TypeVar("Model")

#: is told in words what a backend is about to change in a device for good, or what a person should know
Report = Callable[[str], object]


@dataclass(frozen=True)
class DriveRequest:
    """What the parameters ask of a backend.

    Attributes:
        kind: name of the backend.
        tendons: names, in order.
        spools, limits: by tendon.
        keeps_hold: a hold has to outlive the driver's process.
        values: every parameter of tendon_driver by name.
    """

    kind: str
    tendons: tuple[str, ...]
    spools: Mapping[str, Spool]
    limits: Mapping[str, TendonLimits]
    keeps_hold: bool
    values: Mapping[str, Any]

    def own(self, name: str, tendon: str) -> Any:
        """Return a tendon's value of a parameter that has one for each tendon, or one for all."""
        return per_tendon(self.values, name, self.tendons)[self.tendons.index(tendon)]

    def device_ids(self) -> list[int]:
        """Return the ID of each tendon's device, in their order; raises ConfigurationError for one that is twice."""
        ids = per_tendon(self.values, "servo_ids", self.tendons)
        if len(set(ids)) != len(ids):
            raise ConfigurationError(f"parameter servo_ids: expected each ID once, found {ids}")
        return ids

    def model(self, tendon: str, models: Mapping[str, Model]) -> Model:
        """Return the model of a tendon's device out of those that a backend knows; raises ConfigurationError."""
        name = self.own("servo_models", tendon)
        if name not in models:
            raise ConfigurationError(
                f"parameter servo_models: expected names out of {sorted(models)} with backend '{self.kind}', found "
                f"'{name}'"
            )
        return models[name]

    def calibrated_torque(self, tendon: str) -> TorqueModel | None:
        """Return what `calibrate_tension` has found of a tendon's drive, None where it has not been run."""
        per_ampere = self.own("torque_per_ampere_nm_a", tendon)
        if per_ampere <= 0.0:
            return None
        return TorqueModel(
            per_ampere,
            self.own("friction_currents_a", tendon),
            self.own("tension_stddev_share", tendon),
            "calibrated",
            self.own("friction_slopes_a_s_m", tendon),
            self.own("gear_load_shares", tendon),
            self.own("quick_stddevs_n_s2_m2", tendon),
        )

    @property
    def options(self) -> dict[str, str]:
        """What `backend_options` says, NAME=VALUE each; raises ConfigurationError for anything else."""
        found = {}
        for text in filter(None, self.values["backend_options"]):
            name, separator, value = text.partition("=")
            if not separator or not name:
                raise ConfigurationError(f"parameter backend_options: expected NAME=VALUE, found '{text}'")
            found[name.strip()] = value.strip()
        return found


class DriveSet(Protocol):
    """Checked settings of the drives on one port."""

    def backend(self, report: Report, clock: Clock) -> TendonBackend:
        """Return the backend, not connected; it waits on ``clock``."""


Configure = Callable[[DriveRequest], DriveSet]


def drive_names() -> list[str]:
    """Return the names of all backends that are installed."""
    return sorted(_installed())


def configure_drives(request: DriveRequest) -> DriveSet:
    """Return the checked settings of the backend that a request names.

    Raises:
        ConfigurationError: no such backend, one that cannot be loaded, or values that it refuses.
    """
    installed = _installed()
    if request.kind not in installed:
        close = get_close_matches(request.kind, installed, 1)
        raise ConfigurationError(
            f"parameter backend: expected one of {sorted(installed)}, found '{request.kind}'"
            + (f"; did you mean '{close[0]}'?" if close else "; install the package that brings it")
        )
    return _loaded(installed[request.kind])(request)


def _installed() -> dict[str, EntryPoint]:
    found = {name: EntryPoint(name, value, GROUP) for name, value in SHIPPED.items()}
    for one in entry_points(group=GROUP):
        known = found.setdefault(one.name, one)
        if known.value != one.value:
            raise ConfigurationError(
                f"backend '{one.name}': expected one package to bring it, found {known.value} and {one.value}; "
                "uninstall one, or give it another name"
            )
    return found


def _loaded(entry: EntryPoint) -> Configure:
    try:
        configure: Configure = entry.load()
    except Exception as error:  # a stranger's module may raise anything when it is imported
        raise ConfigurationError(
            f"backend '{entry.name}': expected to load {entry.value}, found {type(error).__name__}: {error}"
        ) from error
    return configure


def per_tendon(values: Mapping[str, Any], name: str, tendons: Sequence[str]) -> list[Any]:
    """Return a value for each tendon; one alone counts for all. Raises ConfigurationError for any other number."""
    found = list(values[name])
    if len(found) == 1:
        return found * len(tendons)
    if len(found) != len(tendons):
        raise ConfigurationError(
            f"parameter {name}: expected one value, or one for each of {list(tendons)}, found {len(found)}: {found}"
        )
    return found
