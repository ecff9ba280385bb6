# SPDX-License-Identifier: Apache-2.0
"""A camera that starts, and one that never delivers."""

from __future__ import annotations

from softgrip_vision.frame_watch import FirstFrameWatch


def test_the_limit_counts_from_the_first_question() -> None:
    watch = FirstFrameWatch(10.0)
    assert [bool(watch.problem(now)) for now in (1000.0, 1009.9, 1010.1)] == [False, False, True]
    assert watch.problem(1011.0).startswith("expected a first frame within 10 s, found none; check camera")
