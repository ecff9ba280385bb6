# SPDX-License-Identifier: Apache-2.0
"""Grasps as the panel saw them: verdict, reason, tensions over time with the sample that decided, pictures."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from softgrip_panel.model.facts import CellView, CountedView, FingerDecision, TensionView

#: So many grasps are kept with their curves, and so many with their pictures, a hundred kilobytes each.
MAX_GRASPS, MAX_PICTURED = 200, 50
#: The picture after a verdict is the last one within this time; the next grasp may begin before [s].
AFTER_S = 1.0
#: A grasp is counted so long after its last sample at most [s].
COUNTED_WITHIN_S = 10.0
#: A curve holds so many samples; the panel takes ten a second.
MAX_SAMPLES = 600


@dataclass(frozen=True)
class GraspSample:
    """Tensions at a moment, in newtons by tendon, measured and free.

    Attributes:
        at_s: since the grasp began, by the panel's clock [s].
        stamp_s: of the tendon/state, by the cell's clock [s]; NaN = not known.
    """

    at_s: float
    tension_n: tuple[float, ...]
    free_tension_n: tuple[float, ...]
    stamp_s: float = math.nan


@dataclass
class GraspRecord:
    """One grasp; times in seconds since the Unix epoch, but for `decided_s`.

    Attributes:
        decided_s: since the grasp began, of the tendon/state that decided [s]; None = none did, or it is not known.
        counted: the same grasp in the cell's database; None = not found there yet.
    """

    number: int
    started_s: float
    product: str
    finger_set: str
    serials: tuple[str, ...]
    tendons: tuple[str, ...] = ()
    samples: list[GraspSample] = field(default_factory=list)
    outcome: str = ""
    reason: str = ""
    duration_s: float = 0.0
    latency_s: float = 0.0
    decided_s: float | None = None
    fingers: tuple[FingerDecision, ...] = ()
    pictures: dict[str, bytes] = field(default_factory=dict)
    ended_s: float | None = None
    counted: CountedView | None = None


class GraspHistory:
    """Keeps the last grasps of the cell, whoever ordered them; the panel's own with verdict and evidence.

    Args:
        now_s: seconds since the Unix epoch.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._records: deque[GraspRecord] = deque(maxlen=MAX_GRASPS)
        self._running: GraspRecord | None = None
        self._last_picture = b""
        self._numbers = 0
        self._counts: CellView | None = None
        #: Grows whenever a list of the grasps would look otherwise.
        self.version = 0

    @property
    def records(self) -> tuple[GraspRecord, ...]:
        """Newest first."""
        return tuple(reversed(self._records))

    def find(self, number: int) -> GraspRecord | None:
        """Return the grasp of a number."""
        return next((record for record in self._records if record.number == number), None)

    def judged(self, finger: str) -> FingerDecision | None:
        """Return what the newest verdict knew of a finger; None where there is none."""
        fingers = next((record.fingers for record in reversed(self._records) if record.fingers), ())
        return next((one for one in fingers if one.finger == finger), None)

    def observe_mode(self, before: str, cell: CellView) -> None:
        """Take that a grasp began or ended."""
        if cell.mode == "GRASPING" and before != "GRASPING":
            self._begin(cell)
        elif before == "GRASPING" and cell.mode != "GRASPING":
            self._end(cell)
        if cell.mode != "GRASPING":
            self._counts = cell

    def observe_tensions(self, tensions: Sequence[TensionView], stamp_s: float = math.nan) -> None:
        """Take a sample of the curves.

        Args:
            tensions: of every tendon.
            stamp_s: of the tendon/state, by the cell's clock [s].
        """
        record = self._running
        if record is None or len(record.samples) >= MAX_SAMPLES:
            return
        record.tendons = tuple(one.name for one in tensions)
        record.samples.append(
            GraspSample(
                self._now_s() - record.started_s,
                tuple(one.tension_n for one in tensions),
                tuple(one.free_tension_n for one in tensions),
                stamp_s,
            )
        )

    def observe_picture(self, jpeg: bytes) -> None:
        """Take a camera frame; those before, at and after the verdict are kept."""
        self._last_picture = jpeg
        record = self._running or (self._records[-1] if self._records else None)
        if record is None:
            return
        if record.ended_s is None:
            record.pictures["at"] = jpeg
        elif "after" not in record.pictures or self._now_s() - record.ended_s <= AFTER_S:
            record.pictures["after"] = jpeg

    def observe_result(
        self,
        outcome: str,
        reason: str,
        *,
        duration_s: float,
        latency_s: float,
        fingers: Iterable[FingerDecision],
        decided_stamp_s: float = math.nan,
    ) -> None:
        """Take the result of a grasp that the panel ordered: it belongs to the newest one.

        Args:
            outcome: the verdict's name.
            reason: of it.
            duration_s: of the grasp [s].
            latency_s: from the deciding event to the decision [s].
            fingers: what the verdict knew of each.
            decided_stamp_s: of the tendon/state that decided, by the cell's clock [s]; NaN = none did.
        """
        record = self._running or (self._records[-1] if self._records else None)
        if record is None:
            return
        record.outcome, record.reason = outcome, reason
        record.duration_s, record.latency_s, record.fingers = duration_s, latency_s, tuple(fingers)
        record.decided_s = place_of(record.samples, decided_stamp_s)
        self.version += 1

    def observe_counted(self, counted: Sequence[CountedView]) -> None:
        """Take the grasps of the cell's database: they say of others' grasps, too, which sample decided.

        Args:
            counted: newest first.
        """
        taken = {record.counted.key for record in self._records if record.counted is not None}
        for record in reversed(self._records):
            if record.ended_s is None or record.counted is not None:
                continue
            found = min(
                (one for one in counted if one.key not in taken and _is_near(record, one)),
                key=lambda one: abs(one.at_s - record.samples[-1].stamp_s),
                default=None,
            )
            if found is not None:
                taken.add(found.key)
                self._complete(record, found)

    def _complete(self, record: GraspRecord, counted: CountedView) -> None:
        """Fill in what only the database says of a grasp that another client ordered."""
        record.counted = counted
        self.version += 1
        record.outcome = record.outcome or counted.outcome
        record.reason = record.reason or counted.reason
        if not any(record.serials):
            record.serials = counted.serials
        if not record.fingers:
            record.fingers = counted.fingers
            record.decided_s = place_of(record.samples, counted.decided_stamp_s)

    def _begin(self, cell: CellView) -> None:
        self._numbers += 1
        self.version += 1
        record = GraspRecord(
            self._numbers,
            self._now_s(),
            cell.product,
            cell.finger_set,
            tuple(one.serial for one in cell.mounted),
        )
        if self._last_picture:
            record.pictures["before"] = self._last_picture
        self._running = record
        self._records.append(record)
        if len(self._records) > MAX_PICTURED:
            self._records[-1 - MAX_PICTURED].pictures.clear()

    def _end(self, cell: CellView) -> None:
        record, self._running = self._running, None
        if record is None:
            return
        record.ended_s = self._now_s()
        self.version += 1
        record.duration_s = record.duration_s or record.ended_s - record.started_s
        record.outcome = record.outcome or _counted_outcome(self._counts, cell)


