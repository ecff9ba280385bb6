# SPDX-License-Identifier: Apache-2.0
"""Which fingers are shown, when, at what rate and on which mesh: decided from the stamps of the tendon states alone.

Only the newest state waits while one is solved, so the distance of the stamps that come through says how long solving
took, on any machine and in a replay alike. Where it took too long, or what a shape needs would at that pace, the
coarser mesh serves for a while, and says so; the fine one gets its keyframes one by one when the tendon stands still.
Keyframes that a worker prefetches make shapes come sooner; decisions know them by the stamps alone.
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
from softgrip_model.profile import Profile
from softgrip_time.units import to_ns, to_s

#: Share of the last interval in the stated rate.
_RATE_SMOOTHING = 0.2
#: Below this share of the rate asked for, the shapes are said to be coarser in time.
_COARSER_SHARE = 0.8
#: [s] Shapes that come further apart than this are too slow to look at.
_TOO_SLOW_S = 0.4
#: [s] Keyframes that would take longer, as those before did, are left for later.
_TOO_LONG_S = 0.25
#: [mm] A tendon that moves less from shape to shape stands still: time to catch up. [s] One that never does gets at
#: least one keyframe in so long.
_STILL_MM, _SILENCE_LIMIT_S = 0.1, 0.5
#: The coarser mesh serves so many times as long as a shape was late, [s] at most so long.
_RELIEF_FACTOR, _MAX_RELIEF_S = 2.0, 5.0
#: Mesh that serves where the one asked for is too slow, and the tolerance that goes with it at least: it halves the
#: iterations and moves the tip by 0.2 mm at most, the mesh by more.
_COARSE, _COARSE_TOLERANCE = RESOLUTIONS["coarse"], 1e-3
#: So many fingers that are not mounted are made ready (4 MB each).
_MAX_PREFETCHED_OTHERS = 6
#: Share of the time between shapes that a shape may come late by and keyframes still be said to have taken no time.
_NO_TIME_SHARE = 0.5
#: Keyframes that the fine mesh is given with one shape at most, where they take no time.
_MAX_AT_ONCE = 16


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


class _RateLimit:
    """Accepts the first stamp in every period of a rate."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._period: int | None = None

    def accepts(self, stamp_ns: int) -> bool:
        if self._rate_hz <= 0.0:
            return False
        period = math.floor(to_s(stamp_ns) * self._rate_hz)
        if period == self._period:
            return False
        self._period = period
        return True


class _Pace:
    """How fast shapes come by their stamps: their rate, until when they are too slow, what a keyframe costs.

    Args:
        rate_hz: shapes per second that are asked for.
    """

    def __init__(self, rate_hz: float) -> None:
        self._required_hz = rate_hz
        self._last_stamp: int | None = None
        self._has_new_finger = False
        self._requested = 0
        self._keyframe_s = 0.0
        self._late_gap_s = 0.0
        self._late_until = 0
        self.rate_hz = math.nan
        """At which shapes come; NaN until there are two."""
        self.has_free_keyframes = False
        """The last ones took no time."""

    def record_shape(self, stamp_ns: int, requested: int) -> None:
        """Record a shape's stamp, and the keyframes that shapes have requested in all."""
        gap_s = 0.0 if self._last_stamp is None else to_s(stamp_ns - self._last_stamp)
        if gap_s > 0.0:
            now = 1.0 / gap_s
            is_restart = math.isnan(self.rate_hz) or gap_s > _TOO_SLOW_S
            self.rate_hz = now if is_restart else self.rate_hz + _RATE_SMOOTHING * (now - self.rate_hz)
        late_s = max(0.0, gap_s - 1.0 / self._required_hz)
        if requested > self._requested:
            self._keyframe_s = late_s / (requested - self._requested)
            self.has_free_keyframes = late_s < _NO_TIME_SHARE / self._required_hz
        self._requested = requested
        if gap_s > _TOO_SLOW_S and not self._has_new_finger:
            self._late_gap_s = gap_s
            self._late_until = stamp_ns + to_ns(min(_RELIEF_FACTOR * gap_s, _MAX_RELIEF_S))
        self._has_new_finger = False
        self._last_stamp = stamp_ns

    def record_new_finger(self) -> None:
        """Leave the time to the next shape out of what is too slow: another finger was made ready meanwhile."""
        self._has_new_finger = True

    def keyframes_s(self, count: int) -> float:
        """Return how much longer a shape takes that requests so many keyframes of the fine mesh [s]."""
        return count * self._keyframe_s

    def why_too_slow(self, stamp_ns: int) -> str:
        """Return why shapes are too slow at a stamp; empty: they are not."""
        return f"shapes came {self._late_gap_s:.1f} s apart" if stamp_ns < self._late_until else ""

    def why_fewer(self) -> str:
        """Return that shapes come at a lower rate than asked for; empty: they do not."""
        if not self.rate_hz < _COARSER_SHARE * self._required_hz:
            return ""
        return f"{self.rate_hz:.1f} Hz instead of {self._required_hz:g} Hz: states come, or are solved, more slowly"


