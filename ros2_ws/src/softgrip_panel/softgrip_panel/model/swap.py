# SPDX-License-Identifier: Apache-2.0
"""Where the swap is: one step at a time, with the token that confirms it; survives the panel's own end on disk."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final

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
    """What pages show of a swap; `started_s` in seconds since the Unix epoch."""

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

    def elapsed_s(self, now_s: float) -> float:
        """Time since it began [s]; NaN before the first."""
        return now_s - self.started_s

    @property
    def is_open(self) -> bool:
        """Whether a person has something to do or to wait for."""
        return self.phase in (SwapPhase.RUNNING, SwapPhase.HANDS_INSIDE)


class SwapProgress:
    """Follows one swap at a time.

    Attributes:
        view: what is known of it.
    """

    def __init__(self) -> None:
        self.view = SwapView()
        self._file: Path | None = None
        #: Another panel ordered this swap: its feedback and result do not come here.
        self._is_taken_up = False

    def keep_in(self, file: Path) -> None:
        """Keep the swap in a file of this user alone, and take up what an earlier panel left there."""
        self._file = file
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
            view = SwapView(**{**document, "phase": SwapPhase(document["phase"])})
        except (OSError, ValueError, TypeError, KeyError):
            return
        if view.is_open:
            self.view, self._is_taken_up = view, True

    def begin_swap(self, finger_set: str, who: str, now_s: float) -> None:
        """A goal was accepted."""
        self._is_taken_up = False
        self._set(SwapView(SwapPhase.RUNNING, finger_set, started_s=now_s, who=who))

    def observe(self, step: str, instruction: str, token: str, *, needs_confirmation: bool) -> None:
        """Take feedback of the running swap."""
        self._set(
            replace(
                self.view,
                phase=SwapPhase.RUNNING,
                step=step,
                instruction=instruction,
                needs_confirmation=needs_confirmation,
                token=token,
            )
        )

    def confirm(self, message: str) -> None:
        """Take the answer to a confirmation: what is to do next, where no feedback says so."""
        if self.view.step == HANDS_OUT or self.view.phase is not SwapPhase.RUNNING or not self._is_taken_up:
            return
        step = STEPS[STEPS.index(self.view.step) + 1] if self.view.step in STEPS[:-1] else self.view.step
        self.observe(step, message, self.view.token, needs_confirmation=step in CONFIRMED)

    def end(self, *, success: bool, message: str) -> None:
        """Take the result; where the drives stay locked, a person has still to take the hands out."""
        inside = HANDS_OUT in message
        phase = SwapPhase.HANDS_INSIDE if inside else SwapPhase.ENDED
        self._set(replace(self.view, phase=phase, success=success, message=message, needs_confirmation=inside))

    def observe_mode(self, mode: str, reason: str) -> None:
        """Take cell/state: it says so where a swap ended that this panel did not see the end of."""
        if not self.view.is_open:
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
        self.view = view
        if self._file is not None:
            # a full disk takes nothing but the way back after a restart: hands_out has one without the token
            with contextlib.suppress(OSError):
                self._file.parent.mkdir(parents=True, exist_ok=True)
                waiting = self._file.with_suffix(".part")
                waiting.touch(mode=0o600)
                waiting.write_text(json.dumps(asdict(view)), encoding="utf-8")
                waiting.replace(self._file)


def read_serials(text: str, slots: Sequence[str]) -> list[str]:
    """Return the serials in what a scanner or a person typed: one a line, or parted by commas or blanks.

    A scanner ends each code with Enter; what it read for fewer slots than there are is returned as it is.
    """
    serials = text.replace(",", " ").replace(";", " ").split()
    return serials[: len(slots)]
