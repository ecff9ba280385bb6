# SPDX-License-Identifier: Apache-2.0
"""Keyframes of the mounted fingers, computed on a thread of their own before shapes need them."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

from softgrip_model.gdfe.closing import Closing


class Ahead:
    """Works through closings while shapes are being made of them.

    What it has computed changes no shape and no decision about one, only how long they take: a replay may do without.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="keyframes")
        self._wanted: tuple[Closing, ...] = ()

    def want(self, closings: Iterable[Closing]) -> None:
        """Work on these from now on, and no longer on others."""
        wanted = tuple(closings)
        if wanted == self._wanted:
            return
        self._wanted = wanted
        self._pool.submit(self._work, wanted)

    def close(self) -> None:
        """End with the keyframe that is being computed."""
        self._wanted = ()
        self._pool.shutdown()

    def _work(self, wanted: tuple[Closing, ...]) -> None:
        for closing in wanted:
            if wanted is not self._wanted or closing.keyframes.complete:
                continue
            solver = closing.body.new_solver()
            while wanted is self._wanted and closing.work_ahead(solver):
                pass
