# SPDX-License-Identifier: Apache-2.0
"""What a rig is made of, as verbs: a stage that pulls the cable and a gauge that feels it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class DeviceIdentity:
    """What a device says it is.

    Attributes:
        model: kind of device. serial: as far as it tells. warnings: what is not well but lets it work.
    """

    model: str
    serial: str = ""
    warnings: tuple[str, ...] = ()


class Stage(Protocol):
    """Pulls the cable. Travel [m] is zero where `zero` was called and grows while pulling.

    Every method raises NoReplyError when the device is silent, CorruptReplyError when it answers nonsense, RefusedError
    when it will not, NotReadyError when it will in a moment, PortLostError when the port is gone.
    """

    def open(self) -> DeviceIdentity:
        """Connect, identify, stand still."""
        ...

    def zero(self) -> None:
        """Make this the zero of travel."""
        ...

    def start(self, target: float, speed: float) -> None:
        """Begin to move to a travel [m] at a speed [m/s]; the stage stops there by itself."""
        ...

    def travel(self) -> float:
        """Where the stage is [m]."""
        ...

    def stop(self) -> None:
        """Stand still now. Safe at any time."""
        ...

    def unlock(self) -> None:
        """Leave an alarm, when a person has said so; the position is not known afterwards."""
        ...

    def close(self) -> None:
        """Stop and disconnect. Never raises."""
        ...


class Gauge(Protocol):
    """Feels the cable's tension [N], never negative but for noise. Raises as `Stage` does."""

    def open(self) -> DeviceIdentity:
        """Connect, identify, set to newtons and present force."""
        ...

    def tare(self) -> None:
        """Make the present force zero."""
        ...

    def tension(self) -> float:
        """Tension now [N].

        Raises:
            SaturatedError: beyond the end of its range.
            UnitChangedError: it reads in another unit than it was set to.
        """
        ...

    def restore(self) -> None:
        """Set it up again, after somebody touched it."""
        ...

    def close(self) -> None:
        """Leave it as it was found and disconnect. Never raises."""
        ...
