# SPDX-License-Identifier: Apache-2.0
"""From a table of plain values (the node's parameters, or a command's options) to checked settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from softgrip_driver.drives import DriveRequest, DriveSet, configure_drives, per_tendon
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.gripper import Block, GripperController, Policies, StopPolicy, never_blocked
from softgrip_driver.tendon.limits import LIMIT_PARAMETERS, TendonLimits
from softgrip_driver.tendon.rest import rest_stride
from softgrip_driver.tendon.safety_store import port_file
from softgrip_driver.tendon.units import Spool


@dataclass(frozen=True)
class DriverConfiguration:
    """Everything the tendon driver needs to know.

    Attributes:
        port: of the bus, or of the stage.
        drives: what pulls.
        spools: by tendon.
        limits: by tendon.
        grippers: by tendon, the gripper it belongs to.
        policies: of the whole gripper.
        loop_rate: [Hz]
        rest_stride: periods of the loop between two cycles while the drives rest.
        zero_file: None keeps no zeros.
        safety_file: the emergency stop and the lock on disk.
    """

    port: str
    drives: DriveSet
    spools: Mapping[str, Spool]
    limits: Mapping[str, TendonLimits]
    grippers: Mapping[str, str]
    policies: Policies
    loop_rate: float
    rest_stride: int
    zero_file: Path | None
    safety_file: Path

    def controller(self, block: Callable[[], Block | None] = never_blocked) -> GripperController:
        """Return the controller, knowing nothing yet; ``block`` says whether anything may move."""
        return GripperController(self.limits, self.policies, self.grippers, 1.0 / self.loop_rate, block)


def checked_configuration(values: Mapping[str, Any]) -> DriverConfiguration:
    """Return the configuration that a table of values describes.

    Args:
        values: parameter name to value; lists of per-tendon values have one element for each tendon, or one for all.

    Raises:
        ConfigurationError: values that contradict each other.
    """
    tendons = tuple(values["tendons"])
    if not tendons or not all(tendons) or len(set(tendons)) != len(tendons):
        raise ConfigurationError(f"parameter tendons: expected names that differ, found {list(tendons)}")
    spools = [
        Spool(radius, direction)
        for radius, direction in zip(
            per_tendon(values, "spool_radii_m", tendons), per_tendon(values, "directions", tendons), strict=True
        )
    ]
    policies = Policies(
        estop=StopPolicy[values["estop_policy"].upper()],
        unclean_end=StopPolicy[values["unclean_end_policy"].upper()],
        command_timeout=values["command_timeout_s"],
        release_after=values["release_after_s"],
        stream_timeout=values["stream_timeout_s"],
        lease_max=values["lease_max_s"],
        continuous_tension=values["continuous_tension_n"],
    )
    request = DriveRequest(
        values["backend"],
        tendons,
        dict(zip(tendons, spools, strict=True)),
        dict.fromkeys(tendons, _limits(values)),
        policies.unclean_end is StopPolicy.HOLD,
        values,
    )
    return DriverConfiguration(
        port=values["port"],
        drives=configure_drives(request),
        spools=request.spools,
        limits=request.limits,
        grippers=dict(zip(tendons, per_tendon(values, "grippers", tendons), strict=True)),
        policies=policies,
        loop_rate=values["loop_rate"],
        rest_stride=rest_stride(values["loop_rate"], values["rest_rate"], values["bus_watchdog_s"]),
        zero_file=Path(values["zero_file"]).expanduser() if values["zero_file"] else None,
        safety_file=_safety_file(values),
    )


def _safety_file(values: Mapping[str, Any]) -> Path:
    """Return where emergency stop and lock are kept: as given, else one file for each port in the user's ROS folder.

    There is no way to keep them nowhere: a stop that a restart forgets is none.
    """
    if values["safety_file"]:
        return Path(values["safety_file"]).expanduser()
    return port_file(values["port"])


def _limits(values: Mapping[str, Any]) -> TendonLimits:
    return TendonLimits(**{field.name: values[LIMIT_PARAMETERS[field.name]] for field in fields(TendonLimits)})
