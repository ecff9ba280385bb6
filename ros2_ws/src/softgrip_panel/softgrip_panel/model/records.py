# SPDX-License-Identifier: Apache-2.0
"""Rows of the pages Grasps and Finger records: filtered, and the panel's own sight joined with the cell's database."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date

from softgrip_panel.model.facts import CountedView, FingerRecordView
from softgrip_panel.model.grasps import GraspRecord


@dataclass(frozen=True)
class GraspRow:
    """One grasp in the list.

    Attributes:
        number: of what the panel saw of it; None where it saw nothing.
        counted: what the database knows of it; None where the panel saw it itself.
    """

    number: int | None
    at_s: float
    product: str
    finger_set: str
    serials: tuple[str, ...]
    outcome: str
    reason: str
    duration_s: float
    counted: CountedView | None = None


@dataclass(frozen=True)
class GraspFilter:
    """What to list; empty = everything."""

    product: str = ""
    serial: str = ""
    outcome: str = ""

    def admits(self, row: GraspRow) -> bool:
        """Whether a row is listed."""
        return (
            self.product.lower() in row.product.lower()
            and (not self.serial or any(self.serial.lower() in serial.lower() for serial in row.serials))
            and self.outcome in {"", row.outcome}
        )


def grasp_rows(seen: Sequence[GraspRecord], counted: Sequence[CountedView]) -> list[GraspRow]:
    """Return all grasps, newest first: those that the panel saw, then those that only the database knows.

    A cell may live in a time of its own, so grasps are matched by their order, product and outcome, not by the clock.

    Args:
        seen: newest first.
        counted: newest first.
    """
    known = {record.counted.key for record in seen if record.counted is not None}
    left = [one for one in counted if one.key not in known]
    rows = [
        GraspRow(
            one.number, one.started_s, one.product, one.finger_set, one.serials, one.outcome, one.reason, one.duration_s
        )
        for one in seen
    ]
    for row, record in zip(rows, seen, strict=True):
        if record.counted is not None:
            continue
        match = next(
            (k for k, one in enumerate(left) if (one.product, one.outcome) == (row.product, row.outcome)), None
        )
        if match is not None:
            del left[match]
    rows += [
        GraspRow(None, one.at_s, one.product, one.finger_set, one.serials, one.outcome, one.reason, one.duration_s, one)
        for one in left
    ]
    return rows


def life_share(record: FingerRecordView) -> float:
    """Return how much of a finger's life is used [0..1]."""
    return min(1.0, record.cycles / record.cycle_limit) if record.cycle_limit else 1.0


def check_age_days(record: FingerRecordView, today: date) -> int | None:
    """Return how many days ago the last passed check was; None before the first."""
    try:
        return (today - date.fromisoformat(record.calibrated)).days
    except ValueError:
        return None


def export_csv(rows: Iterable[GraspRow]) -> str:
    """Return grasps as CSV; a cell that a spreadsheet would take for a formula gets an apostrophe before it."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(["number", "at_s", "product", "finger_set", "serials", "outcome", "duration_s", "reason"])
    for row in rows:
        values = [
            "" if row.number is None else row.number,
            f"{row.at_s:.3f}",
            row.product,
            row.finger_set,
            " ".join(row.serials),
            row.outcome,
            f"{row.duration_s:.3f}",
            row.reason,
        ]
        writer.writerow([_plain_cell(value) for value in values])
    return out.getvalue()


def _plain_cell(value: object) -> str:
    text = str(value)
    return f"'{text}" if text[:1] in {"=", "+", "-", "@", "\t", "\r"} else text
