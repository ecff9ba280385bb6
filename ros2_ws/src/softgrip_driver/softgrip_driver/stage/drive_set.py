# SPDX-License-Identifier: Apache-2.0
"""The backends `grbl` and `mark10`: from the node's parameters to one tendon on a stage with a gauge in its line."""

from __future__ import annotations

from dataclasses import dataclass

from softgrip_driver.drives import DriveRequest, Report
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig.build import GAUGES, StreamSettings, make_gauge, make_stage, stream_settings
from softgrip_driver.rig.grbl import StageStart
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_time import Clock

#: [Hz] that a stage can be asked and told: GRBL's documentation asks for 5 and allows 10; the stand takes some 10 ms an
#: order
STAGE_RATES = {"grbl": 10.0, "mark10": 20.0}
#: a stage is this much faster than the fastest setpoint, so that it keeps up
STAGE_SPEED_FACTOR = 1.2


@dataclass(frozen=True)
class TendonGaugeSettings:
    """The force gauge in a stage's tendon.

    Attributes:
        kind: of GAUGES. port: serial. stream: how to read one that speaks in lines.
        proof: [N] that a hand must pull before anything is wound in; 0 = none.
    """

    kind: str
    port: str
    stream: StreamSettings
    proof: float


@dataclass(frozen=True)
class StageDrive:
    """One tendon on a stage (DriveSet).

    Attributes:
        kind: of the stage. tendon: its name.
        port, reply_margin: of the stage, whose baud rate is fixed.
        speed: [m/s] towards a setpoint.
        start: what to do where the stage is locked when it is opened.
        gauge: in the tendon.
    """

    kind: str
    tendon: str
    port: str
    reply_margin: float
    speed: float
    start: StageStart
    gauge: TendonGaugeSettings

    def backend(self, report: Report, clock: Clock) -> TendonBackend:
        """Return the backend, not connected."""
        del report
        stage = make_stage(self.kind, self.port, self.reply_margin, self.start, clock)
        gauge = make_gauge(self.gauge.kind, self.gauge.port, self.gauge.stream, self.reply_margin, clock)
        return StageBackend(self.tendon, stage, gauge, self.speed, self.gauge.proof, clock)


def configure(request: DriveRequest) -> StageDrive:
    """Return the stage that the parameters describe; raises ConfigurationError for values that do not fit."""
    values, kind, rate = request.values, request.kind, request.values["loop_rate"]
    if len(request.tendons) != 1:
        raise ConfigurationError(
            f"parameter tendons: expected one with backend '{kind}', found {list(request.tendons)}"
        )
    if not values["gauge_port"] or values["gauge"] not in GAUGES:
        raise ConfigurationError(
            f"parameters gauge, gauge_port: expected a gauge of {list(GAUGES)} and its port with backend '{kind}', "
            f"found '{values['gauge']}' and '{values['gauge_port']}'; without one nobody knows the tension"
        )
    if rate > STAGE_RATES[kind]:
        raise ConfigurationError(
            f"parameter loop_rate: expected at most {STAGE_RATES[kind]:g} Hz with backend '{kind}', found {rate:g}"
        )
    (tendon,) = request.tendons
    return StageDrive(
        kind,
        tendon,
        values["port"],
        values["reply_margin_s"],
        STAGE_SPEED_FACTOR * request.limits[tendon].speed,
        StageStart(values["stage_start"]),
        TendonGaugeSettings(values["gauge"], values["gauge_port"], stream_settings(values), values["gauge_proof_n"]),
    )
