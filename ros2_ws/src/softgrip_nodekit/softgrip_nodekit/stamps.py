# SPDX-License-Identifier: Apache-2.0
"""Between builtin_interfaces/Time and plain numbers."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time

from softgrip_time.units import NANOSECONDS, to_s


def seconds(stamp: Time | Duration) -> float:
    """Return a stamp as seconds [s] since its clock's epoch, or a duration as seconds [s]."""
    return float(stamp.sec + to_s(stamp.nanosec))


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as nanoseconds [ns] since its clock's epoch."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def to_time_message(since_epoch_ns: int) -> Time:
    """Return nanoseconds since the epoch as a message."""
    whole, rest = divmod(since_epoch_ns, NANOSECONDS)
    return Time(sec=whole, nanosec=rest)