def _is_near(record: GraspRecord, counted: CountedView) -> bool:
    """Whether a counted grasp can be this one: its product and its end, both by the cell's clock."""
    if record.product != counted.product or record.outcome not in {"", counted.outcome} or not record.samples:
        return False
    return abs(counted.at_s - record.samples[-1].stamp_s) <= COUNTED_WITHIN_S


def place_of(samples: Sequence[GraspSample], stamp_s: float) -> float | None:
    """Return where a stamp of the cell lies on the curve's own time.

    The cell may live in a time of its own, so the samples around it say how one becomes the other. The panel sees only
    a part of the samples: the one that decided may lie between two of them, or just after the last.

    Args:
        samples: in order.
        stamp_s: by the cell's clock [s].

    Returns:
        seconds since the grasp began; None where no sample has a stamp, or there is none to place.
    """
    known = [one for one in samples if math.isfinite(one.stamp_s)]
    if not known or not math.isfinite(stamp_s):
        return None
    after = next((k for k, one in enumerate(known) if one.stamp_s >= stamp_s), len(known))
    high_number = min(max(after, 1), len(known) - 1)
    low, high = known[max(0, high_number - 1)], known[high_number]
    passed_s = high.stamp_s - low.stamp_s
    pace = (high.at_s - low.at_s) / passed_s if passed_s > 0.0 else 1.0
    return max(0.0, low.at_s + pace * (stamp_s - low.stamp_s))


def _counted_outcome(before: CellView | None, after: CellView) -> str:
    """Return which counter of cell/state grew: the verdict of a grasp that somebody else ordered."""
    if before is None:
        return ""
    grown = [
        name
        for name in ("gripped", "empty", "slipped", "tendon_faults", "aborted")
        if getattr(after, name) > getattr(before, name)
    ]
    return {"tendon_faults": "TENDON_FAULT"}.get(grown[0], grown[0].upper()) if len(grown) == 1 else ""
