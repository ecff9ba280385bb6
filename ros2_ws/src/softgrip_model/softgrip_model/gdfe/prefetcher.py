# SPDX-License-Identifier: Apache-2.0
"""Keyframes of fingers that are or may be mounted, computed on a thread of their own before shapes need them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from softgrip_model.finger.errors import FingerError
from softgrip_model.gdfe.closing_cache import ClosingCache, ClosingKey
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.profile import ProfileError


class KeyframePrefetcher:
    """Works through closings while shapes are being made of them.

    What it has computed changes no shape and no decision about one, only how long they take: a replay may do without.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="keyframes")
        self._requested: tuple[ClosingKey, ...] = ()

    def want(self, requested: Sequence[ClosingKey], closings: ClosingCache) -> None:
        """Work on these from now on, in this order, and no longer on others."""
        if requested is self._requested:
            return
        self._requested = tuple(requested)
        self._pool.submit(self._work, self._requested, closings)

    def close(self) -> None:
        """End with the keyframe that is being computed."""
        self._requested = ()
        self._pool.shutdown()

    def _work(self, all_requested: tuple[ClosingKey, ...], closings: ClosingCache) -> None:
        for requested in all_requested:
            if all_requested is not self._requested:
                return
            try:
                closing = closings.get(requested)
            except (GdfeError, FingerError, ProfileError):
                continue  # said where it is mounted
            if closing.keyframes.complete:
                continue
            solver = closing.body.new_solver()
            while all_requested is self._requested and closing.work_ahead(solver):
                pass
