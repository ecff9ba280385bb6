# SPDX-License-Identifier: Apache-2.0
"""What the driver says of its bus, and the commands that need the bus for themselves."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from softgrip_driver.dynamixel.registers import BAUD_CODES
from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: The driver's lifecycle, as lifecycle_msgs names its states; "" = not heard yet.
UNCONFIGURED, INACTIVE, ACTIVE = "unconfigured", "inactive", "active"

#: Where the driver's transitions lead, in the order in which they are made.
TO_FREE: Final = {ACTIVE: ("deactivate", "cleanup"), INACTIVE: ("cleanup",)}
TO_TAKE: Final = {UNCONFIGURED: ("configure", "activate"), INACTIVE: ("activate",)}


@dataclass(frozen=True)
class BenchView:
    """What the driver says of itself.

    Attributes:
        phase: of its lifecycle.
        port, baud: of the servo bus.
        tendons, servo_ids, servo_models: one for each servo.
        bus: figures of /diagnostics, name -> text.
        servos: tendon -> figures of /diagnostics.
        reports: how many /diagnostics of the driver have come.
    """

    phase: str = ""
    port: str = ""
    baud: int = 0
    tendons: tuple[str, ...] = ()
    servo_ids: tuple[int, ...] = ()
    servo_models: tuple[str, ...] = ()
    bus: Mapping[str, str] = field(default_factory=dict)
    servos: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    reports: int = 0

    @property
    def has_bus(self) -> bool:
        """Whether the driver has its port open."""
        return self.phase in (INACTIVE, ACTIVE)

    @property
    def zeros_mm(self) -> dict[str, float]:
        """Zero of every homed tendon in its device's frame [mm]."""
        zeros = {name: _number(figures.get("zero [mm]", "")) for name, figures in self.servos.items()}
        return {name: zero for name, zero in zeros.items() if zero is not None}

    def of(self, tendon: str, values: Sequence[object]) -> str:
        """Return a tendon's own of one value for each, or for all."""
        if tendon not in self.tendons or not values:
            return "?"
        return str(values[self.tendons.index(tendon) % len(values)] if len(values) > 1 else values[0])


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if value == value else None  # noqa: PLR0124  a NaN: not homed


@dataclass(frozen=True)
class TerminalStep:
    """A step that needs the bus for itself.

    Attributes:
        key: of its text.
        words: of its command.
        is_run_here: a page may run it, too: it moves nothing and asks nothing.
    """

    key: str
    words: tuple[str, ...]
    is_run_here: bool = False

    @property
    def command(self) -> str:
        """As it is typed at a terminal."""
        return shlex.join(self.words)


#: Steps that a page runs itself.
RUN_HERE: Final = frozenset({"scan", "ids", "selftest"})
#: Of `setup`, which writes into one servo.
MAX_ID: Final = 252
BAUDS: Final = tuple(sorted(BAUD_CODES))


def id_step(bench: BenchView, servo_id: int, baud: int, new_id: int) -> TerminalStep:
    """Return the command that gives one servo another ID and the bus's own baud rate.

    Args:
        bench: this cell's.
        servo_id: that it has now.
        baud: that it has now [1/s].
        new_id: that it is to have.

    Raises:
        PanelError: an ID or a rate that no servo can have.
    """
    for value in (servo_id, new_id):
        if not 0 <= value <= MAX_ID:
            raise PanelError(say("error.servo_id", limit=MAX_ID, found=value))
    if baud not in BAUDS:
        raise PanelError(say("error.baud", known=", ".join(map(str, BAUDS)), found=baud))
    words = ["--port", bench.port or "/dev/ttyUSB0", "--baud", str(baud), "--id", str(servo_id)]
    words += ["--new-id", str(new_id), "--new-baud", str(bench.baud or 1_000_000)]
    return _step("ids", ["setup", *words])


def _step(key: str, line: Sequence[str]) -> TerminalStep:
    return TerminalStep(key, ("ros2", "run", "softgrip_driver", *line), key in RUN_HERE)


def terminal_steps(bench: BenchView) -> tuple[TerminalStep, ...]:
    """Return the steps that need the bus for themselves, with this cell's own port and servos."""
    port = ["--port", bench.port or "/dev/ttyUSB0"]
    bus = [*port, "--baud", str(bench.baud or 1_000_000)]
    tendons = list(bench.tendons) or ["index", "middle", "thumb"]
    first = str(bench.servo_ids[0]) if bench.servo_ids else "1"
    words = {
        "scan": ["scan", *port],
        "wizard": ["wizard", *port, "--tendons", *tendons, "--file", "cell.yaml"],
        "ids": ["setup", *port, "--baud", "57600", "--id", "1", "--new-id", "3", "--new-baud", bus[-1]],
        "selftest": ["selftest", *bus],
        "calibrate": ["calibrate_tension", *bus, "--id", first, "--weights", "0.2", "0.5", "1"],
    }
    return tuple(_step(key, line) for key, line in words.items())


def bus_causes(bench: BenchView) -> tuple[str, ...]:
    """Return keys of what the driver's own figures show to be wrong; what to do stands in the text."""
    found = []
    if (_number(bench.bus.get("lost replies", "")) or 0.0) + (_number(bench.bus.get("damaged replies", "")) or 0.0):
        found.append("setup.lost")
    if _number(bench.bus.get("missed cycles", "")):
        found.append("setup.missed")
    if _number(bench.bus.get("port reopened", "")):
        found.append("setup.reopened")
    if any(one.get("hardware error", "0x00") != "0x00" for one in bench.servos.values()):
        found.append("setup.hardware_error")
    return tuple(found)
