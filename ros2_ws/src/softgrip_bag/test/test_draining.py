# SPDX-License-Identifier: Apache-2.0
"""A recording that is stopped while messages wait in the middleware."""

from __future__ import annotations

from softgrip_bag.draining import Drain


def test_it_goes_on_while_something_sent_before_still_comes() -> None:
    drain = Drain(moment=100, limit=10_000)
    looks = 0
    for published in [*range(10, 100, 10), 100, 110, 120, 130, 140]:
        drain.see(published)
        looks += 1
        if drain.look(now=published):
            break
    assert published == 110  # the second look that found nothing old
    assert looks == 11


def test_one_quiet_look_is_not_enough() -> None:
    drain = Drain(moment=100, limit=10_000)
    assert not drain.look(now=101)
    assert drain.see(99)
    assert not drain.see(100)  # belongs to the recording no more
    assert [drain.look(now=102) for _ in range(3)] == [False, False, True]


def test_it_ends_at_its_limit_whatever_comes() -> None:
    drain = Drain(moment=100, limit=200)
    drain.see(50)
    assert not drain.look(now=200)
    drain.see(50)
    assert drain.look(now=201)
