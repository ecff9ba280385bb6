# SPDX-License-Identifier: Apache-2.0
"""One STS servo: its firmware between memory, encoder and power stage.

Behaviour is that of Feetech's memory table; what no document says is marked as an assumption.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from softgrip_emulator.dynamixel.motion import ServoDrive
from softgrip_emulator.dynamixel.servo import Shaft
from softgrip_emulator.feetech.memory import BAUD_OF_REGISTER, EmulatedFeetechModel, Memory

if TYPE_CHECKING:
    from collections.abc import Sequence

BOOT_SILENCE_S: Final = 0.4
"""Assumption: as long as the X series needs."""
_STEPS_PER_TURN: Final = 4096
_RAD_PER_STEP: Final = 2.0 * math.pi / _STEPS_PER_TURN
_MAX_STEPS: Final = 30_719
_FULL_SCALE: Final = 1000
DUTY_PER_RAD: Final = 0.163
"""Of one unit of P: others measured 0.163 to 0.166 (Rhoban/bam, feetech/actuator.py; kscalelabs/sysid)."""
_STEPS_PER_S_COARSE: Final = 50.0
_FINE_SPEED: Final = 0x04
_COUNTS_TURNS: Final = 0x10
_FASTEST_STEPS_PER_S: Final = 3400.0
_OVERLOAD_UNIT_S: Final = 0.01


class FeetechStatus:
    """Bits of the servo status (65)."""

    VOLTAGE: Final = 0x01
    ENCODER: Final = 0x02
    TEMPERATURE: Final = 0x04
    CURRENT: Final = 0x08
    OVERLOAD: Final = 0x20


class EmulatedFeetechServo:
    """Memory, firmware and encoder of one servo; `step` is called by the plant, the rest by the bus, on one lock."""

    def __init__(
        self, model: EmulatedFeetechModel, device_id: int, *, baud: int = 1_000_000, return_delay_us: int = 0
    ) -> None:
        self.model = model
        self.registers = Memory(model)
        self.shaft = Shaft(supply_v=model.motor.nominal_voltage_v)
        self.registers.put_kept("id", device_id)
        self.registers.put_kept("baud_rate", {speed: code for code, speed in BAUD_OF_REGISTER.items()}[baud])
        self.return_delay_s = return_delay_us * 1e-6
        self.position_glitch_pulses = 0
        self.forced_error_bits = 0
        self.silenced = False
        self.is_connected = True
        self._silent_until_s = 0.0
        self._fold_steps = 0
        self._overload_s = 0.0
        self._is_overloaded = False
        self._setpoint = 0.0
        self._pending: tuple[int, bytes] | None = None
        self.fold()

    # -- on the bus ------------------------------------------------------------------------------------------------

    @property
    def device_id(self) -> int:
        """ID on the bus."""
        return self.registers.get("id")

    @property
    def holds(self) -> bool:
        """Whether its torque is on."""
        return self.registers.get("torque_enable") == 1

    @property
    def powered(self) -> bool:
        """Whether it hangs on the cable, and the supply keeps its processor alive."""
        return self.is_connected and self.shaft.supply_v > self.model.motor.brown_out_v

    @property
    def answers_writes(self) -> bool:
        """Whether its response level lets it answer more than reads and pings."""
        return bool(self.registers.get("response_status_level"))

    def listens(self, now_s: float, baud: int) -> bool:
        """Whether it hears a packet now: powered, booted, same speed, not made silent by a fault."""
        own = BAUD_OF_REGISTER[self.registers.get("baud_rate")]
        return not self.silenced and self.powered and now_s >= self._silent_until_s and baud == own

    @property
    def status(self) -> int:
        """The bits that every answer carries."""
        return self.registers.get("status")

    def read(self, address: int, size: int) -> bytes:
        """Bytes of its memory, measured ones up to date."""
        self._refresh()
        return self.registers.read(address, size)

    def write(self, address: int, data: bytes) -> None:
        """Write its memory, with what follows from it."""
        was_on = self.registers.get("torque_enable") == 1
        written = self.registers.write(address, data)
        if "goal_position" in written and not was_on:
            # A goal switches the torque on: HLS memory table, phase bit 2, "(0) auto-on"; assumed for STS as well.
            self.registers.put("torque_enable", 1)
        is_on = self.registers.get("torque_enable") == 1
        if is_on and not was_on:
            self._setpoint = self._present_steps()
            if "goal_position" not in written:
                # Torque alone holds where it is (assumption).
                self.registers.put("goal_position", _sign_magnitude(round(self._setpoint), 15))
        if not is_on or "torque_enable" in written:
            self._overload_s, self._is_overloaded = 0.0, False

    def defer(self, address: int, data: bytes) -> None:
        """Keep a write for the next Action."""
        self._pending = (address, data)

    def act(self) -> None:
        """Carry out what was kept."""
        if self._pending is not None:
            pending, self._pending = self._pending, None
            self.write(*pending)

    def reset_turns(self) -> None:
        """Forget the turns, torque off (a seller of Feetech's: "the number of turns is clear ... torque off")."""
        self.fold()
        self.registers.put("torque_enable", 0)
        self._overload_s, self._is_overloaded, self.forced_error_bits = 0.0, False, 0

    # -- firmware --------------------------------------------------------------------------------------------------

    def lose_power(self, now_s: float) -> None:
        """Reboot or supply failure: RAM and turns are gone, silence while it boots."""
        self._silent_until_s = now_s + BOOT_SILENCE_S
        self.forced_error_bits = 0
        self._overload_s, self._is_overloaded, self._pending = 0.0, False, None
        self.registers.lose_power()
        self.fold()

    def step(self, now_s: float, dt_s: float) -> ServoDrive:
        """One step of the firmware: protections, then the loop. Returns what the power stage is told."""
        self._watch_health(dt_s)
        if self.registers.get("torque_enable") != 1 or now_s < self._silent_until_s or not self.powered:
            return ServoDrive()
        self._advance_setpoint(dt_s)
        error = self._setpoint - self._present_steps()
        if abs(error) <= self.registers.get("cw_dead_zone"):
            error = 0.0
        limit = self._torque_limit()
        duty = error * _RAD_PER_STEP * self.registers.get("p_coefficient") * DUTY_PER_RAD
        return ServoDrive(max(-limit, min(limit, duty)), math.inf)

    def _torque_limit(self) -> float:
        get = self.registers.get
        limit = min(get("torque_limit"), get("max_torque"))
        if self._is_overloaded:
            limit = min(limit, get("max_torque") * get("protective_torque") // 100)
        return limit / _FULL_SCALE

    def _advance_setpoint(self, dt_s: float) -> None:
        get = self.registers.get
        goal = _signed(get("goal_position"), 15)
        if get("min_angle_limit") or get("max_angle_limit"):
            goal = max(get("min_angle_limit"), min(get("max_angle_limit"), goal))
        goal = max(-_MAX_STEPS, min(_MAX_STEPS, goal))
        speed = abs(_signed(get("goal_speed"), 15)) * (1.0 if get("phase") & _FINE_SPEED else _STEPS_PER_S_COARSE)
        step = (min(speed, _FASTEST_STEPS_PER_S) if speed else _FASTEST_STEPS_PER_S) * dt_s
        self._setpoint += max(-step, min(step, goal - self._setpoint))

    def _watch_health(self, dt_s: float) -> None:
        get, shaft = self.registers.get, self.shaft
        bits = self.forced_error_bits
        if not (get("min_input_voltage") - 0.5) / 10.0 <= shaft.supply_v <= (get("max_input_voltage") + 0.5) / 10.0:
            bits |= FeetechStatus.VOLTAGE
        if shaft.temperature_c > get("max_temperature_limit"):
            bits |= FeetechStatus.TEMPERATURE
        if abs(shaft.duty) * 100.0 > get("overload_torque"):
            self._overload_s += dt_s
        elif self._overload_s:
            self._overload_s = max(0.0, self._overload_s - dt_s)
        if self._overload_s > get("protection_time") * _OVERLOAD_UNIT_S or bits & FeetechStatus.OVERLOAD:
            self._is_overloaded = True
        if self._is_overloaded:
            bits |= FeetechStatus.OVERLOAD
        self.registers.put("status", bits)
        # An overload lowers the torque instead (holding torque, 34).
        if bits & get("unloading_condition") & ~FeetechStatus.OVERLOAD:
            self.registers.put("torque_enable", 0)

    # -- encoder ---------------------------------------------------------------------------------------------------

    def fold(self) -> None:
        """The encoder knows the angle within one turn only: forget the turns."""
        self._fold_steps = math.floor(self.shaft.angle_rad / _RAD_PER_STEP / _STEPS_PER_TURN) * _STEPS_PER_TURN
        self._setpoint = self._present_steps()

    def _present_steps(self) -> float:
        """Where it says it is: "Present_Position = Actual_Position - Homing_Offset" (LeRobot, feetech.py)."""
        offset = _signed(self.registers.get("position_offset"), 11)
        return self.shaft.angle_rad / _RAD_PER_STEP - self._fold_steps - offset

    def _refresh(self) -> None:
        shaft, put, get = self.shaft, self.registers.put, self.registers.get
        position = math.floor(self._present_steps() + 0.5) + self.position_glitch_pulses
        if not get("phase") & _COUNTS_TURNS:
            position %= _STEPS_PER_TURN
        coarse = round(shaft.velocity_rad_s / _RAD_PER_STEP / _STEPS_PER_S_COARSE)
        speed = coarse * round(_STEPS_PER_S_COARSE) if get("phase") & _FINE_SPEED else coarse
        put("present_position", _sign_magnitude(position, 15))
        put("present_speed", _sign_magnitude(speed, 15))
        put("present_load", _sign_magnitude(round(shaft.duty * _FULL_SCALE), 10))
        put("present_voltage", max(0, round(shaft.supply_v * 10.0)))
        put("present_temperature", max(0, min(255, round(shaft.temperature_c))))
        put("moving", int(coarse != 0))
        put("present_goal", get("goal_position"))
        current = shaft.current_a / self.model.motor.current_unit_a
        put("present_current", _sign_magnitude(round(current), 15))


def _signed(value: int, bit: int) -> int:
    magnitude = value & ((1 << bit) - 1)
    return -magnitude if value >> bit & 1 else magnitude


def _sign_magnitude(value: int, bit: int) -> int:
    top = (1 << bit) - 1
    return min(abs(value), top) | (1 << bit if value < 0 else 0)


def servos_with(servos: Sequence[EmulatedFeetechServo], device_id: int) -> list[EmulatedFeetechServo]:
    """Those that an instruction is for."""
    return [servo for servo in servos if servo.device_id == device_id]
