# SPDX-License-Identifier: Apache-2.0
"""What buses behind a plain serial port have in common: the port, its clock, and what was seen."""

from __future__ import annotations

import threading

from softgrip_driver.serial_link import SerialLink
from softgrip_driver.tendon.backend import Counters
from softgrip_time import Clock


class SerialBus:
    """One port and what went over it; transactions are a subclass's.

    Args:
        path: device path.
        baud: [1/s]
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(self, path: str, baud: int, reply_margin: float, clock: Clock | None = None) -> None:
        self.link = SerialLink(path, baud, reply_margin, clock)
        self.clock = self.link.clock
        self.counters = Counters()
        self._lock = threading.RLock()

    @property
    def is_open(self) -> bool:
        """Whether the port is there."""
        return self.link.is_open

    def open(self) -> None:
        """Open the port; raises PortLostError."""
        self.link.open()

    def close(self) -> None:
        """Close the port; never raises."""
        self.link.close()

    def _count_lost(self, device_id: int) -> None:
        self.counters.lost += 1
        self.counters.lost_by_id[device_id] = self.counters.lost_by_id.get(device_id, 0) + 1
