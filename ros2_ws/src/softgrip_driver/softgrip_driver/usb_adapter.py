# SPDX-License-Identifier: Apache-2.0
"""The USB adapter between this computer and a bus: how long it keeps bytes back, and names that outlive replugging."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol, TypeVar

from softgrip_driver.errors import CorruptReplyError, DriverError, NoReplyError
from softgrip_time import Clock

Answer = TypeVar("Answer")

USB_SERIAL = Path("/sys/bus/usb-serial/devices")
BY_ID = Path("/dev/serial/by-id")
#: [s] from which an adapter is slow: with 1 ms, as it is meant to be, a reply is there within some 2
SLOW_ADAPTER_S = 0.003
#: [s] of an FTDI adapter's timer as it comes: assumed where nobody answers whose replies could be timed
FACTORY_LATENCY_S = 0.016
#: share of what was measured that replies are waited for: a packet may end just after the timer has run out
LATENCY_SHARE = 1.5
#: pings that measure the adapter, and [s] that each may take
TURNAROUND_PINGS = 5
TURNAROUND_LIMIT_S = 0.1
#: what helps; udev/60-softgrip.rules does so
LATENCY_REMEDY = (
    "set its latency timer to 1 ms: install the udev rules (`make udev`), or once "
    "`echo 1 > /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`"
)


def request_low_latency(serial: Any) -> bool:
    """Ask an open port (pyserial) to hand bytes over at once; return whether the system took it.

    An FTDI chip, as in the U2D2, waits for 62 bytes or 16 ms. With ASYNC_LOW_LATENCY its driver sets 1 ms, which needs
    neither rules nor rights; other ports do not know it.
    """
    try:
        serial.set_low_latency_mode(True)
    except (AttributeError, NotImplementedError, OSError, ValueError):
        return False
    return True


def latency_timer(port: str, devices: Path = USB_SERIAL) -> float | None:
    """Return the latency timer [s] of an FTDI adapter, None where the port has none."""
    try:
        text = (devices / Path(port).resolve().name / "latency_timer").read_text(encoding="ascii")
        return int(text) * 1e-3
    except (OSError, ValueError):
        return None


def measure_turnaround(ping: Callable[[float], object], wire: float, clock: Clock) -> float:
    """Return how long [s] a device's replies take beyond the time of their bytes, on an idle computer.

    Each ping begins as the one before was answered, which is when the timer of an adapter starts again: all but the
    first take as long as it lasts. A busy computer makes some of them late, so the soonest counts.

    Args:
        ping: asks the device once; given the time [s] that it may take beyond the usual one.
        wire: [s] that the bytes of question and answer need.
        clock: that the pings' waits are on.

    Raises:
        NoReplyError, CorruptReplyError: of the last one, where fewer than two were answered.
    """
    waits: list[float] = []
    failure: DriverError | None = None
    for _ in range(TURNAROUND_PINGS):
        began = clock.now_s()
        try:
            ping(TURNAROUND_LIMIT_S)
        except (NoReplyError, CorruptReplyError) as error:
            if failure is not None and not waits:
                raise  # nobody is there: more pings would only take more time
            failure = error
        else:
            waits.append(clock.now_s() - began)
    if failure is not None and len(waits) < 2:
        raise failure
    return max(0.0, min(waits[1:]) - wire)


class PatientPort(Protocol):
    """A port that waits for replies.

    Attributes:
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        lateness: [s] beyond that, for what the adapter keeps back.
    """

    reply_margin: float
    lateness: float

    def drain(self, quiet: float, limit: float) -> int:
        """Discard input until none came for ``quiet`` [s], at most ``limit`` [s]; return the bytes discarded."""


def ask_patiently(ask: Callable[[float], Answer], attempts: int, port: PatientPort) -> Answer:
    """Ask until a whole answer came, at most ``attempts`` times; the last one's failure is raised.

    The margin is four times as long in each attempt as in the one before: a computer busy with starting up is late. A
    reply that comes after its attempt would answer the next one: it is thrown away first.

    Args:
        ask: asks once; given the time [s] that it may take beyond the usual one.
        attempts: at least one.
        port: that is asked over.
    """
    for attempt in range(1, attempts):
        try:
            return ask((4.0 ** (attempt - 1) - 1.0) * port.reply_margin)
        except (NoReplyError, CorruptReplyError):
            quiet = port.reply_margin + port.lateness
            port.drain(quiet, 10.0 * quiet)
    return ask((4.0 ** (attempts - 1) - 1.0) * port.reply_margin)


def drain(serial: Any, clock: Clock, quiet: float, limit: float) -> int:
    """Discard input of an open port until none came for ``quiet`` [s], at most ``limit`` [s]; return how many bytes."""
    end = clock.now_s() + limit
    discarded = 0
    while clock.now_s() < end:
        if not clock.wait_readable((serial.fileno(),), clock.now_s() + quiet):
            break
        discarded += len(serial.read(4096))
    return discarded


def stable_names(folder: Path = BY_ID) -> Iterator[tuple[Path, Path]]:
    """Yield (name, device) of serial ports by what they are; their numbers change with every plugging."""
    if folder.is_dir():
        yield from ((name, name.resolve()) for name in sorted(folder.iterdir()))


def naming_advice(port: str, folder: Path = BY_ID) -> str:
    """Return what to say of a port that is not there, or is named by a number; empty where nothing helps."""
    names = dict(stable_names(folder))
    own = [str(name) for name, device in names.items() if str(device) == port]
    if own:
        return f"name it {own[0]}: numbers change when adapters are plugged in again"
    if names and not Path(port).exists():
        return f"there is {', '.join(f'{name} ({device})' for name, device in names.items())}"
    return ""
