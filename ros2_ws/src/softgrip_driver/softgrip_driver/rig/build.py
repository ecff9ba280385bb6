# SPDX-License-Identifier: Apache-2.0
"""Real or emulated, of this maker or that: chosen once, here."""

from __future__ import annotations

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig import mark10
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.line_port import LinePort
from softgrip_driver.rig.mark10_gauge import Mark10Gauge
from softgrip_driver.rig.mark10_stand import Mark10Stand

STAGES = ("mark10",)
GAUGES = ("gcl2",)


def make_stage(kind: str, port: str) -> Stage:
    """Return a stage, not yet connected.

    Raises:
        ConfigurationError: no such kind.
    """
    if kind == "mark10":
        return Mark10Stand(LinePort(port, mark10.BAUD))
    raise ConfigurationError(f"stage: expected one of {', '.join(STAGES)}, found '{kind}'")


def make_gauge(kind: str, port: str) -> Gauge:
    """Return a gauge, not yet connected.

    Raises:
        ConfigurationError: no such kind.
    """
    if kind == "gcl2":
        return Mark10Gauge(LinePort(port, mark10.BAUD))
    raise ConfigurationError(f"gauge: expected one of {', '.join(GAUGES)}, found '{kind}'")
