# SPDX-License-Identifier: Apache-2.0
"""What the publishers of a topic offer: types, of which a topic is recorded with one, and QoS as rosbag2 writes it.

QoS is in words, as in bag metadata version 9.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: rmw keeps it in 32 bits; so many messages no publisher keeps
MAX_DEPTH = 2**31 - 1
INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class OfferedQos:
    """What a publisher offers, as far as a subscription must match it."""

    reliability: str = "reliable"  # or "best_effort"
    durability: str = "volatile"  # or "transient_local"
    history: str = "keep_last"  # or "keep_all"
    depth: int = 10

    @classmethod
    def from_map(cls, values: Mapping[str, Any]) -> OfferedQos:
        """Return what a bag's mapping says; words since metadata version 9, rmw's numbers before; else the default."""
        depth = values.get("depth")
        return cls(
            reliability=_word(values.get("reliability"), {2: "best_effort"}, "reliable"),
            durability=_word(values.get("durability"), {1: "transient_local"}, "volatile"),
            history=_word(values.get("history"), {2: "keep_all"}, "keep_last"),
            depth=depth if isinstance(depth, int) and 0 < depth <= MAX_DEPTH else cls.depth,
        )

    def as_map(self) -> dict[str, object]:
        """Return the mapping that rosbag2 stores."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(INFINITE),
            "lifespan": dict(INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(INFINITE),
            "avoid_ros_namespace_conventions": False,
        }


def _word(value: Any, numbers: Mapping[int, str], default: str) -> str:
    if isinstance(value, str):
        return value if value in {*numbers.values(), default} else default
    return numbers.get(value, default) if isinstance(value, int) else default


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
