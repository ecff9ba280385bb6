# SPDX-License-Identifier: Apache-2.0
"""Between builtin_interfaces/Time and plain numbers."""

from builtin_interfaces.msg import Time

NANOSECONDS = 1_000_000_000


def seconds(stamp: Time) -> float:
    """Return a stamp as seconds [s] since its clock's epoch."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def to_time_message(nanoseconds: int) -> Time:
    """Return nanoseconds since the epoch as a message."""
    whole, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=whole, nanosec=rest)