@dataclass
class _ShownFinger:
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

    def choose_closing(self, pulled_mm: float, stamp_ns: int, pace: _Pace) -> ClosingPath:
        """Return the one that serves at a length; the fine one comes back only when it has nothing to catch up on."""
        length, keyframes = max(0.0, pulled_mm), self.fine.keyframes
        still = abs(length - self._last[0]) < _STILL_MM
        self._last = length, stamp_ns
        taking_s, too_slow = pace.keyframes_s(keyframes.missing(length)), pace.why_too_slow(stamp_ns)
        if too_slow:
            self.why = too_slow
        elif self.why and keyframes.covers(length):
            self.why = ""
        elif not self.why and taking_s > _TOO_LONG_S:
            self.why = f"its next shape would take {taking_s:.1f} s"
        waited = to_s(stamp_ns - self._advanced) > _SILENCE_LIMIT_S
        self._has_time = still or (bool(self.why) and (waited or pace.has_free_keyframes))
        self._at_once = min(2 * self._given, _MAX_AT_ONCE) if pace.has_free_keyframes and self._given else 1
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
        prefetch: compute keyframes on a worker from the first tendon state on, of the mounted fingers and then of
            others that may be; False = all wait for the shape that needs them.

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
        prefetch: bool = False,
    ) -> None:
        self._profiles, self._closings = profiles, ClosingCache(profiles)
        tolerance = max(settings.tolerance, _COARSE_TOLERANCE)
        self._settings, self._coarse_settings = settings, replace(settings, resolution=_COARSE, tolerance=tolerance)
        self._prefetches = prefetch
        self._shape_rate, self._marker_rate = _RateLimit(rate_hz), _RateLimit(marker_rate_hz)
        self._shown = tuple(mounted)
        self._friction: ActiveFriction | None = None
        self._made: dict[ClosingKey, _ShownFinger] = {}
        self._fingers: dict[str, _ShownFinger] = {}
        self._pace = _Pace(rate_hz)
        self.mounted: dict[str, str] = {}
        self.set_mounted(mounted)
        self._planned = self._plan()

    @property
    def description(self) -> str:
        """Meshes in words."""
        return ", ".join(f"{slot} {finger.fine.hexahedra} hexahedra" for slot, finger in self._fingers.items())

    def set_mounted(self, mounted: Mapping[str, str]) -> None:
        """Set which profile sits in which slot; slots that are not shown are left out.

        Raises:
            GdfeError, FingerError, ProfileError: unknown profile, or a finger that cannot be simulated; all stays.
        """
        requested = {slot: mounted[slot] for slot in self._shown if slot in mounted}
        if requested == self.mounted:
            return
        self._fingers = {slot: self._finger(profile_id, slot) for slot, profile_id in requested.items()}
        self.mounted = requested
        self._planned = self._plan()
        self._pace.record_new_finger()

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
        self._closings.forget_friction_but(friction)
        self._made = {key: finger for key, finger in self._made.items() if key.friction is friction}
        self._planned = self._plan()

    def close(self) -> None:
        """End the worker with the keyframe that is being computed."""
        self._closings.close()

    def on_tendons(self, names: Sequence[str], samples: Sequence[TendonInput]) -> Iterator[Shown]:
        """Yield the shapes of a tendon state; none when its stamp falls into a period that has been served.

        What there is to catch up on is done when the last has been taken: it makes no shape late.
        """
        if self._prefetches:
            self._closings.prefetch(self._planned)
        if not samples or self._fingers.keys().isdisjoint(names):
            # States that were not shown must not change the session, or a replay would differ.
            return
        stamp = samples[0].stamp
        if not self._shape_rate.accepts(stamp):
            return
        self._pace.record_shape(stamp, self._requested_keyframes())
        marker_due = self._marker_rate.accepts(stamp)
        for name, sample in zip(names, samples, strict=True):
            finger = self._fingers.get(name)
            if finger is None:
                continue
            closing = finger.fine
            if self._settings.resolution != _COARSE:
                closing = finger.choose_closing(1e3 * sample.pulled_length_m, stamp, self._pace)
            shape = closing.shape(sample.pulled_length_m)
            reason = "; ".join(filter(None, (shape.reason, self._pace.why_fewer(), self._coarser(finger))))
            yield Shown(
                finger=name,
                mesh=closing.digest,
                faces=closing.faces,
                hexahedra=closing.hexahedra,
                shape=shape,
                rate_hz=self._pace.rate_hz,
                marker_due=marker_due,
                reason=reason,
                configuration=finger.fine.digest,
            )
        for name in names:
            if name in self._fingers:
                self._fingers[name].catch_up()

    def _requested_keyframes(self) -> int:
        """Return how many shapes have requested, without the undeformed states, which take no time."""
        return sum(max(0, finger.fine.keyframes.requested - 1) for finger in self._made.values())

    def _coarser(self, finger: _ShownFinger) -> str:
        if not finger.why or finger.coarse is None:
            return ""
        return f"coarser mesh ({finger.coarse.hexahedra} instead of {finger.fine.hexahedra} hexahedra): {finger.why}"

    def _finger(self, profile_id: str, slot: str) -> _ShownFinger:
        key = ClosingKey(profile_id, slot, self._settings, self._friction)
        if key not in self._made:
            coarse = replace(key, settings=self._coarse_settings)
            self._made[key] = _ShownFinger(self._closings.get(key), partial(self._closings.get, coarse))
        return self._made[key]

    def _plan(self) -> tuple[ClosingKey, ...]:
        """Return what to prefetch: what is mounted, first what serves when time is short; then what may be."""
        mounted = list(self.mounted.items())
        others = [(slot, profile) for slot in self._shown for profile in sorted(self._profiles)]
        others = [other for other in others if other not in mounted][:_MAX_PREFETCHED_OTHERS]
        short = [] if self._settings.resolution == _COARSE else [(*finger, self._coarse_settings) for finger in mounted]
        asked = [(*finger, self._settings) for finger in mounted + others]
        return tuple(ClosingKey(profile, slot, settings, self._friction) for slot, profile, settings in short + asked)
