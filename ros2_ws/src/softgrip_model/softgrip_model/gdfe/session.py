# SPDX-License-Identifier: Apache-2.0
"""Which fingers are shown, when, and at what rate: decided from the stamps of the tendon states alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.matching import TendonSample
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.gdfe.closing import Closing, ClosingSettings, Shape
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.profile import Profile, digest

#: Share of the last interval in the stated rate.
_RATE_SMOOTHING = 0.2
#: Below this share of the rate asked for, the shapes are said to be coarser in time.
_COARSER = 0.8
#: [s] A longer gap between states that solving does not account for is a pause: the rate is counted anew.
_PAUSE = 1.0


@dataclass(frozen=True, eq=False)
class Shown:
    """One shape to publish."""

    finger: str
    mesh: str
    faces: NDArray[np.uint32]
    hexahedra: int
    shape: Shape
    rate_hz: float
    """At which this finger's shapes are being computed; NaN until there are two."""
    marker_due: bool
    reason: str
    """Why not converged, what to know of the material, or that shapes come at less than the rate asked for."""


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


class ShapeSession:
    """The mounted fingers and their shapes.

    Args:
        profiles: by id.
        mounted: slot -> profile id of the fingers that are shown.
        settings: of every closing.
        rate_hz: shapes per second of stamp time at most.
        marker_rate_hz: markers likewise; 0 = none.

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
    ) -> None:
        self._profiles, self._settings = profiles, settings
        self._wanted_rate = rate_hz
        self._slots, self._marker_slots = _Slots(rate_hz), _Slots(marker_rate_hz)
        self._shown = tuple(mounted)
        self._friction: ActiveFriction | None = None
        self._made: dict[tuple[str, str, str], Closing] = {}
        self._closings: dict[str, Closing] = {}
        self._last_stamp: int | None = None
        self._rate = math.nan
        self._busy = 0.0
        self.mounted: dict[str, str] = {}
        self.set_mounted(mounted)

    @property
    def description(self) -> str:
        """Meshes in words."""
        return ", ".join(f"{slot} {closing.hexahedra} hexahedra" for slot, closing in self._closings.items())

    def set_mounted(self, mounted: Mapping[str, str]) -> None:
        """Say which profile sits in which slot; slots that are not shown are left out.

        Raises:
            GdfeError, FingerError, ProfileError: unknown profile, or a finger that cannot be simulated; all stays.
        """
        wanted = {slot: mounted[slot] for slot in self._shown if slot in mounted}
        if wanted == self.mounted:
            return
        self._closings = {slot: self._closing(profile_id, slot) for slot, profile_id in wanted.items()}
        self.mounted = wanted

    @property
    def friction_id(self) -> str:
        """The calibrated friction model in use; empty while every profile has its own."""
        return self._friction.id if self._friction else ""

    def set_friction(self, friction: ActiveFriction) -> None:
        """Compute with a calibrated friction model from now on, whatever profiles name.

        Raises:
            GdfeError: a finger cannot be simulated with it; all stays.
        """
        if self._friction is not None and (friction.id, friction.law) == (self._friction.id, self._friction.law):
            return
        before, self._friction = self._friction, friction
        try:
            self._closings = {slot: self._closing(profile_id, slot) for slot, profile_id in self.mounted.items()}
        except GdfeError:
            self._friction = before
            raise

    def on_tendons(self, names: Sequence[str], samples: Sequence[TendonSample]) -> list[Shown]:
        """Return the shapes of a tendon state; none when its stamp falls into a period that has been served."""
        if not samples or not self._slots.takes(samples[0].stamp):
            return []
        stamp = samples[0].stamp
        self._note_rate(stamp)
        marker_due = self._marker_slots.takes(stamp)
        shown = []
        for name, sample in zip(names, samples, strict=True):
            closing = self._closings.get(name)
            if closing is None:
                continue
            shape = closing.shape(sample.pulled_length)
            reason = "; ".join(filter(None, (shape.reason, self._coarser())))
            shown.append(
                Shown(name, closing.digest, closing.faces, closing.hexahedra, shape, self._rate, marker_due, reason)
            )
        self._busy = sum(one.shape.solve_time for one in shown)
        return shown

    def _coarser(self) -> str:
        if not self._rate < _COARSER * self._wanted_rate:
            return ""
        return f"{self._rate:.1f} Hz instead of {self._wanted_rate:g} Hz: states come, or are solved, more slowly"

    def _note_rate(self, stamp: int) -> None:
        gap = 0.0 if self._last_stamp is None else 1e-9 * (stamp - self._last_stamp)
        if gap > max(_PAUSE, 2.0 * self._busy):
            self._rate = math.nan
        elif gap > 0.0:
            now = 1.0 / gap
            self._rate = now if math.isnan(self._rate) else self._rate + _RATE_SMOOTHING * (now - self._rate)
        self._last_stamp = stamp

    def _closing(self, profile_id: str, slot: str) -> Closing:
        profile = self._profiles.get(profile_id)
        if profile is None:
            raise GdfeError(
                f"slot {slot!r}: unknown profile {profile_id!r}; loaded: {', '.join(sorted(self._profiles)) or 'none'}"
            )
        key = (digest(profile), slot, repr(self._friction and (self._friction.id, self._friction.law)))
        if key not in self._made:
            self._made[key] = Closing(profile, slot, self._settings, friction=self._friction)
        return self._made[key]
