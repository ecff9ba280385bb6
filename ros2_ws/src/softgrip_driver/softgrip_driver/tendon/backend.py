# SPDX-License-Identifier: Apache-2.0
"""The verbs of a tendon drive's device. Units end here: above it lengths are metres of tendon and forces newtons.

A backend serves all drives on one port. It is driven by one thread (loop.py); no verb blocks longer than it says.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol


@dataclass
class Counters:
    """What a port has seen since its backend was made.

    Attributes:
        transactions: questions and orders; lost: replies that did not come, lost_by_id: by device; corrupt: damaged
            ones; refused: orders that a device did not take; reopened: how often the port came back.
    """

    transactions: int = 0
    lost: int = 0
    corrupt: int = 0
    refused: int = 0
    reopened: int = 0
    lost_by_id: dict[int, int] = field(default_factory=dict)


@dataclass(frozen=True)
class DriveIdentity:
    """Who pulls a tendon, as far as the device can tell.

    Attributes:
        tendon: name of the tendon.
        device: what a stored zero is bound to, e.g. "XL330-M288/1200 id 1 fw 52".
        warnings: what a person should know of it, in words, e.g. a low battery.
    """

    tendon: str
    device: str
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class DriveReading:
    """What a device said about one drive.

    Attributes:
        time: [s] monotonic clock, when the answer came.
        position: [m] of tendon wound in, + pulls, from the device's own origin (not from the homed zero).
        velocity: [m/s] + pulls.
        tension, tension_stddev: [N] estimate, never negative, and its uncertainty.
        pull: [N] the same estimate with its sign; below zero the friction of the gears is over-estimated.
        current: [A] + pulls; NaN where the device has none.
        temperature: [degC]; voltage: [V]; NaN until read once.
        powered: the device holds or moves the tendon; None until known.
        session_mark: number that the driver left in the device's volatile memory; another one means that the device
            restarted and lost its turn count. None until known.
        faults: names of the fault table that the device itself reports.
        fault_detail: what it said, in words; empty where the raw error bits tell all.
        hardware_error: raw error bits.
        load: share of its stall torque that the motor exerts, so that the drive backs off before a servo's own overload
            shutdown; NaN where that share is not what sets one off, or is not known.
        is_gauged: the tension is what a gauge in the tendon reads, no estimate from the motor: nothing else passes for
            it, but the gauge's cable may be cut.
    """

    time: float
    position: float
    velocity: float
    tension: float
    tension_stddev: float
    pull: float
    current: float = math.nan
    temperature: float = math.nan
    voltage: float = math.nan
    powered: bool | None = None
    session_mark: int | None = None
    faults: tuple[str, ...] = ()
    fault_detail: str = ""
    hardware_error: int = 0
    load: float = math.nan
    is_gauged: bool = False


@dataclass(frozen=True)
class Setpoint:
    """What a drive shall do now.

    Attributes:
        position: [m] in the device's frame; None = keep what it has.
        tension_limit: [N] that the device itself must not exceed.
    """

    position: float | None
    tension_limit: float


class TendonBackend(Protocol):
    """Device side of the tendon drives on one port."""

    @property
    def tendons(self) -> Sequence[str]:
        """Names of the tendons, in order."""

    @property
    def counters(self) -> Counters:
        """What the port has seen."""

    def connect(self, *, keep_torque: bool = False) -> Sequence[DriveIdentity]:
        """Open the port, identify every device, check and set it up. Nothing moves afterwards.

        Nothing holds either, unless ``keep_torque`` is set: then a device that is found holding, with the very settings
        it would be given, goes on holding. Raises DriverError with what was expected, found and what to do. May take
        seconds.
        """

    def is_powered(self, tendon: str) -> bool:
        """Whether a device was left holding by `connect`."""

    def goal_position(self, tendon: str) -> float:
        """Return the goal [m, device frame] of a device that was left holding; NaN where there is none."""

    def disconnect(self, *, keep_torque: bool = False) -> None:
        """Let go of every device, unless ``keep_torque`` is set, and close the port. Never raises."""

    def reconnect(self) -> bool:
        """Try once to reopen a port that went away; return whether it is open. Does not raise; takes milliseconds."""

    def restore(self, tendon: str) -> Iterator[None]:
        """Reboot one device where it has cut itself off and set it up again, one short transaction a step."""

    def read(self) -> Mapping[str, DriveReading]:
        """Return a reading of every drive that answered. Raises PortLostError. Blocks less than one reply time-out."""

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Send setpoints to the drives. Raises PortLostError."""

    def power(self, tendon: str, on: bool) -> None:
        """Let one drive hold its present position, or let go of the tendon."""

    def mark_session(self, tendon: str, mark: int) -> None:
        """Leave a number 1..15 in the device's volatile memory; 0 takes it away."""
