# SPDX-License-Identifier: Apache-2.0
"""Closings of the fingers that are or may be shown, each made once, by whichever thread needs it first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import Resolution
from softgrip_model.profile import Profile

T = TypeVar("T")


@dataclass(frozen=True)
class ClosingKey:
    """Which closing: of which finger, how computed.

    Attributes:
        profile_id: of the finger.
        slot: it sits in.
        settings: of the closing.
        friction: the calibrated model in use; None = the one that the profile names.
    """

    profile_id: str
    slot: str
    settings: ClosingSettings
    friction: ActiveFriction | None


class _Lazy(Generic[T]):
    """Something that one thread makes while others wait for it; made anew where that failed."""

    def __init__(self, make: Callable[[], T]) -> None:
        self._make = make
        self._made: T | None = None
        self._lock = threading.Lock()

    def get(self) -> T:
        with self._lock:
            if self._made is None:
                self._made = self._make()
            return self._made


class ClosingCache:
    """What has been made of the profiles, for any thread.

    Args:
        profiles: by id.
    """

    def __init__(self, profiles: Mapping[str, Profile]) -> None:
        self._profiles = profiles
        self._lock = threading.Lock()
        self._bodies: dict[tuple[str, str, Resolution], _Lazy[Body]] = {}
        self._closings: dict[ClosingKey, _Lazy[ClosingPath]] = {}

    def get(self, requested: ClosingKey) -> ClosingPath:
        """Return a closing; one finger's share its mesh and matrix, whatever the friction.

        Raises:
            GdfeError, FingerError, ProfileError: unknown profile, or a finger that cannot be simulated.
        """
        with self._lock:
            once = self._closings.setdefault(requested, _Lazy(lambda: self._make(requested)))
        return once.get()

    def keep(self, friction: ActiveFriction | None) -> None:
        """Forget the closings with another friction model; what they were made of stays."""
        with self._lock:
            self._closings = {
                requested: once for requested, once in self._closings.items() if requested.friction is friction
            }

    def _make(self, requested: ClosingKey) -> ClosingPath:
        profile = self._profiles.get(requested.profile_id)
        if profile is None:
            raise GdfeError(
                f"slot {requested.slot!r}: unknown profile {requested.profile_id!r}; "
                f"loaded: {', '.join(sorted(self._profiles)) or 'none'}"
            )
        slot, resolution = requested.slot, requested.settings.resolution
        with self._lock:
            body = self._bodies.setdefault(
                (requested.profile_id, slot, resolution), _Lazy(lambda: Body(profile, slot, resolution))
            )
        return ClosingPath(profile, slot, requested.settings, friction=requested.friction, body=body.get())
