# SPDX-License-Identifier: Apache-2.0
"""Which fingers are shown, when, at what rate and on which mesh: decided from the stamps of the tendon states alone.

Only the newest state waits while one is solved, so the distance of the stamps that come through says how long solving
took, on any machine and in a replay alike. Where it took too long, or what a shape needs would at that pace, the
coarser mesh serves for a while, and says so; the fine one gets its keyframes one by one when the tendon stands still.
What another thread computes `ahead` of that makes shapes come sooner; decisions know it by the stamps alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.matching import TendonInput
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.gdfe.closing import ClosingPath, ClosingSettings, ClosingShape
from softgrip_model.gdfe.closing_cache import ClosingCache, ClosingKey
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.prefetcher import KeyframePrefetcher
from softgrip_model.profile import Profile

#: Share of the last interval in the stated rate.
_RATE_SMOOTHING = 0.2
#: Below this share of the rate asked for, the shapes are said to be coarser in time.
_COARSER = 0.8
#: [s] Shapes that come further apart than this are too slow to look at.
_TOO_SLOW = 0.4
#: [s] Keyframes that would take longer, as those before did, are left for later.
_TOO_LONG = 0.25
#: [mm] A tendon that moves less from shape to shape stands still: time to catch up. [s] One that never does gets at
#: least one keyframe in so long.
_STILL_MM, _SILENCE_LIMIT_S = 0.1, 0.5
#: The coarser mesh serves so many times as long as a shape was late, [s] at most so long.
_RELIEF, _LONGEST_RELIEF = 2.0, 5.0
#: Mesh that serves where the one asked for is too slow, and the tolerance that goes with it at least: it halves the
#: iterations and moves the tip by 0.2 mm at most, the mesh by more.
_COARSE, _COARSE_TOLERANCE = RESOLUTIONS["coarse"], 1e-3
#: So many fingers that are not mounted are made ready (4 MB each).
_NEXT = 6
#: Share of the time between shapes that a shape may come late by and keyframes still be said to have taken no time.
_NO_TIME = 0.5
#: Keyframes that the fine mesh is given with one shape at most, where they take no time.
_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class Shown:
    """One shape to publish."""

    finger: str
    mesh: str
    faces: NDArray[np.uint32]
    hexahedra: int
    shape: ClosingShape
    rate_hz: float
    """At which this finger's shapes are being computed; NaN until there are two."""
    marker_due: bool
    reason: str
    """Why not converged, what to know of the material, or that shapes come coarser in time or space than asked for."""
    configuration: str
    """Digest of profile, friction and settings, whichever mesh serves."""


class _Slots:
    """Takes the first stamp in every period of a rate."""

    def __init__(self, rate_hz: float) -> None:
        self._rate = rate_hz
        self._slot: int | None = None

    def takes(self, stamp_ns: int) -> bool:
        if self._rate <= 0.0:
            return False
        slot = math.floor(stamp_ns * 1e-9 * self._rate)
        if slot == self._slot:
            return False
        self._slot = slot
        return True


