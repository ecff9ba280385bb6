# SPDX-License-Identifier: Apache-2.0
"""Closings of the fingers that are or may be shown: each made once, and their keyframes prefetched by one worker."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import Resolution
from softgrip_model.profile import Profile, ProfileError

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


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


class ClosingCache:
    """What has been made of the profiles, for any thread, and a worker that computes keyframes before shapes need them.

    What the worker has computed changes no shape and no decision about one, only how long they take: a replay may do
    without.

    Args:
        profiles: by id.
    """

    def __init__(self, profiles: Mapping[str, Profile]) -> None:
        self._profiles = profiles
        self._lock = threading.Lock()
        self._bodies: dict[tuple[str, str, Resolution], Future[Body]] = {}
        self._closings: dict[ClosingKey, Future[ClosingPath]] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="keyframes")
        self._prefetched: tuple[ClosingKey, ...] = ()

    def get(self, key: ClosingKey) -> ClosingPath:
        """Return a closing; one finger's share its mesh and matrix, whatever the friction.

        Raises:
            GdfeError, FingerError, ProfileError: unknown profile, or a finger that cannot be simulated.
        """
        return self._get_or_make(self._closings, key, lambda: self._make(key))

    def forget_friction_but(self, friction: ActiveFriction | None) -> None:
        """Forget the closings with another friction model; what they were made of stays."""
        with self._lock:
            self._closings = {key: made for key, made in self._closings.items() if key.friction is friction}

    def prefetch(self, keys: Sequence[ClosingKey]) -> None:
        """Compute the keyframes of these from now on, in this order, and no longer those of others."""
        if keys is self._prefetched:
            return
        self._prefetched = tuple(keys)
        self._worker.submit(self._work, self._prefetched)

    def close(self) -> None:
        """End the worker with the keyframe that is being computed."""
        self._prefetched = ()
        self._worker.shutdown()

    def _work(self, keys: tuple[ClosingKey, ...]) -> None:
        for key in keys:
            if keys is not self._prefetched:
                return
            try:
                closing = self.get(key)
            except (GdfeError, FingerError, ProfileError):
                continue  # reported where it is mounted
            if closing.keyframes.complete:
                continue
            solver = closing.body.new_solver()
            while keys is self._prefetched and closing.prefetch(solver):
                pass

    def _make(self, key: ClosingKey) -> ClosingPath:
        profile = self._profiles.get(key.profile_id)
        if profile is None:
            raise GdfeError(
                f"slot {key.slot!r}: unknown profile {key.profile_id!r}; "
                f"loaded: {', '.join(sorted(self._profiles)) or 'none'}"
            )
        resolution = key.settings.resolution
        body = self._get_or_make(
            self._bodies, (key.profile_id, key.slot, resolution), lambda: Body(profile, key.slot, resolution)
        )
        return ClosingPath(profile, key.slot, key.settings, friction=key.friction, body=body)

    def _get_or_make(self, table: dict[K, Future[V]], key: K, make: Callable[[], V]) -> V:
        """Return what one thread makes while others wait for it; it is made again where that failed."""
        with self._lock:
            made = table.get(key)
            is_mine = made is None
            if made is None:
                made = table[key] = Future()
        if is_mine:
            try:
                made.set_result(make())
            except BaseException as error:
                with self._lock:
                    table.pop(key, None)
                made.set_exception(error)
                raise
        return made.result()
