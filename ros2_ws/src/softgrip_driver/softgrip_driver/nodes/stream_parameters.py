# SPDX-License-Identifier: Apache-2.0
"""The parameters of stage and gauge that tendon_driver and friction_rig share."""

from __future__ import annotations

from softgrip_driver.rig.grbl import StageStart
from softgrip_driver.rig.line_format import FORMATS
from softgrip_nodekit import Parameter

#: of a gauge of kind stream; `softgrip_driver.rig.build.stream_settings` reads them
STREAM_PARAMETERS = (
    Parameter("stream_baud", 0, "of a gauge that speaks in lines; 0 = that of its format", "1/s", 0, 3000000),
    Parameter("stream_line", "grams", f"its lines: {', '.join(FORMATS)} or a pattern with a group (?P<value>...)"),
    Parameter("stream_request", "", r"what asks it for a line, such as SI\r\n; empty = the format's own"),
    Parameter(
        "counts_per_newton", 1.0, "of lines without a unit, not 0; its sign is that of pulling, with a unit, too", "1/N"
    ),
    Parameter("gauge_calibration", "", "file of calibrate_cell, in place of counts_per_newton; empty = none"),
)


def stage_start_parameter() -> Parameter:
    """Return the parameter for a stage that is locked when it is opened."""
    return Parameter(
        "stage_start",
        StageStart.REFUSE.value,
        "a stage with switches ($22=1) is locked when its port is opened: home = drive to them at once ($H), unlock = "
        "go on without ($X)",
        choices=tuple(choice.value for choice in StageStart),
    )