class _Relief:
    """Says from when to when shapes are too slow."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._until = 0
        self.gap = 0.0
        """[s] between the two shapes that were last too far apart."""

    def note(self, stamp_ns: int) -> None:
        gap = 0.0 if self._last is None else 1e-9 * (stamp_ns - self._last)
        self._last = stamp_ns
        if gap > _TOO_SLOW:
            self.gap = gap
            self._until = stamp_ns + round(1e9 * min(_RELIEF * gap, _LONGEST_RELIEF))

    def forget(self) -> None:
        """Leave out the time to the next shape: another finger was made ready meanwhile."""
        self._last = None

    def due(self, stamp_ns: int) -> bool:
        return stamp_ns < self._until


class _Pace:
    """Says how much longer than usual a shape takes for every keyframe of the fine mesh that it asks for."""

    def __init__(self, usual: float) -> None:
        self._usual = usual  # [s] between shapes
        self._asked = 0
        self._each = 0.0
        self.free = False
        """The last ones took no time."""

    def note(self, gap: float, asked: int) -> None:
        """Note the time [s] since the shape before, and the keyframes that shapes have asked for in all."""
        late = max(0.0, gap - self._usual)
        if asked > self._asked:
            self._each = late / (asked - self._asked)
            self.free = late < _NO_TIME * self._usual
        self._asked = asked

    def seconds(self, keyframes: int) -> float:
        return keyframes * self._each


@dataclass
class _Slot:
    """One shown finger: as asked for, and, once it is needed, on the coarser mesh."""

    fine: ClosingPath
    make_coarse: Callable[[], ClosingPath]
    coarse: ClosingPath | None = None
    why: str = ""
    """The coarse one serves; empty: it does not."""
    _owed_mm: float = 0.0
    """Farthest length that it has served at."""
    _last: tuple[float, int] = (math.inf, 0)
    """Length and stamp of the shape before."""
    _advanced: int = 0
    """Stamp at which the fine one last caught up."""
    _has_time: bool = False
    _at_once: int = 1
    _given: int = 0
    """How many the fine one was given after the shape before."""

    def closing(self, pulled_mm: float, stamp_ns: int, pace: _Pace, too_slow: str) -> ClosingPath:
        """Return the one that serves at a length; the fine one comes back only when it has nothing to catch up on."""
        length, keyframes = max(0.0, pulled_mm), self.fine.keyframes
        still = abs(length - self._last[0]) < _STILL_MM
        self._last = length, stamp_ns
        taking = pace.seconds(keyframes.missing(length))
        if too_slow:
            self.why = too_slow
        elif self.why and keyframes.covers(length):
            self.why = ""
        elif not self.why and taking > _TOO_LONG:
            self.why = f"its next shape would take {taking:.1f} s"
        waited = 1e-9 * (stamp_ns - self._advanced) > _SILENCE_LIMIT_S
        self._has_time = still or (bool(self.why) and (waited or pace.free))
        self._at_once = min(2 * self._given, _AT_ONCE) if pace.free and self._given else 1
        if not self.why:
            return self.fine
        self._owed_mm = max(self._owed_mm, length)
        self.coarse = self.coarse or self.make_coarse()
        return self.coarse

    def catch_up(self) -> None:
        """Give the fine one keyframes, where it is owed some and there is time: one, or ever more that take none."""
        self._given = 0
        while self._has_time and self._given < self._at_once and not self.fine.keyframes.covers(self._owed_mm):
            self._advanced = self._last[1]
            self._given += 1
            self.fine.keyframes.advance()


class ShapeSession:
    """The mounted fingers and their shapes.

    Args:
        profiles: by id.
        mounted: slot -> profile id of the fingers that are shown.
        settings: of every closing.
        rate_hz: shapes per second of stamp time at most.
        marker_rate_hz: markers likewise; 0 = none.
        ahead: computes keyframes from the first tendon state on, of the mounted fingers and then of others that may
            be; None = all wait for the shape that needs them.

    Raises:
        GdfeError, FingerError, ProfileError: a finger that cannot be simulated.
    """

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        mounted: Mapping[str, str],
        settings: ClosingSettings,
        *,
        rate_hz: float,
        marker_rate_hz: float,
        ahead: KeyframePrefetcher | None = None,
    ) -> None:
        self._profiles, self._closings = profiles, ClosingCache(profiles)
        tolerance = max(settings.tolerance, _COARSE_TOLERANCE)
        self._settings, self._coarse_settings = settings, replace(settings, resolution=_COARSE, tolerance=tolerance)
        self._required_rate = rate_hz
        self._ahead = ahead
        self._slots, self._marker_slots = _Slots(rate_hz), _Slots(marker_rate_hz)
        self._shown = tuple(mounted)
        self._friction: ActiveFriction | None = None
        self._made: dict[ClosingKey, _Slot] = {}
        self._fingers: dict[str, _Slot] = {}
        self._relief, self._pace = _Relief(), _Pace(1.0 / rate_hz)
        self._last_stamp: int | None = None
        self._rate = math.nan
        self.mounted: dict[str, str] = {}
        self.set_mounted(mounted)
        self._planned = self._plan()

    @property
    def description(self) -> str:
        """Meshes in words."""
        return ", ".join(f"{slot} {finger.fine.hexahedra} hexahedra" for slot, finger in self._fingers.items())

    def set_mounted(self, mounted: Mapping[str, str]) -> None:
        """Say which profile sits in which slot; slots that are not shown are left out.

        Raises:
            GdfeError, FingerError, ProfileError: unknown profile, or a finger that cannot be simulated; all stays.
        """
        requested = {slot: mounted[slot] for slot in self._shown if slot in mounted}
        if requested == self.mounted:
            return
        self._fingers = {slot: self._finger(profile_id, slot) for slot, profile_id in requested.items()}
        self.mounted = requested
        self._planned = self._plan()
        self._relief.forget()

    @property
    def friction_id(self) -> str:
        """The calibrated friction model in use; empty while every profile has its own."""
        return self._friction.id if self._friction else ""

    def set_friction(self, friction: ActiveFriction) -> None:
        """Compute with a calibrated friction model from now on, whatever profiles name.

        Raises:
            GdfeError: a finger cannot be simulated with it; all stays.
        """
        used = self._friction
        if used is not None and (friction.id, friction.digest, friction.law) == (used.id, used.digest, used.law):
            return
        before, self._friction = self._friction, friction
        try:
            self._fingers = {slot: self._finger(profile_id, slot) for slot, profile_id in self.mounted.items()}
        except GdfeError:
            self._friction = before
            raise
        self._closings.keep(friction)
        self._made = {requested: slot for requested, slot in self._made.items() if requested.friction is friction}
        self._planned = self._plan()

    def on_tendons(self, names: Sequence[str], samples: Sequence[TendonInput]) -> Iterator[Shown]:
        """Yield the shapes of a tendon state; none when its stamp falls into a period that has been served.

        What there is to catch up on is done when the last has been taken: it makes no shape late.
        """
        if self._ahead is not None:
            self._ahead.want(self._planned, self._closings)
        if not samples or self._fingers.keys().isdisjoint(names):
            # What shows nothing leaves no trace: a replay knows only of the states that were shown.
            return
        if not self._slots.takes(samples[0].stamp):
            return
        stamp = samples[0].stamp
        self._pace.note(self._note_rate(stamp), self._keyframes_asked())
        self._relief.note(stamp)
        marker_due = self._marker_slots.takes(stamp)
        for name, sample in zip(names, samples, strict=True):
            finger = self._fingers.get(name)
            if finger is None:
                continue
            closing = finger.fine
            if self._settings.resolution != _COARSE:
                closing = finger.closing(1e3 * sample.pulled_length, stamp, self._pace, self._too_slow(stamp))
            shape = closing.shape(sample.pulled_length)
            reason = "; ".join(filter(None, (shape.reason, self._fewer(), self._coarser(finger))))
            yield Shown(
                finger=name,
                mesh=closing.digest,
                faces=closing.faces,
                hexahedra=closing.hexahedra,
                shape=shape,
                rate_hz=self._rate,
                marker_due=marker_due,
                reason=reason,
                configuration=finger.fine.digest,
            )
        for name in names:
            if name in self._fingers:
                self._fingers[name].catch_up()

    def _keyframes_asked(self) -> int:
        """Return how many shapes have asked for, without the undeformed states, which take no time."""
        return sum(max(0, slot.fine.keyframes.asked - 1) for slot in self._made.values())

    def _fewer(self) -> str:
        if not self._rate < _COARSER * self._required_rate:
            return ""
        return f"{self._rate:.1f} Hz instead of {self._required_rate:g} Hz: states come, or are solved, more slowly"

    def _too_slow(self, stamp: int) -> str:
        return f"shapes came {self._relief.gap:.1f} s apart" if self._relief.due(stamp) else ""

    def _coarser(self, finger: _Slot) -> str:
        if not finger.why or finger.coarse is None:
            return ""
        return f"coarser mesh ({finger.coarse.hexahedra} instead of {finger.fine.hexahedra} hexahedra): {finger.why}"

    def _note_rate(self, stamp: int) -> float:
        """Return the time [s] since the shape before."""
        gap = 0.0 if self._last_stamp is None else 1e-9 * (stamp - self._last_stamp)
        if gap > 0.0:
            now = 1.0 / gap
            is_restart = math.isnan(self._rate) or gap > _TOO_SLOW
            self._rate = now if is_restart else self._rate + _RATE_SMOOTHING * (now - self._rate)
        self._last_stamp = stamp
        return gap

    def _finger(self, profile_id: str, slot: str) -> _Slot:
        requested = ClosingKey(profile_id, slot, self._settings, self._friction)
        if requested not in self._made:
            coarse = replace(requested, settings=self._coarse_settings)
            self._made[requested] = _Slot(self._closings.get(requested), partial(self._closings.get, coarse))
        return self._made[requested]

    def _plan(self) -> tuple[ClosingKey, ...]:
        """Return what to work on ahead: what is mounted, first what serves when time is short; then what may be."""
        mounted = list(self.mounted.items())
        others = [(slot, profile) for slot in self._shown for profile in sorted(self._profiles)]
        others = [other for other in others if other not in mounted][:_NEXT]
        short = [] if self._settings.resolution == _COARSE else [(*finger, self._coarse_settings) for finger in mounted]
        asked = [(*finger, self._settings) for finger in mounted + others]
        return tuple(ClosingKey(profile, slot, settings, self._friction) for slot, profile, settings in short + asked)
