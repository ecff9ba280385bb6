# SPDX-License-Identifier: Apache-2.0
"""Every fault of a tendon drive by name: what the driver does, whether it stays, and what the person has to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Reaction(Enum):
    """What the driver does with the drive at fault."""

    REPORT = "report"
    HOLD = "stop and hold"
    LET_GO = "torque off"


class Recovery(Enum):
    """How a fault ends."""

    SELF = "by itself"
    COMMAND = "next command"
    RESET = "estop_reset"
    HOME = "estop_reset, then tendon/home"


@dataclass(frozen=True)
class Fault:
    """One row of the table.

    Attributes:
        name: as in TendonStatus.fault.
        reaction: what is done with the drive.
        recovery: what ends it.
        opens_others: the other drives release slowly, because one finger alone only pushes the object away.
        meaning: one phrase.
        remedy: what to do.
    """

    name: str
    reaction: Reaction
    recovery: Recovery
    meaning: str
    remedy: str
    opens_others: bool = False


_ROWS = (
    Fault("port_lost", Reaction.HOLD, Recovery.SELF, "the serial port went away",
          "plug the adapter in again; until then servos hold by their bus watchdog, a stage where it was sent"),
    Fault("no_reply", Reaction.HOLD, Recovery.SELF, "the drive does not answer",
          "check its cable and power; the driver keeps asking"),
    Fault("rebooted", Reaction.LET_GO, Recovery.HOME, "the drive restarted and lost its turn count",
          "check the supply, then home"),
    Fault("input_voltage", Reaction.HOLD, Recovery.SELF, "supply voltage out of range",
          "check the supply and its cable length; where it stays, estop_reset (the servo restarts), then home"),
    Fault("overload", Reaction.HOLD, Recovery.HOME, "the servo cut its torque after an overload",
          "lower the tension limit, look for a jam, set max_load_share to 0.36; then home"),
    Fault("overheated", Reaction.HOLD, Recovery.HOME, "the servo cut its torque because of heat",
          "let it cool down, then home"),
    Fault("electrical_shock", Reaction.LET_GO, Recovery.HOME, "the servo reports an electrical shock or a weak supply",
          "check the supply, then home"),
    Fault("encoder_fault", Reaction.LET_GO, Recovery.HOME, "the servo's motor encoder fails", "replace the servo"),
    Fault("over_temperature", Reaction.HOLD, Recovery.SELF, "the drive is too warm to go on",
          "let it cool down; it holds with reduced tension"),
    Fault("tension_exceeded", Reaction.HOLD, Recovery.RESET, "tension above the hard limit",
          "look for a jam; check limits and torque model"),
    Fault("tendon_broken", Reaction.HOLD, Recovery.HOME, "tension vanished while the tendon was held or pulled",
          "replace the tendon, then home", opens_others=True),
    Fault("tendon_slack", Reaction.HOLD, Recovery.COMMAND, "the tendon is wound in without tension",
          "retension the tendon or home again"),
    Fault("stalled", Reaction.HOLD, Recovery.COMMAND, "the drive stopped short of target and tension limit",
          "look for a jam"),
    Fault("position_jump", Reaction.HOLD, Recovery.HOME, "the position jumped further than the drive can move",
          "check the encoder and supply, then home"),
    Fault("bus_watchdog", Reaction.HOLD, Recovery.SELF, "the bus was silent too long and the servo stopped itself",
          "the computer or the bus is overloaded; see the loop rate"),
    Fault("stage_alarm", Reaction.LET_GO, Recovery.HOME, "the stage is in alarm and does not know where it is",
          "free its axis, then home"),
    Fault("stage_refused", Reaction.HOLD, Recovery.COMMAND, "the stage did not take an order",
          "do what its message says, then send the next command"),
    Fault("gauge_lost", Reaction.HOLD, Recovery.SELF, "the tension is not known",
          "the stage stands until the gauge reads again"),
    Fault("gauge_restarted", Reaction.HOLD, Recovery.HOME, "the gauge's board restarted: its zero may be another",
          "check its supply and cable; take the load off the cell, press the board's reset, then home"),
    Fault("gauge_unproven", Reaction.HOLD, Recovery.SELF, "nobody has seen yet that the gauge feels this tendon",
          "pull the tendon by hand and let go; where the reading does not follow, the cell is cut or not in it"),
    Fault("gauge_reversed", Reaction.HOLD, Recovery.RESET, "the gauge reads less when the tendon is pulled",
          "change the sign of counts_per_newton, or swap the cell's two signal wires; then start the driver again"),
    Fault("gauge_negative", Reaction.HOLD, Recovery.RESET, "the gauge reads less than nothing",
          "its zero has drifted or its cell is reversed: take the load off, calibrate_cell; then estop_reset"),
    Fault("homing_failed", Reaction.HOLD, Recovery.COMMAND, "homing did not find the taut tendon",
          "check the tendon and the homing parameters"),
    Fault("homing_interrupted", Reaction.HOLD, Recovery.COMMAND, "the bus or the computer fell silent during homing",
          "see the loop rate and lost_replies; end other programs or set homing_speed_m_s lower, then home again"),
    Fault("command_timeout", Reaction.REPORT, Recovery.COMMAND, "no command for too long",
          "the drive holds with reduced tension and then releases slowly; send a new command"),
    Fault("owner_lost", Reaction.HOLD, Recovery.COMMAND, "whoever commanded the tendon fell silent",
          "see why its owner stopped; acquire the tendon again (tendon/lease), then send the next command"),
    Fault("invalid_setpoint", Reaction.HOLD, Recovery.RESET, "the motion asked for something that is not a number",
          "report it with the bag; estop_reset goes on"),
    # Whether it holds or lets go is the gripper's policy.
    Fault("estop", Reaction.HOLD, Recovery.RESET, "emergency stop", "make the cell safe, then estop_reset"),
)  # fmt: skip

#: the fault table
FAULTS: dict[str, Fault] = {row.name: row for row in _ROWS}
