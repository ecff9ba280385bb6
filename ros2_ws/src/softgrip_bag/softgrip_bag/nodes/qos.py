# SPDX-License-Identifier: Apache-2.0
"""Between rclpy's QoS and what a bag stores of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from softgrip_bag.offers import OfferedQos


def offered(profile: QoSProfile) -> OfferedQos:
    """Return a publisher's QoS as the bag stores it."""
    return OfferedQos(
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        history="keep_all" if profile.history == HistoryPolicy.KEEP_ALL else "keep_last",
        depth=int(profile.depth),
    )


def matching(qos: Sequence[OfferedQos], depth: int) -> QoSProfile:
    """Return a subscription's QoS that every one of the publishers can serve."""
    reliable = all(o.reliability == "reliable" for o in qos)
    latched = all(o.durability == "transient_local" for o in qos)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def recorded(qos: Sequence[Mapping[str, object]]) -> QoSProfile:
    """Return the QoS to play a topic with: what its first publisher offered, as the bag stores it."""
    offer = OfferedQos.from_map(qos[0]) if qos else OfferedQos()
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if offer.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=max(1, offer.depth),
        reliability=(
            ReliabilityPolicy.BEST_EFFORT if offer.reliability == "best_effort" else ReliabilityPolicy.RELIABLE
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if offer.durability == "transient_local" else DurabilityPolicy.VOLATILE
        ),
    )
