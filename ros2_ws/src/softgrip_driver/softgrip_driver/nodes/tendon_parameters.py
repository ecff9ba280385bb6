# SPDX-License-Identifier: Apache-2.0
"""The parameter table of tendon_driver."""

from __future__ import annotations

from dataclasses import fields

from softgrip_driver.nodes.stream_parameters import STREAM_PARAMETERS, stage_start_parameter
from softgrip_driver.rig.build import GAUGES
from softgrip_driver.tendon.limits import LIMIT_PARAMETERS, TendonLimits
from softgrip_nodekit import Parameter, ParameterTable, Rank, realtime_parameter

_LIMIT_TEXTS: dict[str, tuple[str, str, float, float]] = {
    "travel": ("longest pulled length", "m", 0.001, 1.0),
    "speed": ("fastest motion, and the default of a move", "m/s", 0.001, 0.5),
    "acceleration": ("of the setpoint", "m/s^2", 0.01, 20.0),
    "release_speed": ("of a slow release", "m/s", 0.001, 0.1),
    "tension_soft": ("largest tension a request may ask for, and the default limit", "N", 0.1, 500.0),
    "tension_hard": ("above it a drive stops and the fault stays", "N", 0.1, 500.0),
    "tension_slack": ("below it a tendon counts as slack", "N", 0.01, 20.0),
    "tension_hold": ("largest tension while holding after a fault or a command time-out", "N", 0.1, 500.0),
    "slack_travel": ("pulling without tension before a tendon counts as slack; let out before homing", "m", 1e-4, 0.1),
    "break_drop_from": ("a tension at least this high that vanishes means a broken tendon", "N", 0.1, 100.0),
    "break_confirm": ("how long it must stay away", "s", 0.005, 1.0),
    "stall_time": ("without motion before a move counts as stalled", "s", 0.02, 10.0),
    "max_following_error": ("the set-point may run ahead of the drive", "m", 1e-4, 0.05),
    "position_tolerance": ("within which a target counts as reached", "m", 1e-5, 0.01),
    "tension_tolerance": ("within which a tension counts as reached, relative", "", 0.01, 0.5),
    "max_load": ("of a Dynamixel's stall torque, borne for long; 1 = any, 0.36 where servos shut down", "", 0.05, 1.0),
    "temperature_limit": ("of the servo; derated from 15 below it, stopped 5 below it", "degC", 30.0, 100.0),
    "no_reply": ("without an answer before a drive counts as lost", "s", 0.01, 10.0),
    "homing_tension": ("at which a tendon counts as taut", "N", 0.1, 50.0),
    "homing_speed": ("of homing", "m/s", 0.001, 0.05),
    "homing_travel": ("wound in at most while homing", "m", 0.001, 0.5),
    "homing_timeout": ("for homing", "s", 1.0, 120.0),
}

#: former parameter name of a limit that was renamed
_FORMER_LIMITS = {"max_following_error": "lead_m"}

_LIMITS = TendonLimits()

