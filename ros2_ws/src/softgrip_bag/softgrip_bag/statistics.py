# SPDX-License-Identifier: Apache-2.0
"""Rates, gaps and latencies of the topics of a bag."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_bag.reader import read, topic_summaries
from softgrip_time.units import to_s

PERCENTILES = (50, 95, 99)


@dataclass(frozen=True)
class TopicStatistics:
    """One topic.

    Attributes:
        received: (messages,) times of reception [ns since the epoch].
        size: [byte] of all messages.
        rate: [Hz] messages per second between the first and the last; NaN with fewer than two.
        longest_gap: [s] between two receptions; NaN with fewer than two.
        latency: [s] from publishing to reception, p50, p95, p99; NaN without messages.
    """

    name: str
    type_name: str
    messages: int
    size: int
    received: NDArray[np.int64]
    rate: float
    longest_gap: float
    latency: tuple[float, float, float]


@dataclass(frozen=True)
class BagStatistics:
    """A whole bag: ``start`` [ns since the epoch], ``duration`` [s]."""

    start: int
    duration: float
    messages: int
    topics: list[TopicStatistics]


def statistics(bag: Path) -> BagStatistics:
    """Return the statistics of a bag, topics by name.

    Raises:
        BagError: no bag, or no MCAP.
    """
    received: dict[str, list[int]] = defaultdict(list)
    published: dict[str, list[int]] = defaultdict(list)
    sizes: dict[str, int] = defaultdict(int)
    for message in read(bag):
        received[message.topic].append(message.received)
        published[message.topic].append(message.published)
        sizes[message.topic] += len(message.data)
    topics = [
        _topic(topic.name, topic.type_name, sizes.get(topic.name, 0), received[topic.name], published[topic.name])
        for topic in topic_summaries(bag)
    ]
    times = [time for times in received.values() if times for time in (times[0], times[-1])]
    start, end = (min(times), max(times)) if times else (0, 0)
    return BagStatistics(start, to_s(end - start), sum(topic.messages for topic in topics), topics)


def _topic(name: str, type_name: str, size: int, received: list[int], published: list[int]) -> TopicStatistics:
    times = np.array(received, dtype=np.int64)
    rate = longest_gap = float("nan")
    latency = (float("nan"),) * 3
    if len(times):
        delays = np.percentile(to_s(times - np.array(published, dtype=np.int64)), PERCENTILES)
        latency = (float(delays[0]), float(delays[1]), float(delays[2]))
    if len(times) > 1:
        longest_gap = to_s(int(np.diff(times).max()))
        covered = to_s(int(times[-1] - times[0]))
        rate = (len(times) - 1) / covered if covered > 0 else float("nan")
    return TopicStatistics(name, type_name, len(times), size, times, rate, longest_gap, latency)
