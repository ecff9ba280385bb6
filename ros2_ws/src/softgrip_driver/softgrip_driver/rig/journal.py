# SPDX-License-Identifier: Apache-2.0
"""The record of a plan on disk: one JSON line per event, written through at once, so that a power cut loses nothing."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from softgrip_driver.errors import JournalError
from softgrip_model.durable import make_folder_durably, sync_folder

SCHEMA = 1
_SUFFIX = ".jsonl"


@dataclass(frozen=True)
class Request:
    """What a plan was asked to be; kept so that it can be resumed.

    Attributes:
        plan: name. law: to fit. cable, surface: names.
        cable_radius, surface_radius: [m]. angles: [rad], loads: [kg] of a custom plan.
        activate: make the model active when usable.
    """

    plan: str
    law: str = "matte"
    cable: str = "cable"
    surface: str = "surface"
    cable_radius: float = 0.125e-3
    surface_radius: float = 3e-3
    angles: tuple[float, ...] = ()
    loads: tuple[float, ...] = ()
    activate: bool = True


@dataclass(frozen=True)
class MeasuredPoint:
    """One accepted point: index in the plan, angle [rad], mass [kg], T2 and T1 [N]."""

    index: int
    angle: float
    load: float
    tension_low: float
    tension_high: float


@dataclass
class PlanJournal:
    """One plan's file. Lines: the request, accepted points, withdrawn points, the end."""

    path: Path
    plan_id: str
    request: Request
    points: dict[int, MeasuredPoint] = field(default_factory=dict)
    finished: bool = False

    @classmethod
    def create(cls, folder: Path, plan_id: str, request: Request) -> PlanJournal:
        """Start a new file.

        Raises:
            JournalError: it cannot be written.
        """
        journal = cls(folder / f"{plan_id}{_SUFFIX}", plan_id, request)
        try:
            make_folder_durably(folder)
            if journal.path.exists():
                raise JournalError(f"{journal.path}: expected a new plan, found its record already there")
        except OSError as error:
            raise JournalError(f"{folder}: expected a folder to write to, found {error}") from error
        journal._append({"event": "request", "schema": SCHEMA, "id": plan_id, **asdict(request)})
        return journal

    @classmethod
    def last_broken(cls, folder: Path) -> PlanJournal | None:
        """Return the newest plan that never came to its end, or None."""
        for path in sorted(folder.glob(f"*{_SUFFIX}"), reverse=True):
            journal = cls.read(path)
            if not journal.finished:
                return journal
        return None

    @classmethod
    def read(cls, path: Path) -> PlanJournal:
        """Read a plan's file; a last line that a power cut tore is left out.

        Raises:
            JournalError: unreadable, or damaged before its last line.
        """
        try:
            # What stands after the last line end was torn by a power cut; `_append` cuts it off.
            *lines, _ = path.read_bytes().split(b"\n")
        except OSError as error:
            raise JournalError(f"{path}: cannot be read: {error}") from error
        events = []
        for number, line in enumerate(lines, 1):
            try:
                events.append(json.loads(line))
            except ValueError as error:
                raise JournalError(
                    f"{path}, line {number}: expected JSON, found {line[:40]!r}; repair or remove the file"
                ) from error
        try:
            return cls._replay(path, events)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise JournalError(f"{path}: expected the record of a plan (schema {SCHEMA}), found {error!r}") from error

    def accept(self, point: MeasuredPoint) -> None:
        """Keep a point."""
        self._append({"event": "accepted", **asdict(point)})
        self.points[point.index] = point

    def withdraw(self, index: int, reason: str) -> None:
        """Take a point back, which later ones contradict."""
        self._append({"event": "withdrawn", "index": index, "reason": reason})
        self.points.pop(index, None)

    def finish(self, outcome: str) -> None:
        """Write the end: there is nothing to resume any more."""
        self._append({"event": "finished", "outcome": outcome})
        self.finished = True

    @classmethod
    def _replay(cls, path: Path, events: list[dict[str, Any]]) -> PlanJournal:
        first = dict(events[0])
        if first.pop("event") != "request" or first.pop("schema") != SCHEMA:
            raise ValueError(f"first line {events[0]}")
        plan_id = first.pop("id")
        request = Request(**{**first, "angles": tuple(first["angles"]), "loads": tuple(first["loads"])})
        journal = cls(path, plan_id, request)
        for event in events[1:]:
            kind = event.pop("event")
            if kind == "accepted":
                journal.points[event["index"]] = MeasuredPoint(**event)
            elif kind == "withdrawn":
                journal.points.pop(event["index"], None)
            elif kind == "finished":
                journal.finished = True
            else:
                raise ValueError(f"event '{kind}'")
        return journal

    def _append(self, event: dict[str, object]) -> None:
        try:
            is_new = not self.path.exists()
            whole = 0 if is_new else self.path.read_bytes().rfind(b"\n") + 1
            with self.path.open("ab") as stream:
                stream.truncate(whole)
                stream.write(json.dumps(event).encode() + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
            if is_new:
                sync_folder(self.path.parent)
        except OSError as error:
            raise JournalError(
                f"{self.path}: expected to write, found {error}; free space or check the disk"
            ) from error
