# SPDX-License-Identifier: Apache-2.0
"""What the predictor went by at the stamp of each tendon sample.

Three streams meet in a residual: the tendons, the camera, and what the cell says is mounted and free. Only the order of
the last against the tendons' is written into results. So a measurement is judged by what the tendon sample before it
was predicted with, whatever has come in meanwhile, and a replay comes to the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from softgrip_model.digest import text_digest
from softgrip_model.finger.diagnosis import CauseWatch
from softgrip_model.finger.learning import FingerLearner, Knowledge
from softgrip_model.finger.predictor import Configuration
from softgrip_model.finger.room_temperature import RoomTemperature
from softgrip_model.finger.wear import WearMonitor


@dataclass(frozen=True)
class ActiveConfiguration:
    """What predictions and residuals go by.

    Attributes:
        configuration: fingers and friction.
        monitors: judges of their wear, by slot.
        free: the fingers are free of objects.
        learners: what their closings have taught, by slot; empty: nothing is learnt.
        room: what the thermometer said last; None: there is none.
    """

    configuration: Configuration
    monitors: Mapping[str, WearMonitor | CauseWatch]
    free: bool
    learners: Mapping[str, FingerLearner] = field(default_factory=dict)
    room: RoomTemperature | None = None

    def known(self, stamp: int) -> dict[str, Knowledge]:
        """Return what a prediction at a stamp [ns] knows of each finger."""
        return {slot: learner.at(stamp) for slot, learner in self.learners.items()}

    @property
    def digest(self) -> str:
        """Name of everything here that predictions go by, but the friction and what was learnt."""
        digest = self.configuration.digest
        return digest if self.free else text_digest(f"{digest};not free")

    def digest_at(self, stamp: int) -> str:
        """Return the digest with what is known at a stamp [ns]; that of before when nothing is ever learnt."""
        known = sorted(self.known(stamp).items())
        parts = [f"{slot}:{one.name}" for slot, one in known]
        return text_digest(";".join([self.digest, *parts])) if parts else self.digest

    def holds(self, slot: str, profile: str) -> bool:
        """Whether a slot holds a finger of a profile; empty: of any."""
        mounted = self.configuration.mounted.get(slot)
        return mounted is not None and profile in {"", mounted}


class Timeline:
    """Keeps what was in use for ``span_ns`` of tendon samples."""

    def __init__(self, span_ns: int = 2_000_000_000) -> None:
        self._span_ns = span_ns
        self._since: deque[tuple[int, ActiveConfiguration]] = deque()
        self._newest_ns: int | None = None

    def record(self, stamp_ns: int, in_use: ActiveConfiguration) -> None:
        """Take down what the tendon sample of a stamp meets; a late sample changes nothing."""
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            if stamp_ns > self._newest_ns - self._span_ns:
                return
            self._since.clear()  # time only goes back so far when a source restarts
        self._newest_ns = stamp_ns
        if not self._since or self._since[-1][1] != in_use:
            self._since.append((stamp_ns, in_use))
        while len(self._since) > 1 and self._since[1][0] < stamp_ns - self._span_ns:
            self._since.popleft()

    def at(self, stamp_ns: int) -> ActiveConfiguration | None:
        """Return what the last tendon sample up to a stamp met; None when there was none."""
        return next((in_use for since, in_use in reversed(self._since) if since <= stamp_ns), None)
