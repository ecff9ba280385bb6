# SPDX-License-Identifier: Apache-2.0
"""The order of publication of what a recorder took late."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

from softgrip_bag.reader import RawMessage, in_order

SECOND = 1_000_000_000


def message(topic: str, published: int, received: int) -> RawMessage:
    return RawMessage(topic, "std_msgs/msg/String", received, published, b"")


def test_a_topic_that_the_recorder_took_12_s_late_comes_where_it_was_published() -> None:
    slow = [message("/slow", t * SECOND // 100, t * SECOND // 100 + 12 * SECOND) for t in range(2000)]
    quick = [message("/quick", t * SECOND // 30, t * SECOND // 30 + 1000) for t in range(600)]
    received = sorted([*slow, *quick], key=lambda m: m.received)
    assert [m.published for m in received] != sorted(m.published for m in received)
    assert list(in_order(received)) == sorted(received, key=lambda m: m.published)


def test_messages_with_lags_up_to_the_limit_come_in_order_and_none_is_lost() -> None:
    rng = Random(3)
    sent = [message(f"/{n % 3}", n * 1000, n * 1000 + rng.randint(0, 50_000)) for n in range(500)]
    received = sorted(sent, key=lambda m: m.received)
    assert list(in_order(received, lag_ns=50_000)) == sent


def test_without_a_time_of_publication_the_order_of_reception_stays() -> None:
    received = [message("/a", 0, (100 + n) * SECOND) for n in range(50)]
    assert [m.received for m in in_order(received)] == [m.received for m in received]


def test_no_more_waits_than_the_limit_needs() -> None:
    taken = 0

    def endless() -> Iterator[RawMessage]:
        nonlocal taken
        while True:
            taken += 1
            yield message("/a", taken * SECOND, taken * SECOND)

    ordered = in_order(endless(), lag_ns=5 * SECOND)
    assert next(ordered).published == SECOND
    assert taken <= 7
