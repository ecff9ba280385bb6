# SPDX-License-Identifier: Apache-2.0
"""One tendon drive as a pure state machine: a reading and the time in, a setpoint and a verdict out.

It never touches a device and never asks a clock, so every path can be tested by stepping it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from softgrip_driver.faults import FAULTS, Reaction, Recovery
from softgrip_driver.tendon.backend import DriveReading, Setpoint
from softgrip_driver.tendon.guard_set import GuardSet
from softgrip_driver.tendon.guards import ReplySilence
from softgrip_driver.tendon.homing import Homing
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, DriveState, Follow, Hold, Motion, MotionStep, MoveOutcome
from softgrip_driver.tendon.status import DriveActions, DriveSnapshot
from softgrip_driver.tendon.trim import Trim

#: faults after which a position says nothing until the tendon was homed
LOST_POSITION = frozenset({"position_jump"})


class Drive:
    """State machine of one tendon.

    Args:
        tendon: name.
        limits: what it may do.
        continuous_tension: [N] that it may hold for ever.
        period: [s] between steps.
    """

    #: a motion advances by at most as many periods in one step
    MAX_PERIODS = 2.0

    def __init__(self, tendon: str, limits: TendonLimits, continuous_tension: float, period: float = 0.01) -> None:
        self.tendon = tendon
        self.limits = limits
        self._continuous = continuous_tension
        self._period = period
        self.powered = False
        #: the device was left holding by the process before, and is not switched off until it was decided what for
        self.is_left_holding = False
        #: the zero is void, and the mark that vouches for it in the device must go
        self.zero_lost = False
        #: [m] in the device's frame, and the mark in the device's volatile memory that vouches for it
        self._zero: float | None = None
        self._mark: int | None = None
        #: [m] in the device's frame where it was switched on
        self._origin = 0.0
        self._reading: DriveReading | None = None
        self._tension = 0.0  # [N]
        self._acceleration = 0.0  # [m/s^2]
        self._last_step: float | None = None  # [s]
        self._lost = 0
        self._motion: Motion | None = None
        self._job = 0
        self._outcome: MoveOutcome | None = None
        self._reason = ""
        self._is_release = False  # the last motion asked for was a slow release
        self._fault = ""
        self._fault_reason = ""
        self._restoring = self._restored_once = False
        #: [m] and [N] of the last step of a motion
        self._setpoint: float | None = None
        self._allowed = math.inf
        self._warnings: tuple[str, ...] = ()
        self._trim = Trim(limits.max_following_error)
        self._silence = ReplySilence(period)
        self._watch = self._new_watch()

    def _new_watch(self) -> GuardSet:
        return GuardSet(self.limits, self._continuous, self._period)

    # --- what is known ---------------------------------------------------------------------------------------------

    @property
    def homed(self) -> bool:
        """Whether the zero of the pulled length is known."""
        return self._zero is not None

    @property
    def fault(self) -> str:
        """Name of the present fault, empty for none."""
        return self._fault

    @property
    def ready(self) -> bool:
        """Whether it may be switched on: it has answered, and no latched fault stands."""
        return self._reading is not None and (self._fault == "" or FAULTS[self._fault].recovery is Recovery.COMMAND)

    @property
    def busy(self) -> bool:
        """Whether a motion is going on that will end."""
        return self._motion is not None and not isinstance(self._motion, Hold)

    @property
    def is_following(self) -> bool:
        """Whether it follows a streamed trajectory."""
        return isinstance(self._motion, Follow)

    @property
    def is_calm(self) -> bool:
        """Whether it has let go, or holds a slack tendon, and nothing is wrong with it."""
        is_slack = self.state is DriveState.HOLDING and not self.holds_tension
        return not self._fault and (is_slack or self.state is DriveState.IDENTIFIED)

    @property
    def tension(self) -> float:
        """[N] of the tendon, median of three."""
        return self._tension

    @property
    def state(self) -> DriveState:
        """State as TendonStatus tells it."""
        if self._fault in {"no_reply", "port_lost"} or self._reading is None:
            return DriveState.DISCONNECTED
        if self._restoring or (self._fault and FAULTS[self._fault].reaction is not Reaction.REPORT):
            return DriveState.STOPPED
        if not self.powered or self._motion is None:
            return DriveState.IDENTIFIED
        return self._motion.state

    def snapshot(self) -> DriveSnapshot:
        """Return the present state as a value."""
        r = self._reading
        measured: dict[str, Any] = {} if r is None else {
            "pulled_length_m": r.position - self._frame, "speed": r.velocity, "tension": self._tension,
            "tension_stddev": r.tension_stddev, "current": r.current, "temperature": r.temperature,
            "voltage": r.voltage, "hardware_error": r.hardware_error, "time": r.time,
        }  # fmt: skip
        return DriveSnapshot(
            self.tendon, self.state, self.homed, fault=self._fault, fault_reason=self._fault_reason,
            outcome=self._outcome, reason=self._reason, lost_replies=self._lost,
            warnings=self._warnings, job=self._job,
            zero=math.nan if self._zero is None else self._zero, **measured,
        )  # fmt: skip

    @property
    def position(self) -> float:
        """[m] in the device's frame; NaN until read."""
        return math.nan if self._reading is None else self._reading.position

    @property
    def session_mark(self) -> int | None:
        """Mark in the device's volatile memory, None until read."""
        return None if self._reading is None else self._reading.session_mark

    @property
    def job(self) -> int:
        """Number of the last motion asked for; its outcome is None until it has ended."""
        return self._job

    @property
    def outcome(self) -> MoveOutcome | None:
        """Outcome of the last motion asked for."""
        return self._outcome

    # --- requests --------------------------------------------------------------------------------------------------

    def set_zero(self, position: float, mark: int) -> None:
        """Take a zero [m, device frame] that belongs to a session mark of the device."""
        self._zero, self._mark, self._setpoint = position, mark, None
        self._watch.forget_break()

    @property
    def zero(self) -> float | None:
        """[m] of the zero in the device's frame."""
        return self._zero

    def refusal(self, *, homed: bool = True) -> str:
        """Return why the drive cannot start a motion now, empty when it can."""
        if self._reading is None:
            return f"tendon '{self.tendon}' has not answered yet"
        if self._fault and FAULTS[self._fault].recovery is not Recovery.COMMAND:
            row = FAULTS[self._fault]
            found = f"{self._fault} ({self._fault_reason})"
            return f"tendon '{self.tendon}' has the fault {found}; ends by: {row.recovery.value}"
        if self._restoring:
            return f"tendon '{self.tendon}' is being set up again; try again in a second"
        if not self.powered:
            return f"tendon '{self.tendon}' is not powered; activate the driver"
        if homed and not self.homed:
            return f"tendon '{self.tendon}' is not homed; call tendon/home"
        return ""

    def start(self, make: Callable[[DriveObservation], Motion], now: float) -> Motion:
        """Begin a motion made from the present view; the one before ends as CANCELLED."""
        assert self._reading is not None
        if self._fault and FAULTS[self._fault].recovery is Recovery.COMMAND:
            self._clear_fault()
        motion = make(self._view(self._reading, now, 0.0, math.inf))
        if isinstance(motion, Follow) and isinstance(self._motion, Follow):
            motion.take_over(self._motion)
        self._motion = motion
        self._is_release = motion.state is DriveState.RELEASING
        self._outcome, self._reason = None, ""
        self._job += 1
        return motion

    def switch_on(self) -> DriveActions:
        """Hold the present position."""
        assert self._reading is not None
        self.powered = True
        self._origin = self._reading.position
        self._watch = self._new_watch()
        self._hold_here(pulling=False)
        return DriveActions(power=True)

    def switch_off(self) -> DriveActions:
        """Let go of the tendon; a motion that was going on ends as cancelled."""
        self.powered = self.is_left_holding = False
        if self.busy and self._outcome is None:
            self._outcome, self._reason = MoveOutcome.CANCELLED, "torque was switched off"
        self._motion = None
        return DriveActions(power=False)

    def begin_restore(self, *, power: bool) -> None:
        """Note that the device is being set up again, which costs its turns; with ``power`` it holds afterwards."""
        self._restoring = True
        self._zero = self._mark = None
        self.powered = power

    def restored(self, *, success: bool) -> DriveActions:
        """Go on after the device was set up again: take hold where it stands now, without a zero."""
        self._restoring = False
        if not success or self._reading is None:
            return self.switch_off()
        return self.switch_on() if self.powered else DriveActions()

    def reset(self) -> None:
        """Record that a person has dealt with the fault."""
        self._restored_once = False
        if self._fault and FAULTS[self._fault].recovery in (Recovery.RESET, Recovery.HOME, Recovery.COMMAND):
            if self._fault in LOST_POSITION and self.powered:
                self._hold_here(pulling=False)
            self._clear_fault()
            self._watch.forget_break()

    def set_fault(self, name: str, reason: str) -> None:
        """Enter a fault: the motion ends, the drive does what the fault table says."""
        row = FAULTS[name]
        latched = self._fault != "" and FAULTS[self._fault].recovery in {Recovery.HOME, Recovery.RESET}
        if latched and (row.recovery is not Recovery.HOME or FAULTS[self._fault].recovery is Recovery.HOME):
            return  # the first latched fault is the cause; what follows is its consequence
        if self._fault == name:
            return
        self._fault, self._fault_reason = name, f"{row.meaning}: {reason}; {row.remedy}"
        if row.reaction is Reaction.REPORT:
            return
        if self.busy:
            self._outcome, self._reason = MoveOutcome.FAULT, self._fault_reason
        if row.recovery is Recovery.HOME and self._zero is not None:
            self._zero = self._mark = self._setpoint = None
            self.zero_lost = True
        if self._reading is not None and self.powered:
            self._hold_here(pulling=row.recovery is not Recovery.HOME)

    def hold_now(self) -> None:
        """Stop and go on holding, with the holding tension at most."""
        if self._reading is not None and self.powered:
            self._hold_here(pulling=True)

    def take_over(self, goal: float) -> None:
        """Go on holding what another process left holding, with the goal [m, device frame] that the device has."""
        assert self._reading is not None
        self.powered, self.is_left_holding = True, False
        self._origin = self._reading.position
        self._watch = self._new_watch()
        self._setpoint = goal - self._frame if math.isfinite(goal) else None
        self._hold_here(pulling=True)

    def cancel_motion(self, reason: str) -> None:
        """End the motion as cancelled and hold."""
        if self.busy:
            self._outcome, self._reason = MoveOutcome.CANCELLED, reason
        self.hold_now()

    def abort(self, reason: str) -> None:
        """End the motion as a fault of its own and hold."""
        if self.busy:
            self._outcome, self._reason = MoveOutcome.FAULT, reason
        self.hold_now()

    @property
    def holds_tension(self) -> bool:
        """Whether the tendon is taut."""
        return self._tension > self.limits.tension_slack

    @property
    def is_released(self) -> bool:
        """Whether the last motion asked for was a slow release that came to its end.

        Friction leaves it about a newton then, or an old zero more: none of it holds anything.
        """
        return self._is_release and self._outcome is MoveOutcome.REACHED

    def _clear_fault(self) -> None:
        self._fault, self._fault_reason = "", ""
        self._watch.forget_jump()

    def _hold_here(self, *, pulling: bool) -> None:
        """Stand here, and go on with the pull (at most the holding tension) or without one."""
        limit = self.limits.tension_hold
        assert self._reading is not None
        if pulling and isinstance(self._motion, Hold) and self._motion.tension_limit <= limit:
            return
        here = self._reading.position - self._frame
        if pulling and self.holds_tension:
            ahead = 0.0 if self._setpoint is None else self._setpoint - here
            self._trim.keep_pulling(ahead, self._reading.velocity, self._tension, limit)
        else:
            self._trim.clear()
        self._setpoint = None
        self._motion = Hold(here, limit)

    # --- a step ----------------------------------------------------------------------------------------------------

    def step(self, now: float, reading: DriveReading | None) -> DriveActions:
        """Take a cycle's reading (None = the drive did not answer) and say what the device shall do.

        Believe the reading -> what the device says of itself -> limit by heat -> guards -> motion -> goal.
        """
        if reading is None or not _is_finite(reading):  # a device that answers with no numbers has not answered
            return self._unanswered(now)
        if not self._believe(reading):
            return DriveActions()
        dt = self._take(reading, now)
        actions = self._check_device(reading)
        if actions is not None:
            return actions
        cap = self._tension_cap(reading, dt)
        actions = self._without_motion(reading, cap)
        if actions is not None:
            return actions
        # After a late step the motion goes on from where it is: slower, never with a jerk to make up for it.
        view = self._view(reading, now, min(dt, self.MAX_PERIODS * self._period), cap)
        self._guard(view)
        if self._fault and FAULTS[self._fault].reaction is Reaction.LET_GO:
            return self.switch_off()
        return DriveActions(setpoint=self._next_goal(view))

    def _take(self, reading: DriveReading, now: float) -> float:
        """Remember a reading that is believed; returns the time since the step before [s]."""
        dt = 0.0 if self._last_step is None else max(0.0, min(0.1, now - self._last_step))
        if self._reading is not None and reading.time > self._reading.time:
            self._acceleration = (reading.velocity - self._reading.velocity) / (reading.time - self._reading.time)
        self._last_step, self._reading = now, reading
        self._tension = self._watch.tension(reading)
        self._silence.heard(now)
        if self._fault in ("no_reply", "port_lost", "bus_watchdog") and not self._restoring:
            self._clear_fault()
        return dt

    def _without_motion(self, reading: DriveReading, cap: float) -> DriveActions | None:
        """Return what a drive does that is off or has lost its position; None where its motion goes on."""
        if not self.powered or self._motion is None:
            # What was switched off while nobody could tell the device is switched off now.
            unwanted = reading.powered and not self._restoring and not self.is_left_holding
            return DriveActions(power=False if unwanted else None)
        if self._fault in LOST_POSITION:
            # A goal in a frame that is wrong by turns would move it by turns: it keeps the last one it was sent.
            return DriveActions(setpoint=Setpoint(None, min(self.limits.tension_hold, cap)))
        return None

    def _guard(self, view: DriveObservation) -> None:
        """Enter the fault that the motion shows, if it does: the drive holds where it is then, or lets go."""
        assert self._motion is not None
        found = self._watch.finds(view, self._motion, self._allowed, homed=self.homed)
        if found is not None:
            self.set_fault(*found)

    def _next_goal(self, view: DriveObservation) -> Setpoint:
        """Return the device's next goal; none, which stops a stage, while its gauge has ceased to show the tendon."""
        if self._watch.suspects_collapse and not self._fault:
            return Setpoint(None, min(self._allowed, view.tension_cap))
        return self._goal(self._move_on(view))

    def _move_on(self, view: DriveObservation) -> MotionStep:
        """Advance the motion, and what its setpoint needs beyond the length that it stands for."""
        assert self._motion is not None
        step = self._motion.step(view)
        if not (math.isfinite(step.pulled_length_m) and math.isfinite(step.tension_limit)):
            self.set_fault(
                "invalid_setpoint", f"a length of {step.pulled_length_m} m with a limit of {step.tension_limit} N"
            )
            step = self._motion.step(view)
        if self._motion.state is DriveState.HOMING:
            self._trim.clear()
        elif not self._watch.suspects_break:
            # Giving way while a break is suspected would look as if the tension had been let out.
            self._trim.step(step, view)
        self._setpoint, self._allowed = step.pulled_length_m, step.tension_limit
        return step

    def _goal(self, step: MotionStep) -> Setpoint:
        """Return the device's goal; a motion that is at its end gives way to what comes after it."""
        setpoint = Setpoint(step.pulled_length_m + self._frame + self._trim.value, step.tension_limit)
        if step.outcome is not None:
            self._finish(step)
        return setpoint

    @property
    def _frame(self) -> float:
        """[m] in the device's frame from which lengths count: the zero, or where it was switched on."""
        return self._origin if self._zero is None else self._zero

    def _view(self, reading: DriveReading, now: float, dt: float, cap: float) -> DriveObservation:
        """Return what a motion sees at a time [s], ``dt`` [s] after the step before, with ``cap`` [N] allowed."""
        pulled_length_m = reading.position - self._frame
        ahead = 0.0 if self._setpoint is None else self._setpoint - pulled_length_m
        return DriveObservation(
            now, dt, pulled_length_m, reading.velocity, self._tension, reading.pull, cap, reading.tension_stddev,
            self._acceleration, ahead, reading.is_gauged,
        )  # fmt: skip

    def _unanswered(self, now: float) -> DriveActions:
        self._lost += 1
        lasted = self._silence.unanswered(now)
        if lasted >= self.limits.no_reply and not self._restoring and self._fault != "port_lost":
            self.set_fault("no_reply", f"nothing heard for {lasted * 1e3:.0f} ms")
        return DriveActions()

    def _believe(self, reading: DriveReading) -> bool:
        if not self.powered:
            self._watch.forget_jump()
            return True
        if self._watch.believes(reading):
            return True
        if self._watch.lost:
            before = self._reading.position if self._reading is not None else math.nan
            self._watch.forget_jump()
            self._reading = reading
            self.set_fault(
                "position_jump", f"from {before * 1e3:.1f} mm to {reading.position * 1e3:.1f} mm within a few cycles"
            )
        return False

    def _check_device(self, reading: DriveReading) -> DriveActions | None:
        """React to what the device reports of itself; None = go on."""
        lost_mark = self._mark is not None and reading.session_mark is not None and reading.session_mark != self._mark
        if lost_mark or (self.powered and reading.powered is False and not reading.faults and not self._restoring):
            found = f"session mark {reading.session_mark}, expected {self._mark}" if lost_mark else "torque is off"
            self.set_fault("rebooted", found)
            self._mark = None
            return self.switch_off()
        if self._restoring:
            return None  # what it reports is from before its reboot
        for name in reading.faults:
            bits = f"hardware error status 0x{reading.hardware_error:02x}"
            watchdog = "its bus watchdog has tripped" if name == "bus_watchdog" else ""
            self.set_fault(name, watchdog or reading.fault_detail or bits)
        if "overload" in reading.faults and self.powered and not self._restored_once:
            # The servo has let go by itself. Taking hold again at once keeps the object; twice would be a fight.
            self._restoring = self._restored_once = True
            return DriveActions(restore=True)
        if not reading.faults and self._fault in {"input_voltage", "gauge_lost", "gauge_unproven"}:
            self._clear_fault()
        return None

    def _tension_cap(self, reading: DriveReading, dt: float) -> float:
        allowed = self._watch.allows(reading.temperature, self._tension, dt, reading.load)
        self._warnings = allowed.warnings
        if allowed.too_hot:
            self.set_fault("over_temperature", allowed.too_hot)
        elif self._fault == "over_temperature":
            self._clear_fault()
        return allowed.tension

    def _finish(self, step: MotionStep) -> None:
        self._outcome, self._reason = step.outcome, step.reason
        if step.fault:
            self.set_fault(step.fault, step.reason)
            self._outcome = MoveOutcome.FAULT
            return
        if isinstance(self._motion, Homing):
            assert self._motion.zero is not None
            self._zero = self._frame + self._motion.zero
            self._mark = self._setpoint = None
            # Lengths count from another zero now.
            self._watch.forget_break()
            self._motion = Hold(0.0, self.limits.tension_soft)
            return
        self._motion = Hold(step.pulled_length_m, step.tension_limit)


def _is_finite(reading: DriveReading) -> bool:
    """Whether a reading consists of numbers; current, temperature and voltage may be unknown."""
    return all(
        math.isfinite(value)
        for value in (reading.position, reading.velocity, reading.tension, reading.tension_stddev, reading.pull)
    )