#: parameters of tendon_driver
PARAMETERS = ParameterTable(
    Parameter("autostart", True, "configure and activate at start"),
    Parameter(
        "backend",
        "dynamixel",
        "what pulls: dynamixel, feetech or damiao servos, grbl or mark10 for one tendon on a stage, or the name that "
        "an installed package registers",
    ),
    Parameter("backend_options", [""], "NAME=VALUE each, for a backend of another package"),
    Parameter("port", "/dev/ttyUSB0", "serial port of the servo bus, or of the stage", device=True),
    Parameter("baud", 1_000_000, "of the servo bus", "1/s", 1200, 8_000_000),
    Parameter(
        "reply_margin_s", 0.004, "for a reply beyond the time its bytes need; for a stage's whole one", "s", 0.0005, 1.0
    ),
    stage_start_parameter(),
    Parameter("gauge", "gcl2", "kind of the force gauge on a stage", choices=GAUGES),
    Parameter("gauge_port", "", "serial port of the gauge; needed with a stage only"),
    *STREAM_PARAMETERS,
    Parameter(
        "gauge_proof_n",
        2.0,
        "of a stage's gauge: before anything is wound in, a hand pulls the tendon until it shows so much more; 0 = off",
        "N",
        0.0,
        50.0,
    ),
    Parameter("loop_rate", 100.0, "of the control loop; a stage takes 10 to 20", "Hz", 2.0, 500.0),
    Parameter(
        "rest_rate",
        20.0,
        "of the loop while nobody owns a tendon, none is pulled and nothing changes; raised to two cycles in "
        "bus_watchdog_s; 0 = always loop_rate",
        "Hz",
        0.0,
        500.0,
    ),
    realtime_parameter(Rank.DRIVES),
    Parameter("bus_watchdog_s", 0.08, "silence after which a servo stops by itself; 0 = off", "s", 0.0, 2.54),
    Parameter("write_eeprom", True, "correct persistent settings of the servos that differ; false = refuse to start"),
    Parameter("operating_mode", 5, "5 current-based position, 4 extended position", choices=(4, 5)),
    Parameter("tendons", ["index", "middle", "thumb"], "names, in order"),
    Parameter("grippers", ["gripper"], "gripper of each tendon; a fault stops its own gripper only"),
    Parameter("servo_ids", [1, 2, 3], "ID of each tendon's servo", "", 0, 252),
    Parameter("servo_models", ["XL330-M288"], "model of each tendon's servo"),
    Parameter("directions", [1], "+1 where a positive rotation pulls, else -1", choices=(-1, 1)),
    Parameter("spool_radii_m", [0.010], "spool radius to the middle of the tendon", "m", 1e-3, 0.1),
    Parameter("torque_per_ampere_nm_a", [0.0], "measured by calibrate_tension; 0 = data sheet", "N m/A", 0.0, 100.0),
    Parameter("friction_currents_a", [0.0], "measured by calibrate_tension; 0 = assumed", "A", 0.0, 5.0),
    Parameter(
        "friction_slopes_a_s_m", [0.0], "growth of the friction with speed, from calibrate_tension", "A s/m", 0.0, 100.0
    ),
    Parameter("gear_load_shares", [0.0], "share of the load lost in the gears, from calibrate_tension", "", 0.0, 0.9),
    Parameter(
        "quick_stddevs_n_s2_m2",
        [0.0],
        "growth of the tension's uncertainty with the square of the speed, from calibrate_tension",
        "N s2/m2",
        0.0,
        1e5,
    ),
    Parameter("tension_stddev_share", [0.15], "uncertainty of the torque constant, relative", "", 0.0, 1.0),
    Parameter(
        "winding_resistances_ohm",
        [0.0],
        "at 25 degC, measured by calibrate_tension, of servos that do not sense the winding's current; 0 = data sheet",
        "ohm",
        0.0,
        1000.0,
    ),
    Parameter("back_emfs_v_s", [0.0], "measured by calibrate_tension with the resistance", "V s/rad", 0.0, 100.0),
    Parameter("winding_stddev_share", [0.1], "uncertainty of resistance and back-EMF, relative", "", 0.0, 1.0),
    Parameter(
        "limited_currents",
        ["supply"],
        "which current the goal current of an XL330 or XC330 limits, as calibrate_tension finds out; their maker does "
        "not say, and supply pulls too little where it is wrong, winding too hard",
        choices=("supply", "winding"),
    ),
    Parameter("continuous_tension_n", 20.0, "what a drive may hold for ever", "N", 0.1, 500.0),
    Parameter("zero_file", "", "where homed zeros are kept; empty = nowhere"),
    Parameter(
        "safety_file", "", "where emergency stop and lock are kept; empty = $ROS_HOME/softgrip, one file for each port"
    ),
    Parameter("home_on_activate", False, "home every tendon whose zero does not hold when activated"),
    Parameter(
        "estop_policy", "let_go", "what estop does: let_go = torque off, hold = stay", choices=("let_go", "hold")
    ),
    Parameter(
        "unclean_end_policy",
        "hold",
        "what becomes of a hold when the driver is killed: hold = it outlives the driver and is taken over, "
        "let_go = the servos stop by their watchdogs and a new driver switches them off",
        choices=("let_go", "hold"),
    ),
    Parameter(
        "command_timeout_s",
        30.0,
        "without a command or heartbeat until a hold above tension_hold_n is reduced to it",
        "s",
        0.1,
        3600.0,
    ),
    Parameter("stream_timeout_s", 0.5, "without a message or heartbeat until a streamed motion stops", "s", 0.02, 5.0),
    Parameter("lease_max_s", 30.0, "longest lease of an owner without a heartbeat", "s", 0.1, 300.0),
    Parameter("release_after_s", 30.0, "after that until it releases slowly", "s", 0.0, 3600.0),
    Parameter(
        "health_nodes",
        [""],
        "nodes of the cell that must answer their ping: where one is silent for a second, moving drives stop",
    ),
    Parameter("status_rate", 20.0, "of tendon/status", "Hz", 1.0, 100.0),
    *(
        Parameter(
            LIMIT_PARAMETERS[field.name],
            getattr(_LIMITS, field.name),
            *_LIMIT_TEXTS[field.name],
            former=_FORMER_LIMITS.get(field.name, ""),
        )
        for field in fields(TendonLimits)
    ),
)
