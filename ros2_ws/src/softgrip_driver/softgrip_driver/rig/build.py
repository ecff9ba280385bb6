# SPDX-License-Identifier: Apache-2.0
"""Real or emulated, of this maker or that: chosen once, here."""

from __future__ import annotations

from dataclasses import dataclass

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig import grbl, mark10
from softgrip_driver.rig.amplifier import StreamAmplifier, line_format
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.grbl import GrblStage
from softgrip_driver.rig.line_port import LinePort
from softgrip_driver.rig.mark10_gauge import Mark10Gauge
from softgrip_driver.rig.mark10_stand import Mark10Stand

STAGES = ("mark10", "grbl")
GAUGES = ("gcl2", "stream")
#: [s] for an answer, where nothing waits
REPLY_TIME = 0.5


def make_stage(kind: str, port: str, reply_time: float = REPLY_TIME) -> Stage:
    """Return a stage, not yet connected, that is given ``reply_time`` [s] for an answer.

    Raises:
        ConfigurationError: no such kind.
    """
    if kind == "mark10":
        return Mark10Stand(LinePort(port, mark10.BAUD, reply_time))
    if kind == "grbl":
        return GrblStage(LinePort(port, grbl.BAUD, reply_time))
    raise ConfigurationError(f"stage: expected one of {', '.join(STAGES)}, found '{kind}'")


@dataclass(frozen=True)
class StreamSettings:
    """Of a streaming amplifier: baud [1/s], line format (name or pattern), raw counts per newton (sign included)."""

    baud: int = 115200
    line: str = "grams"
    counts_per_newton: float = 1.0


def make_gauge(kind: str, port: str, stream: StreamSettings | None = None, reply_time: float = REPLY_TIME) -> Gauge:
    """Return a gauge, not yet connected, that is given ``reply_time`` [s] for an answer.

    Raises:
        ConfigurationError: no such kind, or a line format that cannot be.
    """
    if kind == "gcl2":
        return Mark10Gauge(LinePort(port, mark10.BAUD, reply_time))
    if kind == "stream":
        settings = stream or StreamSettings()
        line = line_format(settings.line, abs(settings.counts_per_newton))
        sign = 1.0 if settings.counts_per_newton >= 0.0 else -1.0
        return StreamAmplifier(LinePort(port, settings.baud, reply_time), line, sign)
    raise ConfigurationError(f"gauge: expected one of {', '.join(GAUGES)}, found '{kind}'")
