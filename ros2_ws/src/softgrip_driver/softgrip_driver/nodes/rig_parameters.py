# SPDX-License-Identifier: Apache-2.0
"""The parameters of friction_rig, and what they mean to the measurement."""

from __future__ import annotations

from typing import Any

from softgrip_driver.nodes.stream_parameters import STREAM_PARAMETERS, stage_start_parameter
from softgrip_driver.rig.bench import Bench
from softgrip_driver.rig.build import GAUGES, STAGES, make_gauge, make_stage, stream_settings
from softgrip_driver.rig.grbl import StageStart
from softgrip_driver.rig.procedure import RigSettings
from softgrip_driver.rig.pull import PullSettings
from softgrip_driver.rig.slide import SlideSettings
from softgrip_model.friction.assess import AcceptanceLimits
from softgrip_nodekit import Parameter, ParameterTable
from softgrip_time import Clock

#: the kind of stage of a bench that has none
NO_STAGE = "none"

PARAMETERS = ParameterTable(
    Parameter("autostart", False, "configure and activate at start"),
    Parameter(
        "stage",
        "mark10",
        "kind of stage; none: a bench without a rig, where the node serves friction models and measures nothing",
        choices=(*STAGES, NO_STAGE),
    ),
    Parameter("stage_port", "/dev/softgrip/stand", "serial port of the stage", device=True),
    stage_start_parameter(),
    Parameter("gauge", "gcl2", "kind of force gauge", choices=GAUGES),
    Parameter("gauge_port", "/dev/softgrip/gauge", "serial port of the gauge", device=True),
    *STREAM_PARAMETERS,
    Parameter("gauge_frame", "load_cell", "frame of the gauge; tension is along its z"),
    Parameter("connect_timeout", 1.0, "to go on trying while a device is not ready when configuring", "s", 0.0, 60.0),
    Parameter(
        "safety_source",
        "topic",
        "topic: follow the cell's emergency stop and lock on safety/state; none: a bench without tendons, which gets "
        "rig/stop and rig/stop_reset of its own",
        choices=("topic", "none"),
    ),
    Parameter(
        "safety_file",
        "",
        "where a stop of its own is kept (safety_source: none); empty = $ROS_HOME/softgrip, one file for each port",
    ),
    Parameter("model_dir", "~/.softgrip/friction", "folder of friction models and of the record of plans"),
    Parameter("initial_model", "braid-tpu", "id of the active model until one is chosen"),
    Parameter("time_scale", 1.0, "rig seconds per second; above 1 only with an emulated rig", "1", 0.01, 1000.0),
    Parameter("speed", 40e-3 / 60.0, "pulling speed; 40 mm/min in the thesis", "m/s", 1e-5, 5e-3),
    Parameter("return_speed", 120e-3 / 60.0, "speed back", "m/s", 1e-5, 1e-2),
    Parameter("stroke", 12e-3, "way of one pull: the cable stretches, then slides", "m", 4e-3, 0.2),
    Parameter("travel_low", -1e-3, "the stage never goes below, from the start of a pull", "m", -0.5, 0.0),
    Parameter("travel_high", 60e-3, "the stage never goes above, from the start of a pull", "m", 0.0, 0.9),
    Parameter("force_limit", 45.0, "the stage stops above it", "N", 1.0, 500.0),
    Parameter("sample_period", 0.05, "between readings while pulling", "s", 0.005, 1.0),
    Parameter("attempts", 3, "at one point before the plan fails", "", 1, 10),
    Parameter("load_tolerance", 0.12, "of the hung weight, relative", "1", 0.02, 0.5),
    Parameter("drift_limit", 0.02, "change of T1 over the steady window, relative", "1", 0.001, 0.2),
    Parameter("stick_slip_limit", 0.15, "peak to peak, relative to T1", "1", 0.01, 1.0),
    Parameter("average_error_limit", 0.05, "of a usable model", "1", 0.001, 0.5),
    Parameter("maximum_error_limit", 0.15, "of one point of a usable model", "1", 0.001, 1.0),
    Parameter("interval_limit", 0.10, "95 % half width of a usable model over its range", "1", 0.001, 1.0),
    Parameter("adaptive_interval", 0.03, "the adaptive plan stops when the 95 % half width is below", "1", 0.002, 0.5),
    Parameter("adaptive_max_points", 20, "points of the adaptive plan at most", "", 5, 200, former="adaptive_most"),
    Parameter("pulley_stddev", 0.01, "relative error of the guide pulley while it was never calibrated", "1", 0.0, 0.1),
    Parameter("gauge_gain_stddev", 0.001, "relative error of the gauge's own calibration", "1", 0.0, 0.1),
    Parameter("zero_drift_limit", 0.05, "of the gauge's zero over a plan", "N", 0.001, 10.0),
)


def make_bench(values: dict[str, Any], clock: Clock) -> Bench:
    """Return the devices that the parameters name, not yet connected; they wait on this clock.

    Raises:
        ConfigurationError: a line format that cannot be.
    """
    return Bench(
        make_stage(values["stage"], values["stage_port"], start=StageStart(values["stage_start"]), clock=clock),
        make_gauge(values["gauge"], values["gauge_port"], stream_settings(values), clock=clock),
    )


def measurement_settings(values: dict[str, Any], pulley_ratio: float, pulley_stddev: float) -> RigSettings:
    """Return how to measure, from the parameters and the pulley's calibration."""
    return RigSettings(
        pull=PullSettings(
            speed=values["speed"],
            return_speed=values["return_speed"],
            stroke=values["stroke"],
            sample_period=values["sample_period"],
            force_limit=values["force_limit"],
            travel_low=values["travel_low"],
            travel_high=values["travel_high"],
        ),
        slide=SlideSettings(
            load_tolerance=values["load_tolerance"],
            drift_limit=values["drift_limit"],
            stick_slip_limit=values["stick_slip_limit"],
        ),
        limits=AcceptanceLimits(
            average_error=values["average_error_limit"],
            maximum_error=values["maximum_error_limit"],
            interval=values["interval_limit"],
        ),
        attempts=values["attempts"],
        pulley_ratio=pulley_ratio,
        common_stddev=float((pulley_stddev**2 + values["gauge_gain_stddev"] ** 2) ** 0.5),
        zero_drift_limit=values["zero_drift_limit"],
        adaptive_interval=values["adaptive_interval"],
        adaptive_max_points=values["adaptive_max_points"],
    )
