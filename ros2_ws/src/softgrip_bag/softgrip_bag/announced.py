# SPDX-License-Identifier: Apache-2.0
"""Which type a topic is recorded with when more than one is announced for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence


def publishers_type(publishers: Sequence[str]) -> str:
    """Return the type that most publishers of a topic announce; of as many, the first by name.

    Args:
        publishers: type of each, at least one.
    """
    counts = Counter(publishers)
    return min(counts, key=lambda name: (-counts[name], name))


def type_conflict(recorded: str, publishers: Sequence[str], announced: Sequence[str]) -> str:
    """Return what is wrong with the types of a topic, empty when there is only the recorded one.

    Args:
        recorded: the type that the topic is recorded with.
        publishers: type of each publisher.
        announced: all types that publishers and subscriptions announce.
    """
    others = sorted({*publishers, *announced} - {recorded})
    if not others:
        return ""
    lost = sum(name != recorded for name in publishers)
    who = f"{lost} publishers of it are not recorded" if lost else "only subscriptions announce it"
    return f"recorded as {recorded}; also announced: {', '.join(others)} ({who}); stop the tool of another version"
