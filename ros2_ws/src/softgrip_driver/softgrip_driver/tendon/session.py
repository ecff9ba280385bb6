# SPDX-License-Identifier: Apache-2.0
"""Zeros across restarts of the driver: recalled where the device has provably not restarted, kept after homing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from softgrip_driver.tendon.backend import DriveIdentity
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.units import Spool
from softgrip_driver.tendon.zero_store import StoredZero, ZeroStore, next_mark


@dataclass(frozen=True)
class Recalled:
    """What became of a stored zero.

    Attributes:
        tendon: name.
        valid: the zero holds; otherwise the tendon must be homed.
        reason: in words.
    """

    tendon: str
    valid: bool
    reason: str


class ZeroKeeper:
    """Keeps the zeros of a gripper.

    Args:
        store: the file.
        identities: of the connected devices.
        spools: by tendon; another spool voids a zero.
    """

    def __init__(self, store: ZeroStore, identities: Sequence[DriveIdentity], spools: Mapping[str, Spool]) -> None:
        self._store = store
        self._devices = {identity.tendon: identity.device for identity in identities}
        self._spools = dict(spools)
        self._zeros: dict[str, StoredZero] = {}

    def recall(self, loop: BusLoop) -> list[Recalled]:
        """Give the drives their stored zeros, as far as these still hold.

        Raises:
            ConfigurationError: the file is damaged.
        """
        self._zeros = self._store.load()
        marks = loop.call(lambda controller, _: {n: drive.session_mark for n, drive in controller.drives.items()})
        results = []
        for tendon, device in self._devices.items():
            zero = self._zeros.get(tendon)
            reason = self._objection(tendon, device, zero, marks[tendon])
            if zero is not None and not reason:
                _set_zero(loop, tendon, zero.position, zero.mark)
            results.append(Recalled(tendon, not reason, reason or "zero of the last homing holds"))
        return results

    def save_zeros(self, loop: BusLoop, homed_at: str) -> None:
        """Mark the devices of all homed drives and write their zeros.

        Raises:
            ConfigurationError: the file cannot be written.
            DriverError: a device did not take the mark.
        """
        zeros = loop.call(lambda controller, _: {n: drive.zero for n, drive in controller.drives.items()})
        for tendon, position in zeros.items():
            before = self._zeros.get(tendon)
            if position is None or (before is not None and before.position == position):
                continue
            homings = 0 if before is None else before.homings + 1
            mark = next_mark(homings)
            loop.mark_session(tendon, mark)
            _set_zero(loop, tendon, position, mark)
            spool = self._spools[tendon]
            self._zeros[tendon] = StoredZero(
                self._devices[tendon], spool.radius, spool.direction, position, mark, homed_at, homings
            )
        self._store.save(self._zeros)

    def _objection(self, tendon: str, device: str, zero: StoredZero | None, mark: int | None) -> str:
        """Return why a stored zero does not hold, empty when it does."""
        spool = self._spools[tendon]
        if zero is None:
            return "never homed"
        if zero.device != device:
            return f"expected {zero.device}, found {device}"
        if (zero.spool_radius, zero.direction) != (spool.radius, spool.direction):
            return "the spool is another one"
        if mark != zero.mark:
            return f"the device has restarted since it was homed at {zero.homed_at}: its turns are lost"
        return ""


def _set_zero(loop: BusLoop, tendon: str, position: float, mark: int) -> None:
    loop.call(lambda controller, _: controller.drives[tendon].set_zero(position, mark))
