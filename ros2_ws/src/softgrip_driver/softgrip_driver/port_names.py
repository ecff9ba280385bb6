# SPDX-License-Identifier: Apache-2.0
"""Names for serial ports that stay: udev rules that make /dev/softgrip/NAME of a USB adapter, by its serial number.

An adapter without one (CH340 boards) is known by the socket that it is plugged into. Keys: udev(7); attributes of a USB
device in sysfs: Documentation/ABI/testing/sysfs-bus-usb of the Linux kernel; ID_USB_INTERFACE_NUM: imported for ttys by
systemd's 60-serial.rules.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from softgrip_driver.errors import ConfigurationError

TTYS = Path("/sys/class/tty")
FOLDER = "softgrip"
_NAME = re.compile(r"[a-z][a-z0-9_]*")
#: serial numbers that stand in a rule as they are: no quotes, none of the patterns of udev(7)
_PLAIN = re.compile(r"[\w.:+-]+", re.ASCII)


@dataclass(frozen=True)
class UsbIdentity:
    """What tells a USB adapter from others.

    Attributes:
        vendor, product: four hexadecimal digits.
        serial: number, empty where it has none that can be used.
        socket: where it is plugged in, the kernel's name (1-2.3).
        interface: of an adapter with several ports, two digits.
    """

    vendor: str
    product: str
    serial: str
    socket: str
    interface: str

    @property
    def match(self) -> str:
        """The keys of a rule that find this adapter."""
        own = f'ATTRS{{serial}}=="{self.serial}"' if self.serial else f'KERNELS=="{self.socket}"'
        return (
            f'SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS{{idVendor}}=="{self.vendor}", '
            f'ATTRS{{idProduct}}=="{self.product}", {own}, ENV{{ID_USB_INTERFACE_NUM}}=="{self.interface}"'
        )


def usb_identity(port: str, ttys: Path = TTYS) -> UsbIdentity:
    """Return what tells the adapter of a serial port from others.

    Raises:
        ConfigurationError: no such port, or none of a USB adapter.
    """
    place = (ttys / Path(port).resolve().name / "device").resolve()
    interface = ""
    for folder in (place, *place.parents):
        interface = interface or _read(folder / "bInterfaceNumber")
        if vendor := _read(folder / "idVendor"):
            serial = _read(folder / "serial")
            usable = serial if _PLAIN.fullmatch(serial) else ""
            return UsbIdentity(vendor, _read(folder / "idProduct"), usable, folder.name, interface or "00")
    raise ConfigurationError(
        f"{port}: expected the serial port of a USB adapter, found none; see `ls /dev/serial/by-id`"
    )


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def naming_rules(ports: Mapping[str, str], ttys: Path = TTYS) -> str:
    """Return the text of a rules file that gives each port its name.

    Args:
        ports: name -> port as it is now, such as /dev/ttyUSB0.
        ttys: of sysfs.

    Raises:
        ConfigurationError: a name that is none, a port that is no USB adapter's, or one adapter with two names.
    """
    lines, found = (
        ["# Names of this bench's ports, by `ros2 run softgrip_driver name_ports`."],
        dict[UsbIdentity, str](),
    )
    for name, port in ports.items():
        if not _NAME.fullmatch(name):
            raise ConfigurationError(f"expected a name of small letters, digits and _, found {name!r}")
        identity = usb_identity(port, ttys)
        if identity in found:
            raise ConfigurationError(
                f"{port}: expected another adapter than that of '{found[identity]}', found the same"
            )
        found[identity] = name
        if not identity.serial:
            lines.append(f"# {name}: the adapter has no serial number of its own; it is named by its socket")
        lines.append(f'{identity.match}, SYMLINK+="{FOLDER}/{name}"')
    return "\n".join([*lines, ""])
