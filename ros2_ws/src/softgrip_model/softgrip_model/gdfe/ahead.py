# SPDX-License-Identifier: Apache-2.0
"""Keyframes of fingers that are or may be mounted, computed on a thread of their own before shapes need them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from softgrip_model.finger.errors import FingerError
from softgrip_model.gdfe.closings import Closings, Wanted
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.profile import ProfileError


class Ahead:
    """Works through closings while shapes are being made of them.

    What it has computed changes no shape and no decision about one, only how long they take: a replay may do without.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="keyframes")
        self._wanted: tuple[Wanted, ...] = ()

    def want(self, wanted: Sequence[Wanted], closings: Closings) -> None:
        """Work on these from now on, in this order, and no longer on others."""
        if wanted is self._wanted:
            return
        self._wanted = tuple(wanted)
        self._pool.submit(self._work, self._wanted, closings)

    def close(self) -> None:
        """End with the keyframe that is being computed."""
        self._wanted = ()
        self._pool.shutdown()

    def _work(self, all_wanted: tuple[Wanted, ...], closings: Closings) -> None:
        for wanted in all_wanted:
            if all_wanted is not self._wanted:
                return
            try:
                closing = closings.get(wanted)
            except (GdfeError, FingerError, ProfileError):
                continue  # said where it is mounted
            if closing.keyframes.complete:
                continue
            solver = closing.body.new_solver()
            while all_wanted is self._wanted and closing.work_ahead(solver):
                pass
