# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from softgrip_bag.latency import link, links, missing
from softgrip_bag.offers import OfferedQos
from softgrip_bag.writer import BagWriter, Topic

MS = 1_000_000


def stamped(stamp: int) -> bytes:
    """Return the CDR of a std_msgs/Header with an empty frame."""
    seconds, rest = divmod(stamp, 1_000_000_000)
    return b"\0\1\0\0" + struct.pack("<iI", seconds, rest) + b"\1\0\0\0\0"


def test_latency_is_from_the_sources_publication_and_from_the_stamp() -> None:
    sources = np.array([[10 * k * MS, (10 * k + 1) * MS] for k in range(101)])
    results = np.array([[10 * k * MS, (10 * k + 3) * MS] for k in range(101) if k != 50])
    found = link("/a", "/b", sources, results)
    assert (found.matched, found.unanswered) == (100, 1)
    assert found.from_publication == pytest.approx((0.002, 0.002, 0.002))
    assert found.from_stamp == pytest.approx((0.003, 0.003, 0.003))


def test_percentiles_are_those_of_the_distribution() -> None:
    sources = np.array([[k, 0] for k in range(101)])
    results = np.array([[k, k * MS] for k in range(101)])
    assert link("/a", "/b", sources, results).from_publication == pytest.approx((0.050, 0.095, 0.099))


def test_of_several_results_the_last_counts() -> None:
    found = link("/a", "/b", np.array([[5, 0]]), np.array([[5, 1 * MS], [5, 4 * MS], [5, 2 * MS]]))
    assert found.from_publication == pytest.approx((0.004,) * 3)


def test_a_source_without_results_is_named_with_nothing_matched() -> None:
    found = link("/a", "/b", np.array([[5, 0]]), np.array([[6, 0]]))
    assert found.matched == 0
    assert np.isnan(found.from_stamp).all()


def test_missing_frames_are_the_gaps_in_the_period() -> None:
    stamps = np.array([[33 * MS * k, 0] for k in range(100) if k not in (10, 11, 60)])
    assert missing(stamps) == 3
    assert missing(np.array([[33 * MS * k + (k % 3) * MS, 0] for k in range(100)])) == 0


def test_links_of_a_bag_come_from_its_topics(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    schema = "# a comment\nstd_msgs/Header header\n"
    for name in ("/tendon/state", "/finger/predicted", "/camera/image_raw"):
        bag.add_topic(Topic(name, "sensor_msgs/msg/JointState", "", schema, (OfferedQos(),)))
    for k in range(10):
        stamp = 1_700_000_000_123_456_789 + 10 * MS * k
        bag.write("/tendon/state", stamp + 2 * MS, stamp + MS, stamped(stamp))
        bag.write("/finger/predicted", stamp + 4 * MS, stamp + 3 * MS, stamped(stamp))
    found = links(bag.close())
    assert [(item.source, item.result, item.matched) for item in found] == [("/tendon/state", "/finger/predicted", 10)]
    assert found[0].from_publication == pytest.approx((0.002,) * 3)
    assert found[0].from_stamp == pytest.approx((0.003,) * 3)
