# SPDX-License-Identifier: Apache-2.0
"""Parameters of grasp_mix_manager in one table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from softgrip_cell.cell import Agreements
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.nodes.driver_link import MotionLimits
from softgrip_cell.storage import SHIPPED_URL
from softgrip_cell.swap.check import CheckSettings
from softgrip_nodekit import Parameter, ParameterTable, lateness_parameter

_CHECK = CheckSettings()
_AGREEMENTS = Agreements()

#: Setting of the grasp decision that the check after a swap has a parameter for.
_SHARED = "tip_m"


def _grasp_rows() -> Iterator[Parameter]:
    """Give every setting of the grasp decision as a row."""
    for each in fields(GraspSettings):
        if each.name != _SHARED:
            facts = each.metadata["facts"]
            yield Parameter(
                each.name, each.default, facts.text, facts.unit, facts.minimum, facts.maximum,
                former=facts.former, convert=facts.convert,
            )  # fmt: skip


PARAMETERS = ParameterTable(
    Parameter("database_url", SHIPPED_URL, "SQLAlchemy URL: sqlite:///path or postgresql://user@host/name"),
    Parameter("catalogue", "", "YAML that an empty database is filled from; empty = the shipped 15 products"),
    Parameter(
        "finger_records",
        "",
        "YAML that an empty database is filled from; empty = the shipped fingers",
        former="passports",
    ),
    Parameter("slots", ["index", "middle", "thumb"], "slots = tendons of the gripper, in order"),
    Parameter("thumb", "thumb", "slot that presses against the others"),
    Parameter("swap_limit_s", 300.0, "longest swap; beyond it the swap fails", "s", 5.0, 3600.0),
    Parameter("friction_age_limit_s", 30 * 86400.0, "oldest friction model that is used", "s", 60.0, 1e9),
    Parameter(
        "friction_range_factor", 5.0, "tension of a closing over the calibrated tension, at most", "", 1.0, 100.0
    ),
    Parameter("lease_s", 2.0, "without a heartbeat for so long the driver stops what the cell moves", "s", 0.5, 10.0),
    Parameter("order_s", 1.0, "an order that the driver would begin later than this is refused", "s", 0.1, 10.0),
    Parameter("silence_s", 1.0, "silence of the driver that ends a grasp and refuses the next", "s", 0.3, 10.0),
    Parameter(
        "open_run", _AGREEMENTS.open_samples, "samples in a row with all fingers open: nothing is held", "", 2, 200
    ),
    Parameter(
        "worn_run", _AGREEMENTS.worn_residuals, "residuals in a row that call a finger worn until it counts", "", 1, 100
    ),
    Parameter("open_speed_m_per_s", 0.05, "speed of opening the fingers", "m/s", 0.001, 0.5),
    lateness_parameter(0.05),
    Parameter("check_tension_limit_n", _CHECK.tension_limit_n, "a finger has closed in the check", "N", 1.0, 500.0),
    Parameter("check_length_m", _CHECK.length_m, "pulled length of the check after a swap", "m", 0.005, 0.060),
    Parameter("check_speed_m_per_s", _CHECK.speed_m_per_s, "speed of the check after a swap", "m/s", 0.001, 0.1),
    Parameter("check_change_fraction", _CHECK.change_fraction, "wear: change since the last check", "", 0.02, 1.0),
    Parameter(
        "check_tension_fraction",
        _CHECK.tension_fraction,
        "tension interval of the check, share of prediction",
        "",
        0.02,
        1.0,
    ),
    Parameter(
        "check_tip_m",
        _CHECK.tip_m,
        "fingertip interval of the check; a tip farther off is bent by something",
        "m",
        0.0005,
        0.05,
    ),
    *_grasp_rows(),
)


def grasp_settings(values: Mapping[str, Any]) -> GraspSettings:
    """Return the settings of the grasp decision that the parameters ask for."""
    own = {row.name: values[row.name] for row in _grasp_rows()}
    return GraspSettings(**own, **{_SHARED: values["check_tip_m"]})


def check_settings(values: Mapping[str, Any]) -> CheckSettings:
    """Return the intervals of the swap check that the parameters ask for."""
    return CheckSettings(
        length_m=values["check_length_m"],
        tension_limit_n=values["check_tension_limit_n"],
        speed_m_per_s=values["check_speed_m_per_s"],
        tension_fraction=values["check_tension_fraction"],
        change_fraction=values["check_change_fraction"],
        tip_m=values["check_tip_m"],
    )


def agreements(values: Mapping[str, Any]) -> Agreements:
    """Return how many messages in a row are believed."""
    return Agreements(values["open_run"], values["worn_run"])


def motion_limits(values: Mapping[str, Any]) -> MotionLimits:
    """Return what goes with every order to the driver."""
    return MotionLimits(values["open_speed_m_per_s"], values["tension_limit_n"], values["order_s"])
