# SPDX-License-Identifier: Apache-2.0
"""What backends of drives on one bus have in common, whatever the family: presence, ends of a connection, probing."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from softgrip_driver.errors import ConfigurationError, CorruptReplyError, DriverError, NoReplyError, PortLostError
from softgrip_driver.tendon.backend import Counters, DriveReading
from softgrip_driver.usb_adapter import FACTORY_LATENCY_S, LATENCY_REMEDY, SLOW_ADAPTER_S, latency_timer
from softgrip_time import Clock

#: misses in a row after which a drive is left out of the question to all
MISSES = 3
#: [s] between questions to one that is left out: often at first (a bad line), then seldom (a dead drive)
PROBE_FIRST, PROBE_PERIOD = 0.01, 0.25


class DriveBus(Protocol):
    """What this needs of a bus."""

    counters: Counters

    @property
    def clock(self) -> Clock:
        """That its waits are on."""

    @property
    def is_open(self) -> bool:
        """Whether its port is there."""

    @property
    def port_name(self) -> str:
        """Device path of the port."""

    def open(self) -> None:
        """Open the port; raises PortLostError."""

    def close(self) -> None:
        """Close it; never raises."""

    def turnaround(self, device_id: int, /) -> float:
        """Return how long [s] a drive's replies take beyond the time of their bytes.

        Raises:
            NoReplyError, CorruptReplyError: it does not answer.
        """

    def allow_lateness(self, turnaround: float) -> None:
        """From now on wait for replies as long as an adapter keeps them back that took so long [s]."""


@dataclass(kw_only=True)
class BusDevice(ABC):
    """What is known of a drive while the loop runs.

    Attributes:
        misses: in a row; absent: there were too many.
        probe_at, probe_wait: [s] when an absent one is asked next, and the wait before that.
        powered, mark: None: not known.
        goal: [m] of a drive that was left holding; NaN otherwise.
    """

    misses: int = 0
    absent: bool = False
    probe_at: float = 0.0
    probe_wait: float = 0.0
    powered: bool | None = None
    mark: int | None = None
    goal: float = math.nan

    @property
    @abstractmethod
    def tendon(self) -> str:
        """Name of the tendon on its spool."""

    @property
    @abstractmethod
    def device_id(self) -> int:
        """ID that the bus knows it by."""

    def met(self) -> None:
        """Take that it has answered."""
        self.misses, self.absent = 0, False

    def missed(self, now: float) -> None:
        """Take that it has not answered."""
        self.misses += 1
        if self.misses >= MISSES:
            self.absent = True
            self.probe_wait = PROBE_FIRST
            self.probe_at = now + self.probe_wait


State = TypeVar("State", bound=BusDevice)


class BusBackend(ABC, Generic[State]):
    """Tendon drives on one bus (the common part of a TendonBackend).

    Args:
        bus: not yet open.
        states: of the drives, in order.
        report: told in words what a person should know while it connects.
    """

    #: what a loop that an adapter slows down costs with such drives, in words
    SLOW_LOOP_COST = ""

    def __init__(
        self, bus: DriveBus, states: Iterable[State], report: Callable[[str], object] = lambda _: None
    ) -> None:
        self._port = bus
        self._live = {state.tendon: state for state in states}
        self._report = report
        self._is_slow = False

    @property
    def tendons(self) -> Sequence[str]:
        """Names of the tendons, in order."""
        return tuple(self._live)

    @property
    def counters(self) -> Counters:
        """What the bus has seen."""
        return self._port.counters

    def is_powered(self, tendon: str) -> bool:
        """Whether a drive was left holding."""
        return not math.isnan(self._live[tendon].goal)

    def goal_position(self, tendon: str) -> float:
        """Return the goal [m, device frame] of a drive that was left holding, NaN for others."""
        return self._live[tendon].goal

    def allow_for_adapter(self) -> None:
        """Wait for replies as long as the adapter keeps them back; say so where it is slow."""
        late = self._measured_lateness()
        self._is_slow = late is not None and late > SLOW_ADAPTER_S
        if late is None or not self._is_slow:
            # The margin holds what a quick adapter needs, and who does not answer must not keep the loop for longer.
            self._port.allow_lateness(FACTORY_LATENCY_S if late is None else 0.0)
            return
        self._port.allow_lateness(late)
        name = self._port.port_name
        timer = latency_timer(name)
        known = "" if timer is None else f", its latency timer is {timer * 1e3:.0f} ms"
        self._report(
            f"port {name}: expected replies within {SLOW_ADAPTER_S * 1e3:.0f} ms, found {late * 1e3:.0f} ms: the USB "
            f"adapter keeps bytes back{known}; the loop gets along with at most {0.8 / late:.0f} "
            f"Hz{self.SLOW_LOOP_COST}; {LATENCY_REMEDY}"
        )

    def _measured_lateness(self) -> float | None:
        """Return how late [s] the replies of the first drive that answers come; None where none does."""
        for live in self._live.values():
            try:
                return self._port.turnaround(live.device_id)
            except (NoReplyError, CorruptReplyError):
                continue
        return None

    def disconnect(self, *, keep_torque: bool = False) -> None:
        """Torque off, unless ``keep_torque`` is set, and close."""
        if self._port.is_open and not keep_torque:
            for live in self._live.values():
                try:
                    self._let_go(live)
                except DriverError:
                    continue  # nothing more can be done for this one here
        self._port.close()

    def reconnect(self) -> bool:
        """Reopen a port that went away."""
        if self._port.is_open:
            return True
        try:
            self._port.open()
        except DriverError:
            return False
        self._port.counters.reopened += 1
        for live in self._live.values():
            live.met()
            self._after_reopening(live)
        return True

    def _present(self) -> list[State]:
        """Return whom to ask; where nobody is left there is nobody whose rate a question to all could lower."""
        return [live for live in self._live.values() if not live.absent] or list(self._live.values())

    def _probe(self, now: float, readings: dict[str, DriveReading]) -> None:
        """Ask the absent drive whose turn it is, and add what it says."""
        due = [live for live in self._live.values() if live.absent and now >= live.probe_at]
        if not due or all(live.absent for live in self._live.values()):
            return
        live = min(due, key=lambda one: one.probe_at)
        live.probe_wait = min(2.0 * live.probe_wait, PROBE_PERIOD)
        live.probe_at = now + live.probe_wait
        try:
            reading = self._ask(live)
        except PortLostError:
            raise
        except DriverError:
            return
        if reading is not None:
            readings[live.tendon] = reading

    @abstractmethod
    def _let_go(self, live: State) -> None:
        """Switch a drive's torque off; raises DriverError."""

    @abstractmethod
    def _ask(self, live: State) -> DriveReading | None:
        """Read one drive alone; None where nothing can be said of it yet. Raises DriverError."""

    def _after_reopening(self, live: State) -> None:
        """Forget what may be otherwise behind a port that was away."""


def refuse(differences: Sequence[object]) -> None:
    """Raise ConfigurationError where settings differ that may not be written."""
    if differences:
        raise ConfigurationError(
            f"{'; '.join(map(str, differences))}; set write_eeprom, or write them with the maker's tool"
        )


def announce(differences: Sequence[object], report: Callable[[str], object], *, may_write: bool) -> None:
    """Report what will be written to all drives, or refuse: a wrong port or ID is noticed while nothing has been."""
    if not may_write:
        refuse(differences)
    for difference in differences:
        report(f"{difference}; it is written now")
