# SPDX-License-Identifier: Apache-2.0
"""How long after a message another one computed from it was published: both carry the same stamp."""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.reader import TopicSummary, read, topic_summaries
from softgrip_time.units import NANOSECONDS, to_s

#: Every result and what it is computed from; where there are several, the first that is in the bag.
LINKS = (
    ("/finger/predicted", ("/tendon/state",)),
    ("/shape/predicted", ("/tendon/state",)),
    ("/finger/markers", ("/camera/image_raw/compressed", "/camera/image_raw")),
    ("/finger/measured", ("/camera/image_raw/compressed", "/camera/image_raw")),
)
PERCENTILES = (50, 95, 99)
_STAMP = struct.Struct("<iI")
_ENCAPSULATION = 4  # bytes of CDR before the first field
_HEADER_FIRST = re.compile(r"\A(?:\s*(?:#.*)?\n)*\s*std_msgs/Header\s")
#: A gap between two stamps longer than this many periods is a missing message.
_GAP = 1.5

Stamps = NDArray[np.int64]  # (messages, 2): header.stamp and time of publication [ns]


@dataclass(frozen=True)
class Link:
    """One way through a node, times in s: p50, p95, p99.

    Attributes:
        matched: stamps that are on both topics.
        unanswered: sources between the first and the last result that no result belongs to.
        from_publication: from the publication of the source to that of the result.
        from_stamp: from the stamp (the instant that was measured) to the publication of the result.
    """

    source: str
    result: str
    matched: int
    unanswered: int
    from_publication: tuple[float, ...]
    from_stamp: tuple[float, ...]


def links(bag: Path) -> list[Link]:
    """Return every link of `LINKS` whose topics are in a bag.

    Raises:
        BagError: no bag, or no MCAP.
    """
    topics = {topic.name: topic for topic in topic_summaries(bag) if topic.messages and has_header(topic)}
    cell = cell_namespace(topics)
    requested = []
    for result, sources in LINKS:
        source = next((cell + name for name in sources if cell + name in topics), None)
        if source is not None and cell + result in topics:
            requested.append((source, cell + result))
    stamps = read_stamps(bag, {name for pair in requested for name in pair})
    return [link(source, result, stamps[source], stamps[result]) for source, result in requested]


def has_header(topic: TopicSummary) -> bool:
    """Return whether the first field of a topic's messages is a std_msgs/Header."""
    return _HEADER_FIRST.match(topic.schema) is not None


def read_stamps(bag: Path, topics: set[str]) -> dict[str, Stamps]:
    """Return stamps and times of publication of topics with a header, in order of reception."""
    found: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for message in read(bag, topics):
        seconds, nanoseconds = _STAMP.unpack_from(message.data, _ENCAPSULATION)
        found[message.topic].append((seconds * NANOSECONDS + nanoseconds, message.published))
    return {topic: np.array(found[topic], dtype=np.int64).reshape(-1, 2) for topic in topics}


def link(source: str, result: str, sources: Stamps, results: Stamps) -> Link:
    """Return the link between two topics; of several results with one stamp the last one counts."""
    published = dict(sources.tolist())
    last: dict[int, int] = {}
    for stamp, at in results.tolist():
        last[stamp] = max(at, last.get(stamp, at))
    both = [stamp for stamp in last if stamp in published]
    between = [stamp for stamp in published if last and min(last) <= stamp <= max(last)]
    from_publication = [to_s(last[stamp] - published[stamp]) for stamp in both]
    from_stamp = [to_s(last[stamp] - stamp) for stamp in both]
    return Link(
        source,
        result,
        len(both),
        sum(stamp not in last for stamp in between),
        _percentiles(from_publication),
        _percentiles(from_stamp),
    )


def missing(stamps: Stamps) -> int:
    """Return how many messages of a periodic source are missing, by the gaps between its stamps."""
    if len(stamps) < 3:
        return 0
    steps = np.diff(np.sort(stamps[:, 0]))
    period = float(np.median(steps))
    return int(sum(round(step / period) - 1 for step in steps if step > _GAP * period)) if period > 0 else 0


def _percentiles(values: list[float]) -> tuple[float, ...]:
    if not values:
        return (float("nan"),) * len(PERCENTILES)
    return tuple(float(value) for value in np.percentile(values, PERCENTILES))
