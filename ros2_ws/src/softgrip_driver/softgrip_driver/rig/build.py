# SPDX-License-Identifier: Apache-2.0
"""Real or emulated, of this maker or that: chosen once, here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig import grbl, mark10
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.gauge_calibration import read_calibration
from softgrip_driver.rig.grbl import GrblStage, StageStart
from softgrip_driver.rig.line_format import LineFormat, line_format
from softgrip_driver.rig.line_gauge import GaugeScale, LineGauge
from softgrip_driver.rig.line_port import LinePort
from softgrip_driver.rig.mark10_gauge import Mark10Gauge
from softgrip_driver.rig.mark10_stand import Mark10Stand
from softgrip_time import Clock

STAGES = ("mark10", "grbl")
GAUGES = ("gcl2", "stream")
#: [s] for an answer, where nothing waits
REPLY_TIME = 0.5


def make_stage(
    kind: str,
    port: str,
    reply_time: float = REPLY_TIME,
    start: StageStart = StageStart.REFUSE,
    clock: Clock | None = None,
) -> Stage:
    """Return a stage, not yet connected, that is given ``reply_time`` [s] of a clock for an answer.

    Args:
        kind: of `STAGES`.
        port: serial.
        reply_time: [s]
        start: what to do where it is locked when it is opened; a test stand is not.
        clock: that its port waits on; the computer's where none is given.

    Raises:
        ConfigurationError: no such kind.
    """
    if kind == "mark10":
        return Mark10Stand(LinePort(port, mark10.BAUD, reply_time, clock=clock))
    if kind == "grbl":
        return GrblStage(LinePort(port, grbl.BAUD, reply_time, clock=clock), start=start)
    raise ConfigurationError(f"stage: expected one of {', '.join(STAGES)}, found '{kind}'")


@dataclass(frozen=True)
class StreamSettings:
    r"""Of a gauge that speaks in lines.

    Attributes:
        baud: [1/s]; 0: that of its format's documents.
        line: name of a format, or a pattern.
        counts_per_newton: of a format without unit; with a unit its sign alone counts, that of pulling.
        request: what asks for a line, with \r and \n for the characters; empty: the format's own.
        calibration: file of calibrate_cell, which takes the place of ``counts_per_newton``; empty: none.
    """

    baud: int = 0
    line: str = "grams"
    counts_per_newton: float = 1.0
    request: str = ""
    calibration: str = ""


def stream_settings(values: Mapping[str, Any]) -> StreamSettings:
    """Return the settings that a node's parameters name.

    Raises:
        ConfigurationError: a scale of zero.
    """
    if values["counts_per_newton"] == 0.0:
        raise ConfigurationError("parameter counts_per_newton: expected another number than 0; calibrate_cell finds it")
    return StreamSettings(
        values["stream_baud"], values["stream_line"], values["counts_per_newton"], values["stream_request"],
        values["gauge_calibration"],
    )  # fmt: skip


def _scale(settings: StreamSettings, line: LineFormat) -> GaugeScale:
    """Return the scale of a line's numbers.

    Raises:
        ConfigurationError: the calibration can not be read.
    """
    if settings.calibration:
        found = read_calibration(Path(settings.calibration).expanduser())
        if found.line != settings.line:
            raise ConfigurationError(
                f"{settings.calibration}: expected a calibration of lines '{settings.line}', found one of "
                f"'{found.line}'; set stream_line to that, or calibrate the cell again"
            )
        return GaugeScale(found.counts_per_newton, found.offset_counts)
    if line.unit:
        return GaugeScale(math.copysign(1.0, settings.counts_per_newton))
    return GaugeScale(settings.counts_per_newton)


def make_line_gauge(
    port: str, settings: StreamSettings, reply_time: float = REPLY_TIME, clock: Clock | None = None
) -> LineGauge:
    """Return a gauge that speaks in lines, not yet connected.

    Raises:
        ConfigurationError: a line format, a request or a calibration that cannot be.
    """
    try:
        request = settings.request.encode("ascii").decode("unicode_escape").encode("ascii")
    except UnicodeError as error:
        raise ConfigurationError(
            f"stream_request: expected ASCII with \\r and \\n, found {settings.request!r}: {error}"
        ) from error
    line = line_format(settings.line, request)
    port_of_gauge = LinePort(port, settings.baud or line.baud, reply_time, line.end, clock)
    return LineGauge(port_of_gauge, line, _scale(settings, line))


def make_gauge(
    kind: str,
    port: str,
    stream: StreamSettings | None = None,
    reply_time: float = REPLY_TIME,
    clock: Clock | None = None,
) -> Gauge:
    """Return a gauge, not yet connected, that is given ``reply_time`` [s] of a clock for an answer.

    Raises:
        ConfigurationError: no such kind, or a line format that cannot be.
    """
    if kind == "gcl2":
        return Mark10Gauge(LinePort(port, mark10.BAUD, reply_time, clock=clock))
    if kind == "stream":
        return make_line_gauge(port, stream or StreamSettings(), reply_time, clock)
    raise ConfigurationError(f"gauge: expected one of {', '.join(GAUGES)}, found '{kind}'")
