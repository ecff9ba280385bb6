# SPDX-License-Identifier: Apache-2.0
"""The emergency stop and the lock around hands, on disk: what a restarted driver must know before it touches a drive.

The file is read before anything else, and replaced as a whole: the old one stays until the new one is on disk. Whatever
can not be read with certainty counts as stopped.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import yaml

from softgrip_driver.errors import DriverError
from softgrip_model.durable import write_durably

SCHEMA = 1
#: Files of drivers on devices of this computer, which may be one and the same by several names: /dev/ttyUSB0 and
#: /dev/serial/by-id/...
DEVICE_FILES = "tendon_safety-dev-*.yaml"


def port_file(port: str) -> Path:
    """Return where emergency stop and lock of a port's drives or stage are kept, whoever opens it."""
    home = Path(os.environ.get("ROS_HOME") or "~/.ros").expanduser()
    name = "".join(character if character.isalnum() else "-" for character in port).strip("-")
    return home / "softgrip" / f"tendon_safety-{name}.yaml"


class StopCause(StrEnum):
    """Why the emergency stop is latched."""

    NONE = ""
    REQUESTED = "requested"
    #: the process before ended without letting go of its drives: killed, crashed, or without power
    UNCLEAN_END = "unclean_end"
    #: the driver stood still for so long that a stop may have been lost
    STANDSTILL = "standstill"
    #: nobody knows what the file said
    UNREADABLE = "unreadable"


class SafetyStoreError(DriverError):
    """The state could not be put on disk; it holds in memory all the same."""


@dataclass(frozen=True)
class SafetyRecord:
    """What keeps the drives from moving.

    Attributes:
        sequence: counts changes, kept over restarts.
        changed_at: UTC, ISO 8601.
        cause: why the emergency stop is latched; NONE = it is not.
        stop_reason: who or what stopped, in words.
        lock_owner, lock_reason: who has hands in the cell and what for; empty without a lock.
        lock_digest: SHA-256 of the lock's token; empty without a lock.
        is_armed: torque may be on; a process that finds this at its start follows one that ended uncleanly.
    """

    sequence: int = 0
    changed_at: str = ""
    cause: StopCause = StopCause.NONE
    stop_reason: str = ""
    lock_owner: str = ""
    lock_reason: str = ""
    lock_digest: str = ""
    is_armed: bool = False

    @property
    def is_stopped(self) -> bool:
        """Whether the emergency stop is latched."""
        return self.cause is not StopCause.NONE

    @property
    def is_locked(self) -> bool:
        """Whether hands are in the cell."""
        return bool(self.lock_digest)

    @property
    def is_blocked(self) -> bool:
        """Whether the emergency stop or a lock keeps the drives from moving."""
        return self.is_stopped or self.is_locked

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing keeps the drives from moving, and nobody has torque on."""
        return not (self.is_blocked or self.is_armed)


class SafetyStore:
    """The file.

    Args:
        path: YAML file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self) -> SafetyRecord:
        """Return what is on disk; a cell that never ran has nothing there and is not stopped.

        A device without a file is stopped where the driver of another one is not at rest: it may be that one by another
        name. A file that can not be read, was edited, or is of another schema gives a latched stop, too. The cause is
        UNREADABLE then.
        """
        try:
            text = self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return self._load_first()
        except (OSError, UnicodeDecodeError) as error:
            return self._unreadable(str(error))
        try:
            document = yaml.safe_load(text)
            body = document["safety"]
            if document["schema"] != SCHEMA or document["sha256"] != _digest(body):
                return self._unreadable("schema or checksum differ")
            return _record_of(body)
        except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
            return self._unreadable(repr(error))

    def _load_first(self) -> SafetyRecord:
        """Return the state of a port that has no file yet."""
        if not self.path.match(DEVICE_FILES):
            return SafetyRecord()
        others = [SafetyStore(path) for path in sorted(self.path.parent.glob(DEVICE_FILES))]
        restless = [other.path for other in others if not other.load().is_at_rest]
        if not restless:
            return SafetyRecord()
        return _stopped(
            f"{self.path}: none there yet, and {restless[0]} says that a driver is stopped, locked or ended without "
            "letting go: it may be this one by another name of its port"
        )

    def save(self, record: SafetyRecord) -> None:
        """Replace the file; file and folder are on disk when this returns.

        Raises:
            SafetyStoreError: it could not be written.
        """
        body = {**asdict(record), "cause": record.cause.value}
        text = "# Written by tendon_driver: emergency stop and lock. Call estop_reset or tendon/unlock, do not edit.\n"
        text += yaml.safe_dump({"schema": SCHEMA, "safety": body, "sha256": _digest(body)}, sort_keys=False)
        try:
            write_durably(self.path, text.encode())
        except OSError as error:
            raise SafetyStoreError(f"{self.path}: expected a writable file, found: {error}") from error

    def _unreadable(self, found: str) -> SafetyRecord:
        return _stopped(f"{self.path}: expected the safety state (schema {SCHEMA}), found none readable: {found}")


def _stopped(reason: str) -> SafetyRecord:
    return SafetyRecord(cause=StopCause.UNREADABLE, stop_reason=reason)


def token_digest(token: str) -> str:
    """Return what is kept of a lock's token: its SHA-256, in hex."""
    return hashlib.sha256(token.encode()).hexdigest()


def _record_of(body: Mapping[str, Any]) -> SafetyRecord:
    kinds = {field.name: type(getattr(SafetyRecord(), field.name)) for field in fields(SafetyRecord)}
    if set(body) != set(kinds):
        raise ValueError(f"expected the keys {sorted(kinds)}, found {sorted(body)}")
    values = {**body, "cause": StopCause(body["cause"])}
    wrong = [name for name, kind in kinds.items() if type(values[name]) is not kind]
    if wrong:
        raise ValueError(f"keys of another type: {wrong}")
    return SafetyRecord(**values)


def _digest(body: Mapping[str, object]) -> str:
    return hashlib.sha256(yaml.safe_dump(body, sort_keys=True).encode()).hexdigest()


def check_port_is_free_to_move(port: str) -> None:
    """For who moves the drives of a port without the driver.

    Raises:
        SafetyStoreError: the driver of this port is stopped, locked, at work, or ended without letting go.
    """
    store = SafetyStore(port_file(port))
    record = store.load()
    if record.is_at_rest:
        return
    found = "an emergency stop" if record.is_stopped else "hands in the cell" if record.is_locked else "torque on"
    why = record.stop_reason or record.lock_reason or "a driver that works, or ended without letting go"
    raise SafetyStoreError(
        f"{port}: expected drives that nothing keeps from moving, found {found} ({why}; {store.path}); start the "
        "node that drives it and call estop_reset (a rig: rig/stop_reset) or tendon/unlock, then end it with Ctrl-C"
    )
