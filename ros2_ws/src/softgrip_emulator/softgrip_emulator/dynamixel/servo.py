# SPDX-License-Identifier: Apache-2.0
"""One X-series servo: executes instructions on its registers and behaves as its firmware does.

Behaviours beyond the plain table are those of the e-manual and of users' reports: mode changes reset gains and goals,
the turn count is lost with power, shutdown, bus watchdog, silence while rebooting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from softgrip_emulator.dynamixel.instructions import InstructionReply, Instructions
from softgrip_emulator.dynamixel.motion import (
    POSITION_MODES,
    PULSES_PER_S_PER_VELOCITY_UNIT,
    ServoDrive,
    ServoMode,
    ServoMotion,
)
from softgrip_emulator.dynamixel.packets import ALERT, Instruction, Packet, StatusError
from softgrip_emulator.dynamixel.registers import GAIN_ITEMS, PresentValues, Registers, WriteRefusedError
from softgrip_emulator.dynamixel.table import (
    BAUD_OF_REGISTER,
    EEPROM_END,
    PULSES_PER_TURN,
    PWM_FULL_SCALE,
    VELOCITY_UNIT_RPM,
    EmulatedServoModel,
    OverloadWatch,
)

REBOOT_SILENCE_S: Final = 0.4
"""Measured by a user on an XC330 (emanual#1698); ROBOTIS gives no figure."""
FACTORY_ID: Final = 1
FACTORY_BAUD: Final = 57_600
"""As a servo comes (e-manual, ID(7) and Baud Rate(8))."""
_RAD_PER_PULSE: Final = 2.0 * math.pi / PULSES_PER_TURN
_WATCHDOG_UNIT_S: Final = 0.02
_TICK_MODULO: Final = 32768
_TRIPPED: Final = -1
"""Bus Watchdog after it has tripped (e-manual)."""
_OFF: Final = ServoDrive()
_REVERSE: Final = 0x01
_NO_ID: Final = 253
_FOLLOWED: Final = frozenset({Instruction.WRITE, Instruction.REG_WRITE, Instruction.ACTION, Instruction.REBOOT})
_TORQUE_ON_BY_GOAL: Final = 0x08
_STARTUP_TORQUE_ON: Final = 0x01
_STARTUP_RAM_RESTORE: Final = 0x02
_SINGLE_TURN_OFFSET: Final = 1024
_EARLY_OVERLOAD: Final = OverloadWatch(0.40, 5.0)
"""As a user saw it of an XM430: 41 % for "around 5s" (ROBOTIS-GIT/DynamixelSDK issue 285)."""


class EmulatedHardwareError:
    """Bits of Hardware Error Status (70)."""

    INPUT_VOLTAGE: Final = 0x01
    OVERHEATING: Final = 0x04
    MOTOR_ENCODER: Final = 0x08
    ELECTRICAL_SHOCK: Final = 0x10
    OVERLOAD: Final = 0x20


@dataclass(slots=True)
class Shaft:
    """Where servo and plant meet: the plant writes what is, the servo reads it as its sensors would.

    Angle counts all turns and grows as the spool winds; the servo's encoder knows it only within one turn. `current_a`
    is the winding's; `temperature_c` is the case's, where the servo's sensor is.
    """

    angle_rad: float = 0.0
    velocity_rad_s: float = 0.0
    current_a: float = 0.0
    duty: float = 0.0
    supply_v: float = 5.0
    temperature_c: float = 25.0
    winding_c: float = 25.0

    @property
    def supply_current_a(self) -> float:
        """What the power stage takes from the supply: the winding's current, for the duty cycle's share of the time."""
        return abs(self.duty) * self.current_a


class _Settings(NamedTuple):
    """What the firmware looks at in every step, decoded from the registers."""

    torque_on: bool
    error_bits: int
    shutdown: int
    lowest_v: float
    highest_v: float
    temperature_limit_c: int
    stall_a: float
    watchdog: int
    direction: float
    homing_offset: int

    @classmethod
    def decoded(cls, registers: Registers) -> _Settings:
        get = registers.get
        return cls(
            torque_on=bool(get("torque_enable")),
            error_bits=get("hardware_error_status"),
            shutdown=get("shutdown"),
            lowest_v=(get("min_voltage_limit") - 0.5) / 10.0,
            highest_v=(get("max_voltage_limit") + 0.5) / 10.0,
            temperature_limit_c=get("temperature_limit"),
            stall_a=registers.model.motor.stall_current_a,
            watchdog=get("bus_watchdog"),
            direction=-1.0 if get("drive_mode") & _REVERSE else 1.0,
            homing_offset=_homing_offset(registers),
        )


class EmulatedServo:
    """Registers, firmware and encoder of one servo.

    `execute` is called for each packet it must obey, `step` by the plant. Both on the same lock (the cell's).
    """

    def __init__(
        self,
        model: EmulatedServoModel,
        device_id: int,
        *,
        baud: int = FACTORY_BAUD,
        return_delay_us: int = 500,
        limits_winding: bool = False,
        trips_early: bool = False,
    ) -> None:
        """Make a servo as delivered.

        Args:
            model: its control table and motor.
            device_id: on the bus.
            baud: speed it listens at [bit/s].
            return_delay_us: pause before a status packet [us].
            limits_winding: Goal Current limits the winding's current also where it is the supply's that it reports.
                Which of them an XL330 or XC330 limits, the e-manual ("Goal Current(102)") does not say.
            trips_early: its overload shutdown comes as early as a user saw one, also in a model that nobody saw.
        """
        self.model = model
        self._limits_supply = model.senses_supply_current and not limits_winding
        self.registers = Registers(model)
        self.shaft = Shaft(supply_v=model.motor.nominal_voltage_v)
        self.registers.put("id", device_id)
        self.registers.put("baud_rate", _baud_register(baud))
        self.registers.put("return_delay_time", return_delay_us // 2)
        self.motion = ServoMotion(self.registers)
        self._decoded = _Settings.decoded(self.registers)
        self._decoded_at = self.registers.changes
        self._fold_pulses = 0
        self._silent_until_s = 0.0
        self._powered_since_s = 0.0
        self._last_packet_s = 0.0
        self._overload = _EARLY_OVERLOAD if trips_early else model.overload
        self._overload_s = 0.0
        self._instructions = Instructions(self)
        self.position_glitch_pulses = 0
        self.forced_error_bits = 0
        self.silenced = False
        self.is_connected = True
        self.fold()

    # -- on the bus ------------------------------------------------------------------------------------------------

    @property
    def device_id(self) -> int:
        """ID on the bus."""
        return self.registers.get("id")

    def obeys(self, device_id: int, address: int) -> bool:
        """Whether a write to an ID concerns it: its own, or its Secondary ID, which opens the RAM only."""
        return device_id == self.device_id or (self._shadows(device_id) and address >= EEPROM_END)

    def _shadows(self, device_id: int) -> bool:
        # An ID of its own has priority; 253 and above switch the Secondary ID off (e-manual, "Secondary ID(12)").
        return device_id < _NO_ID and self.registers.get("secondary_id") == device_id != self.device_id

    def follow(self, packet: Packet, now_s: float) -> None:
        """Obey what is written to its Secondary ID, without an answer."""
        writes = packet.instruction in {Instruction.WRITE, Instruction.REG_WRITE}
        address = int.from_bytes(packet.parameters[:2], "little") if writes else EEPROM_END
        if packet.instruction in _FOLLOWED and self._shadows(packet.device_id) and address >= EEPROM_END:
            self.execute(packet, now_s)

    @property
    def baud(self) -> int:
        """The speed it listens at [bit/s]."""
        return BAUD_OF_REGISTER[self.registers.get("baud_rate")]

    @property
    def return_delay_s(self) -> float:
        """Pause before a status packet."""
        return self.registers.get("return_delay_time") * 2e-6

    def listens(self, now_s: float, baud: int) -> bool:
        """Whether it hears a packet now: powered, booted, same speed, not made silent by a fault."""
        return not self.silenced and self.powered and now_s >= self._silent_until_s and baud == self.baud

    @property
    def holds(self) -> bool:
        """Whether its torque is on."""
        return bool(self.registers.get("torque_enable"))

    @property
    def powered(self) -> bool:
        """Whether it hangs on the cable, and the supply keeps its processor alive."""
        return self.is_connected and self.shaft.supply_v > self.model.motor.brown_out_v

    @property
    def alert(self) -> int:
        """What every status carries while the hardware error status is not zero."""
        return ALERT if self.registers.get("hardware_error_status") else 0

    def heard(self, now_s: float) -> None:
        """Any instruction packet on the bus feeds the watchdog."""
        self._last_packet_s = now_s

    def read_for_host(self, address: int, length: int, now_s: float) -> InstructionReply:
        """Read registers for Read, Sync Read, Bulk Read."""
        self._refresh(now_s)
        data = self.registers.read(address, length)
        if data is None:
            return InstructionReply(StatusError.ACCESS | self.alert)
        return InstructionReply(self.alert, data)

    def write_for_host(self, address: int, data: bytes, now_s: float) -> InstructionReply:
        """Write registers for Write, Sync Write, Bulk Write."""
        try:
            assignments = self.registers.check(address, data)
        except WriteRefusedError as refusal:
            return InstructionReply(refusal.error | self.alert)
        self.registers.assign(assignments, lambda name, before: self._react(name, before, now_s))
        return InstructionReply(self.alert)

    def answers(self, instruction: int) -> bool:
        """Whether the Status Return Level lets it answer."""
        level = self.registers.get("status_return_level")
        if instruction == Instruction.PING:
            return True
        reads = {
            Instruction.READ,
            Instruction.SYNC_READ,
            Instruction.BULK_READ,
            Instruction.FAST_SYNC_READ,
            Instruction.FAST_BULK_READ,
        }
        return level >= (1 if instruction in reads else 2)

    def execute(self, packet: Packet, now_s: float) -> InstructionReply:
        """Obey one instruction that is addressed to this servo alone or to all."""
        return self._instructions.execute(packet, now_s)

    # -- firmware behaviour ----------------------------------------------------------------------------------------

    def _react(self, name: str, before: int, now_s: float) -> None:
        """Side effects of a write (e-manual, notes of the items)."""
        registers = self.registers
        if name == "torque_enable":
            self._torque_switched(on=bool(registers.get(name)), was_on=bool(before), now_s=now_s)
        elif name == "operating_mode" and registers.get(name) != before:
            self._mode_changed()
        elif name == "bus_watchdog":
            self._last_packet_s = now_s
        elif name == "goal_position" and registers.get("drive_mode") & _TORQUE_ON_BY_GOAL:
            goal = registers.get("goal_position")
            if not registers.get("torque_enable"):
                registers.put("torque_enable", 1)
                self._torque_switched(on=True, was_on=False, now_s=now_s)
                registers.put("goal_position", goal)

    def _torque_switched(self, *, on: bool, was_on: bool, now_s: float) -> None:
        if on and self.registers.get("hardware_error_status") & self.registers.get("shutdown"):
            # Shut down: only a reboot brings the torque back.
            self.registers.put("torque_enable", 0)
            return
        if on and not was_on:
            if self.registers.get("operating_mode") == ServoMode.POSITION:
                self.fold()
            self._last_packet_s = now_s
            present = self._present_pulses()
            self.registers.put("goal_position", round(present))
            self.motion.restart(present)

    def _mode_changed(self) -> None:
        for item in self.model.items:
            if item.name in GAIN_ITEMS:
                self.registers.put(item.name, item.default)
        self.registers.put_goals_to_limits()
        self.registers.put("goal_velocity", 0)
        if self.registers.get("operating_mode") == ServoMode.POSITION:
            self.fold()
        self.motion.restart(self._present_pulses())

    def lose_power(self, now_s: float) -> None:
        """Reboot or supply failure: RAM and turn count are gone, silence while it boots, errors are cleared."""
        self._silent_until_s = now_s + REBOOT_SILENCE_S
        self._powered_since_s = self._silent_until_s
        self._instructions.forget()
        self._overload_s = 0.0
        self.forced_error_bits = 0
        self.registers.lose_power()
        if self.registers.get("startup_configuration") & _STARTUP_RAM_RESTORE:
            self._instructions.restore_ram()
        self.fold()
        self.registers.put("goal_position", round(self._present_pulses()))
        if self.registers.get("startup_configuration") & _STARTUP_TORQUE_ON:
            self.registers.put("torque_enable", 1)
        self.motion.restart(self._present_pulses())

    def step(self, now_s: float, dt_s: float) -> ServoDrive:
        """One step of the firmware: watchdogs and shutdown, then the loop. Returns what the power stage is told."""
        self._watch_health(dt_s)
        settings = self._settings
        if not settings.torque_on or now_s < self._silent_until_s or not self.powered:
            return _OFF
        self._watch_bus(settings.watchdog, now_s)
        settings = self._settings
        velocity = settings.direction * self.shaft.velocity_rad_s / _RAD_PER_PULSE
        asked = self.motion.drive(self._present_pulses(), velocity, dt_s, follow=settings.watchdog != _TRIPPED)
        return ServoDrive(settings.direction * asked.duty, asked.current_limit_a, self._limits_supply)

    def _watch_bus(self, timeout: int, now_s: float) -> None:
        if timeout > 0 and now_s - self._last_packet_s > timeout * _WATCHDOG_UNIT_S:
            self.registers.put("bus_watchdog", _TRIPPED)
            self.motion.stop_at(self._present_pulses())

    def _watch_health(self, dt_s: float) -> None:
        settings, shaft = self._settings, self.shaft
        bits = settings.error_bits | self.forced_error_bits
        if not settings.lowest_v <= shaft.supply_v <= settings.highest_v:
            bits |= EmulatedHardwareError.INPUT_VOLTAGE
        if shaft.temperature_c > settings.temperature_limit_c:
            bits |= EmulatedHardwareError.OVERHEATING
        if abs(shaft.current_a) > self._overload.share * settings.stall_a:
            self._overload_s += dt_s
        elif self._overload_s:
            self._overload_s = max(0.0, self._overload_s - dt_s)
        if self._overload_s > self._overload.seconds:
            bits |= EmulatedHardwareError.OVERLOAD
        if bits != settings.error_bits:
            self.registers.put("hardware_error_status", bits)
        if settings.torque_on and bits & settings.shutdown:
            self.registers.put("torque_enable", 0)

    @property
    def _settings(self) -> _Settings:
        if self._decoded_at != self.registers.changes:
            self._decoded = _Settings.decoded(self.registers)
            self._decoded_at = self.registers.changes
        return self._decoded

    # -- encoder ---------------------------------------------------------------------------------------------------

    def _raw_pulses(self) -> float:
        return self.shaft.angle_rad / _RAD_PER_PULSE

    def fold(self) -> None:
        """The encoder knows the angle within one turn only: forget the turns."""
        self._fold_pulses = math.floor(self._raw_pulses() / PULSES_PER_TURN) * PULSES_PER_TURN

    def _present_pulses(self) -> float:
        settings = self._settings
        return settings.direction * (self._raw_pulses() - self._fold_pulses) + settings.homing_offset

    def moving(self) -> bool:
        """Whether it turns faster than its moving threshold."""
        speed_rpm = abs(self.shaft.velocity_rad_s) * 60.0 / (2.0 * math.pi)
        return speed_rpm > self.registers.get("moving_threshold") * VELOCITY_UNIT_RPM

    def _effort(self) -> float:
        """Present Current, or Present Load: "an inferred value based on the internal output value", 0.1 % a unit."""
        if not self.model.has_current:
            return 1000.0 * self.shaft.duty
        current_a = self.shaft.supply_current_a if self.model.senses_supply_current else self.shaft.current_a
        return current_a / self.model.motor.current_unit_a

    def _refresh(self, now_s: float) -> None:
        """Bring the read-only items up to date."""
        registers, shaft, sign = self.registers, self.shaft, self._settings.direction
        position = math.floor(self._present_pulses() + 0.5) + self.position_glitch_pulses
        in_position = registers.get("operating_mode") in POSITION_MODES and (
            abs(registers.get("goal_position") - position) <= registers.get("moving_threshold")
        )
        profile = 0x02 | (0x30 if registers.get("profile_acceleration") else 0x10)
        velocity = round(sign * shaft.velocity_rad_s / _RAD_PER_PULSE / PULSES_PER_S_PER_VELOCITY_UNIT)
        registers.put_present(
            PresentValues(
                realtime_tick=int((now_s - self._powered_since_s) * 1000.0) % _TICK_MODULO,
                moving=int(self.moving()),
                moving_status=int(in_position) | (profile if self.motion.profile_active else 0),
                pwm=_within(round(sign * shaft.duty * PWM_FULL_SCALE), 16),
                current=_within(round(sign * self._effort()), 16),
                velocity=_within(velocity, 32),
                position=_within(position, 32),
                velocity_trajectory=_within(round(self.motion.velocity / PULSES_PER_S_PER_VELOCITY_UNIT), 32),
                position_trajectory=_within(round(self.motion.position), 32),
                input_voltage=max(0, round(shaft.supply_v * 10.0)),
                temperature=max(0, min(255, round(shaft.temperature_c))),
            )
        )


def _homing_offset(registers: Registers) -> int:
    """The offset that counts: in mode 3 a value beyond +-1024 is ignored (e-manual, "Homing Offset(20)")."""
    offset = registers.get("homing_offset")
    ignored = registers.get("operating_mode") == ServoMode.POSITION and abs(offset) > _SINGLE_TURN_OFFSET
    return 0 if ignored else offset


def _within(value: int, bits: int) -> int:
    top = (1 << (bits - 1)) - 1
    return max(-top - 1, min(top, value))


def _baud_register(baud: int) -> int:
    for register, speed in BAUD_OF_REGISTER.items():
        if speed == baud:
            return register
    raise ValueError(f"baud: expected one of {sorted(BAUD_OF_REGISTER.values())}, found {baud}")
