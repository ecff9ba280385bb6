# SPDX-License-Identifier: Apache-2.0
"""The homed zero of each tendon on disk: bound to its servo and spool, checksummed, replaced as a whole.

A zero is worth nothing once the servo has restarted (its turn count is volatile), so each homing leaves a mark 1..15 in
the servo's volatile memory and the same mark here; only where both agree does the zero still hold.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from softgrip_driver.errors import ConfigurationError
from softgrip_model.durable import write_durably

SCHEMA = 1
MARKS = 15


@dataclass(frozen=True)
class StoredZero:
    """One tendon's zero.

    Attributes:
        device: identity of the drive it belongs to (DriveIdentity.device).
        spool_radius: [m]; direction: +1 or -1. Another spool makes the zero void.
        position: [m] of the zero in the device's frame.
        mark: session mark in the device's volatile memory.
        homed_at: UTC, ISO 8601.
        homings: how often this tendon was homed; the mark follows from it.
    """

    device: str
    spool_radius: float
    direction: int
    position: float
    mark: int
    homed_at: str
    homings: int


class ZeroStore:
    """The file.

    Args:
        path: YAML file; None keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def load(self) -> dict[str, StoredZero]:
        """Return the stored zeros by tendon; empty when there is no file.

        Raises:
            ConfigurationError: the file is damaged, edited by hand, or of another schema.
        """
        if self._path is None or not self._path.exists():
            return {}
        try:
            document = yaml.safe_load(self._path.read_text(encoding="utf-8"))
            body = {"schema": document["schema"], "zeros": document["zeros"]}
            if document["schema"] != SCHEMA:
                raise ConfigurationError(
                    f"{self._path}: expected schema {SCHEMA}, found {document['schema']}; delete it and home again"
                )
            if document["sha256"] != _digest(body):
                raise ConfigurationError(
                    f"{self._path}: checksum does not match its content; delete the file and home again"
                )
            return {name: StoredZero(**row) for name, row in body["zeros"].items()}
        except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError, UnicodeDecodeError) as error:
            raise ConfigurationError(
                f"{self._path}: expected stored zeros (schema {SCHEMA}), found something unreadable: {error!r}; "
                "delete the file and home again"
            ) from error

    def save(self, zeros: Mapping[str, StoredZero]) -> None:
        """Replace the file: the old one stays whole until the new one is on disk.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        if self._path is None:
            return
        body = {"schema": SCHEMA, "zeros": {name: asdict(zero) for name, zero in sorted(zeros.items())}}
        text = "# Written by tendon_driver; bound to servo and spool. Home again instead of editing.\n"
        text += yaml.safe_dump({**body, "sha256": _digest(body)}, sort_keys=False)
        try:
            write_durably(self._path, text.encode())
        except OSError as error:
            raise ConfigurationError(f"{self._path}: expected a writable file, found: {error}") from error


def next_mark(homings: int) -> int:
    """Return the session mark of the n-th homing, 1 .. 15 in turn."""
    return homings % MARKS + 1


def _digest(body: Mapping[str, object]) -> str:
    return hashlib.sha256(yaml.safe_dump(body, sort_keys=True).encode()).hexdigest()
