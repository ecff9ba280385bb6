# SPDX-License-Identifier: Apache-2.0
"""Where the swap is, one step at a time, whoever ordered it.

This panel's own swap has the token that confirms its steps, and survives the panel's own end on disk. Of a swap that
another client ordered, cell/swap_progress says the same without the token.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final

from softgrip_model.durable import write_durably

#: A swap of one set of fingers for another may take so long (thesis 4.3.4) [s].
LIMIT_S: Final = 300.0

#: Steps in order, named as in softgrip_cell's SwapStep.
STEPS: Final = (
    "release", "lock", "open_palm", "remove", "insert", "close_palm", "unlock", "home", "verify", "done",
)  # fmt: skip
#: Steps that wait for a person.
CONFIRMED: Final = ("open_palm", "remove", "insert", "close_palm")
#: What a person confirms when a swap ended while the drives were locked.
HANDS_OUT: Final = "hands_out"
#: What a manager says that was started again in the midst of a swap.
RESTARTED: Final = "restarted during swap"
#: The step that asks for serials.
ASKS_SERIALS: Final = "insert"


class SwapPhase(StrEnum):
    """Whether a swap runs, and how the last one ended."""

    NONE = "none"
    RUNNING = "running"
    ENDED = "ended"
    HANDS_INSIDE = "hands inside"


@dataclass(frozen=True)
class SwapView:
    """What pages show of a swap; `started_s` in seconds since the Unix epoch.

    Attributes:
        goal_id: identity of its goal in hex digits; empty = not known.
        token: confirms its steps; empty = another client has it.
        is_foreign: another client ordered it.
    """

    phase: SwapPhase = SwapPhase.NONE
    finger_set: str = ""
    step: str = ""
    instruction: str = ""
    needs_confirmation: bool = False
    started_s: float = math.nan
    token: str = ""
    who: str = ""
    success: bool = False
    message: str = ""
    goal_id: str = ""
    is_foreign: bool = False

    def elapsed_s(self, now_s: float) -> float:
        """Time since it began [s]; NaN before the first."""
        return now_s - self.started_s

    @property
    def is_open(self) -> bool:
        """Whether a person has something to do or to wait for."""
        return self.phase in (SwapPhase.RUNNING, SwapPhase.HANDS_INSIDE)

    @property
    def is_waiting(self) -> bool:
        """Whether a person has something to do now."""
        return self.is_open and self.needs_confirmation

    @property
    def can_be_confirmed(self) -> bool:
        """Whether this panel can say that the person has done it."""
        return self.is_waiting and not self.is_foreign


class SwapFollower:
    """Follows one swap at a time.

    Attributes:
        view: what is known of it.
    """

    def __init__(self) -> None:
        self.view = SwapView()
        #: The last swap that this panel ordered, in this run or in an earlier one.
        self._own = self.view
        self._file: Path | None = None
        #: An earlier panel ordered the own swap: its feedback and result do not come here.
        self._is_taken_up = False

    def keep_in(self, file: Path) -> None:
        """Keep the own swap in a file of this user alone, and take up what an earlier panel left there."""
        self._file = file
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
            view = SwapView(**{**document, "phase": SwapPhase(document["phase"])})
        except (OSError, ValueError, TypeError, KeyError):
            return
        if view.is_open:
            self.view = self._own = view
            self._is_taken_up = True

    def begin_swap(self, finger_set: str, who: str, now_s: float, goal_id: str = "") -> None:
        """A goal of this panel was accepted."""
        self._is_taken_up = False
        # cell/swap_progress may have come first
        known = self.view if goal_id and self.view.goal_id == goal_id else SwapView(SwapPhase.RUNNING)
        self._set(replace(known, finger_set=finger_set, started_s=now_s, who=who, goal_id=goal_id, is_foreign=False))

    def observe(self, step: str, instruction: str, token: str, *, needs_confirmation: bool) -> None:
        """Take feedback of the own swap."""
        self._set(
            replace(
                self._own,
                phase=SwapPhase.RUNNING,
                step=step,
                instruction=instruction,
                needs_confirmation=needs_confirmation,
                token=token,
            )
        )

    def observe_progress(self, progress: SwapView) -> None:
        """Take cell/swap_progress: the only way to follow what others ordered, and an own swap after a restart.

        Args:
            progress: as it is said to everybody, without token and name.
        """
        own = self._own
        if progress.goal_id and progress.goal_id == own.goal_id:
            if self._is_taken_up or self.view is not own:
                self._set(replace(progress, token=own.token, who=own.who, started_s=own.started_s))
            return
        is_own_shown = not self.view.is_foreign and own.phase is not SwapPhase.NONE
        is_news = not own.is_open and progress.phase is SwapPhase.HANDS_INSIDE
        if not progress.goal_id and is_own_shown and not is_news:
            return  # a manager that was started again: cell/state says what became of the own swap
        if own.is_open and not self._is_taken_up and progress.phase is not SwapPhase.RUNNING:
            return  # of an earlier swap: this one's own result will come
        if progress.phase is not SwapPhase.NONE:
            self.view = replace(progress, is_foreign=True)

    def end(self, *, success: bool, message: str) -> None:
        """Take the own swap's result; where the drives stay locked, a person has still to take the hands out."""
        inside = HANDS_OUT in message
        phase = SwapPhase.HANDS_INSIDE if inside else SwapPhase.ENDED
        self._set(replace(self._own, phase=phase, success=success, message=message, needs_confirmation=inside))

    def observe_mode(self, mode: str, reason: str) -> None:
        """Take cell/state: it says so where an own swap ended that this panel did not see the end of."""
        if self.view.is_foreign or not self.view.is_open:
            return
        if HANDS_OUT in reason:
            if self.view.phase is not SwapPhase.HANDS_INSIDE:
                self.end(success=False, message=reason)
        elif RESTARTED in reason:
            self.end(success=False, message=reason)
        elif mode != "SWAPPING" and (self.view.phase is SwapPhase.HANDS_INSIDE or self._is_taken_up):
            success = ": SUCCEEDED: " in reason
            self._set(
                replace(self.view, phase=SwapPhase.ENDED, needs_confirmation=False, success=success, message=reason)
            )

    def _set(self, view: SwapView) -> None:
        self.view = self._own = view
        if self._file is not None:
            # a full disk takes nothing but the way back after a restart: hands_out has one without the token
            with contextlib.suppress(OSError):
                write_durably(self._file, json.dumps(asdict(view)).encode(), 0o600)


def read_serials(text: str, slots: Sequence[str]) -> list[str]:
    """Return the serials in what a scanner or a person typed: one a line, or parted by commas or blanks.

    A scanner ends each code with Enter; what it read for fewer slots than there are is returned as it is.
    """
    serials = text.replace(",", " ").replace(";", " ").split()
    return serials[: len(slots)]
