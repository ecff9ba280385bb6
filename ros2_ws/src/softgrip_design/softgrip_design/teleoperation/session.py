# SPDX-License-Identifier: Apache-2.0
"""One frame after the other: find the hand, ask the dead-man switch, order the next pulled lengths.

An order moves the tendons for `MAX_ORDER_S` at most; then they stand, unless another one came. So nothing has to
happen for them to stop: with a press that counts for `PRESS_LIFETIME_S` they stand 0.18 s after the last one, also when
this program hangs or dies.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_design.capture.detector import HandDetector
from softgrip_design.capture.frames import VideoFrame
from softgrip_design.teleoperation.demonstration import Demonstrations, Phase
from softgrip_design.teleoperation.follower import REFERENCE_FRAMES, HandFollower

#: A press counts for so long [s]. A key repeats every 30 to 40 ms, a pedal has to send at 20 Hz or more.
PRESS_LIFETIME_S: Final = 0.10


class DeadManSwitch:
    """Is held while presses keep coming; may be pressed by one thread and asked by another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._until_s = -1.0

    def press(self, now_s: float) -> None:
        """Take a press at a time of the steady clock [s]."""
        with self._lock:
            self._until_s = now_s + PRESS_LIFETIME_S

    def release(self) -> None:
        """Take that it was let go."""
        with self._lock:
            self._until_s = -1.0

    def is_held(self, now_s: float) -> bool:
        """Return whether the last press is young enough."""
        with self._lock:
            return now_s <= self._until_s


Array = NDArray[np.float64]

#: Shortest and longest time that an order takes [s].
MIN_ORDER_S: Final = 0.02
MAX_ORDER_S: Final = 0.08
#: An order takes so many frames' time: the next one takes over before the tendons stand.
ORDER_FRAMES: Final = 1.5
#: A frame whose hand was found later than this moves nothing [s].
MAX_FRAME_AGE_S: Final = 0.2

NOT_HELD: Final = "hold the dead-man switch to move"
NOT_ARMED: Final = "let go of the dead-man switch, then hold it again"
ENDED: Final = "teleoperation has ended"
NO_HAND: Final = "no hand in sight"


@dataclass(frozen=True, eq=False)
class TeleoperationFrame:
    """What became of a frame.

    Attributes:
        stamp_s: of the frame, in the cell's time.
        episode, phase: of the demonstration.
        is_held: the dead-man switch.
        has_hand: a hand was found.
        deflections_rad: (tendons,) of the hand, NaN where unknown.
        joint_angles_rad: of the hand's joints, finger by finger; empty where unknown.
        targets_m: (tendons,) ordered last, or measured where nothing is ordered.
        duration_s: of the order; 0 where there is none.
        reason: why nothing moves; empty where the fingers follow.
    """

    stamp_s: float
    episode: int
    phase: Phase
    is_held: bool
    has_hand: bool
    deflections_rad: Array
    joint_angles_rad: Array
    targets_m: Array
    duration_s: float
    reason: str


class FingerPort(Protocol):
    """The way to the fingers."""

    def cell_time_s(self) -> float:
        """Return the cell's time [s]."""

    def lengths_m(self) -> Array:
        """Return the measured pulled lengths, (tendons,) [m]."""

    def find_problem(self) -> str:
        """Return why nothing may move; empty when nothing is in the way."""

    def order(self, stamp_s: float, lengths_m: Array, duration_s: float) -> None:
        """Move the tendons there within a time [s]."""

    def show(self, frame: TeleoperationFrame) -> None:
        """Publish what became of a frame."""


class TeleoperationSession:
    """Leads the fingers with a hand.

    Args:
        port: to the fingers.
        follower: of the hand.
        detector: of the hand.
        switch: without which nothing moves.
        demonstrations: that are shown.
        now_s: the steady clock, of the switch.
    """

    def __init__(
        self,
        port: FingerPort,
        follower: HandFollower,
        detector: HandDetector,
        switch: DeadManSwitch,
        demonstrations: Demonstrations,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._port, self._follower, self._detector = port, follower, detector
        self._switch, self._demonstrations, self._now_s = switch, demonstrations, now_s
        self._targets_m: Array | None = None
        self._last_stamp_s = -np.inf

    def run(self, frames: Iterable[VideoFrame], is_ended: Callable[[], bool]) -> int:
        """Follow until the frames or the person end it; return the number of frames.

        Raises:
            DesignError: frames that cannot be read, or tendons that somebody else has now.
        """
        count = 0
        try:
            for frame in frames:
                if is_ended():
                    break
                self._port.show(self.process_frame(frame))
                count += 1
        finally:
            self.end()
        return count

    def process_frame(self, frame: VideoFrame) -> TeleoperationFrame:
        """Find the hand in a frame, and order what follows from it."""
        stamp_s = frame.time_s
        hand = self._detector.find(frame.image)
        self._follower.observe(stamp_s, None if hand is None else hand.world)
        step_s, self._last_stamp_s = stamp_s - self._last_stamp_s, stamp_s
        problem = self._find_problem()
        is_held = self._switch.is_held(self._now_s())
        may_move = self._demonstrations.observe(is_held=is_held, is_blocked=bool(problem))
        start_m = self._port.lengths_m() if self._targets_m is None else self._targets_m
        self._targets_m = None
        duration_s = 0.0
        if not may_move:
            problem = problem or (NOT_ARMED if is_held else NOT_HELD)
        elif (age_s := self._port.cell_time_s() - stamp_s) > MAX_FRAME_AGE_S:
            problem = f"the hand was found {age_s:.2f} s after its frame; expected {MAX_FRAME_AGE_S} s at most"
        else:
            self._targets_m = self._follower.next_lengths_m(start_m, step_s)
            problem = NO_HAND if self._targets_m is None else ""
        if self._targets_m is not None:
            duration_s = float(np.clip(ORDER_FRAMES * step_s, MIN_ORDER_S, MAX_ORDER_S))
            self._port.order(stamp_s, self._targets_m, duration_s)
        number, phase = self._demonstrations.current
        return TeleoperationFrame(
            stamp_s=stamp_s,
            episode=number,
            phase=phase,
            is_held=is_held,
            has_hand=hand is not None,
            deflections_rad=self._follower.deflections_rad,
            joint_angles_rad=self._follower.joint_angles_rad,
            targets_m=start_m if self._targets_m is None else self._targets_m,
            duration_s=duration_s,
            reason=problem,
        )

    def end(self) -> None:
        """End what runs without a verdict, and publish the last phase."""
        self._demonstrations.end(Phase.ABORTED)
        number, phase = self._demonstrations.current
        unknown = np.full(len(self._follower.tendons), np.nan)
        stamp_s, lengths_m = self._port.cell_time_s(), self._port.lengths_m()
        self._port.show(
            TeleoperationFrame(stamp_s, number, phase, False, False, unknown, np.zeros(0), lengths_m, 0.0, ENDED)
        )

    def _find_problem(self) -> str:
        problem = self._port.find_problem()
        if not problem and not self._follower.has_reference:
            problem = f"show the open hand first, {REFERENCE_FRAMES} frames"
        return problem
