# SPDX-License-Identifier: Apache-2.0
"""The USB adapter between this computer and a bus: how long it keeps bytes back, and names that outlive replugging."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

USB_SERIAL = Path("/sys/bus/usb-serial/devices")
BY_ID = Path("/dev/serial/by-id")
#: [s] from which an adapter is slow: with 1 ms, as it is meant to be, a reply is there within some 2
SLOW_ADAPTER_S = 0.003
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
