# SPDX-License-Identifier: Apache-2.0
"""A recording that is stopped while messages wait in the middleware."""

from __future__ import annotations

from softgrip_bag.arrivals import Drain


def test_it_goes_on_while_something_sent_before_still_comes() -> None:
    drain = Drain(moment=100, limit=10_000)
    polls = 0
    for published in [*range(10, 100, 10), *range(100, 300, 10)]:
        drain.admit_message(published)
        polls += 1
        if drain.check_quiet(now=published):
            break
    assert published == 140  # the fifth look that found nothing old
    assert polls == 14


def test_a_quiet_look_or_two_are_not_enough() -> None:
    drain = Drain(moment=100, limit=10_000)
    assert not any(drain.check_quiet(now=101) for _ in range(4))
    assert drain.admit_message(99)
    assert not drain.admit_message(100)  # belongs to the recording no more
    assert [drain.check_quiet(now=102) for _ in range(6)] == [*[False] * 5, True]


def test_it_ends_at_its_limit_whatever_comes() -> None:
    drain = Drain(moment=100, limit=200)
    drain.admit_message(50)
    assert not drain.check_quiet(now=200)
    drain.admit_message(50)
    assert drain.check_quiet(now=201)
