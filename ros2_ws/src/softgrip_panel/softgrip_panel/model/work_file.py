# SPDX-License-Identifier: Apache-2.0
"""An order list on disk: what was planned and what came of it survive the panel's end."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from softgrip_model.durable import write_durably
from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: An order list holds at most so many grasps.
MAX_ITEMS: Final = 5000
#: Verdicts that end an item; whatever else a grasp ends with leaves it still to come.
VERDICTS: Final = frozenset({"GRIPPED", "EMPTY", "SLIPPED"})
#: Outcome of an item that a person left out: it was not tried to its end, so no figure counts it.
LEFT_OUT: Final = "LEFT_OUT"
#: What may have come of an item; empty = still to come.
OUTCOMES: Final = VERDICTS | {"", LEFT_OUT}


class WorkPhase(StrEnum):
    """Where the work is."""

    EMPTY = "empty"
    PLANNED = "planned"
    RUNNING = "running"
    PAUSED = "paused"
    ENDED = "ended"


@dataclass(frozen=True)
class WorkItem:
    """One grasp of the run; an empty outcome = still to come."""

    product: str
    finger_set: str
    predicted_time_s: float
    outcome: str = ""
    reason: str = ""
    took_s: float = 0.0


@dataclass(frozen=True)
class KeptWork:
    """What is kept of a run.

    Attributes:
        at_s: when it was written, in seconds since the Unix epoch.
        expected_success: 0..1; NaN = not known.
        running_s, paused_s: time spent until then [s].
    """

    at_s: float
    phase: WorkPhase
    message: str
    items: tuple[WorkItem, ...]
    swaps: int
    predicted_time_s: float
    expected_success: float
    redundant_sets: tuple[str, ...]
    running_s: float
    paused_s: float


class WorkFile:
    """A file of this user alone.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, kept: KeptWork) -> None:
        """Write a run; on the disk when this returns.

        Raises:
            PanelError: the disk takes nothing; the file is as it was.
        """
        success = None if math.isnan(kept.expected_success) else kept.expected_success
        items = [
            [one.product, one.finger_set, one.predicted_time_s, one.outcome, one.reason, one.took_s]
            for one in kept.items
        ]
        document = {
            **vars(kept),
            "phase": kept.phase.value,
            "items": items,
            "expected_success": success,
            "redundant_sets": list(kept.redundant_sets),
        }
        try:
            write_durably(self._path, json.dumps(document).encode(), 0o600)
        except OSError as error:
            raise PanelError(say("error.work_not_written", path=self._path, error=error)) from error

    def read(self) -> KeptWork | None:
        """Return the run that an earlier panel left, None where it left none.

        Raises:
            PanelError: the file cannot be read, or holds something else.
        """
        try:
            return _kept(json.loads(self._path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise PanelError(
                say("error.work_spoiled", path=self._path, error=f"{type(error).__name__}: {error}")
            ) from error


def _kept(document: Any) -> KeptWork:
    items = document["items"]
    if not isinstance(items, list) or len(items) > MAX_ITEMS:
        raise ValueError(f"items: expected a list of at most {MAX_ITEMS}")
    success = document["expected_success"]
    return KeptWork(
        at_s=_number(document["at_s"]),
        phase=WorkPhase(document["phase"]),
        message=_text(document["message"]),
        items=tuple(_item(one) for one in items),
        swaps=int(_number(document["swaps"])),
        predicted_time_s=_number(document["predicted_time_s"]),
        expected_success=math.nan if success is None else _number(success),
        redundant_sets=tuple(_text(one) for one in document["redundant_sets"]),
        running_s=_number(document["running_s"]),
        paused_s=_number(document["paused_s"]),
    )


def _item(row: Sequence[object]) -> WorkItem:
    product, finger_set, predicted_time_s, outcome, reason, took_s = row
    if outcome not in OUTCOMES:
        raise ValueError(f"outcome: expected one of {sorted(OUTCOMES)}, found {outcome!r}")
    return WorkItem(
        _text(product), _text(finger_set), _number(predicted_time_s), outcome, _text(reason), _number(took_s)
    )


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"expected a text, found {value!r}")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < math.inf:
        raise ValueError(f"expected a number from 0 on, found {value!r}")
    return float(value)
