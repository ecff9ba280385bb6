# SPDX-License-Identifier: Apache-2.0
"""Everything that can be made to go wrong, by name: at once, for a while, at a time, or at random from a seed."""

from __future__ import annotations

import inspect
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from softgrip_emulator.dynamixel.servo import EmulatedHardwareError
from softgrip_emulator.errors import EmulatorError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from softgrip_emulator.camera.camera_process import CameraProcess
    from softgrip_emulator.clock import SetClock
    from softgrip_emulator.plant.cell import CellPlant
    from softgrip_emulator.rig import EmulatedRig
    from softgrip_emulator.wire.faulty import FaultyWire
    from softgrip_emulator.wire.pty import DrivenPort
    from softgrip_emulator.wire.usb_adapter import UsbAdapter

    Undo = Callable[[], None]
    Cause = Callable[..., Undo]


@dataclass(frozen=True)
class ScheduledFault:
    """One row of a fault plan: what, on what, when and how long.

    Attributes:
        at_s: cell time [s].
        duration_s: 0 = until cleared.
    """

    fault: str
    at_s: float
    target: str = ""
    duration_s: float = 0.0
    arguments: Mapping[str, object] | None = None


@dataclass
class _Active:
    label: str
    undo: Undo
    until_s: float | None


def read_plan(text: str) -> list[ScheduledFault]:
    """A fault plan from YAML: a list of mappings `{fault, at_s, target, duration_s, arguments}`, or `random: {...}`.

    `random: {seed: 1, count: 10, within_s: 60, longest_s: 2, faults: [names], targets: [tendons]}` draws a plan.

    Raises:
        EmulatorError: not such a list.
    """
    try:
        data = yaml.safe_load(text) or []
        if isinstance(data, dict) and set(data) == {"random"}:
            return random_plan(**data["random"])
        return sorted((ScheduledFault(**row) for row in data), key=lambda row: row.at_s)
    except (yaml.YAMLError, TypeError, ValueError) as error:
        raise EmulatorError(
            "fault plan: expected a YAML list of {fault, at_s, target, duration_s, arguments} or a mapping 'random' of "
            f"{{seed, count, within_s, longest_s, faults, targets}}, found: {error}"
        ) from error


def random_plan(
    seed: int,
    count: int = 10,
    within_s: float = 60.0,
    longest_s: float = 2.0,
    faults: Sequence[str] = (),
    targets: Sequence[str] = (),
) -> list[ScheduledFault]:
    """Faults at random times from a seed; the same seed gives the same plan.

    Args:
        seed: of everything drawn.
        count: of the faults.
        within_s: they begin within this time.
        longest_s: none lasts for longer.
        faults: names to draw from; those of servos, bus and tendons when none is given.
        targets: tendons or servo IDs that faults of one drive draw from; the first tendon when none is given.
    """
    rng = np.random.default_rng([seed, 0x464C])
    names = list(faults) or sorted(BUS_FAULTS)
    rows = []
    for _ in range(count):
        name = names[int(rng.integers(len(names)))]
        at_s, duration_s = float(rng.uniform(0.0, within_s)), float(rng.uniform(0.05, longest_s))
        drawn = targets and name in BUS_FAULTS and _concerns_a_drive(BUS_FAULTS[name])
        target = str(targets[int(rng.integers(len(targets)))]) if drawn else ""
        rows.append(ScheduledFault(name, at_s, target, duration_s))
    return sorted(rows, key=lambda row: row.at_s)


@dataclass
class _Held:
    """An attribute that faults hold: what it is without them, and what each of them wants, the latest last."""

    thing: object
    without: object
    requested: dict[object, object] = field(default_factory=dict)


class Overrides:
    """Attributes that faults hold. Of several faults on one the latest counts; the last to end leaves it as it was."""

    def __init__(self) -> None:
        self._held: dict[tuple[int, str], _Held] = {}  # each holds its thing, so that no other one gets its id

    def set(self, thing: object, **values: object) -> Undo:
        """Give attributes other values; returns what ends it."""
        fault = object()
        for name, value in values.items():
            held = self._held.setdefault((id(thing), name), _Held(thing, getattr(thing, name)))
            held.requested[fault] = value
            setattr(thing, name, value)
        return lambda: self._end(fault, thing, tuple(values))

    def _end(self, fault: object, thing: object, names: Sequence[str]) -> None:
        for name in names:
            held = self._held.get((id(thing), name))
            if held is None or fault not in held.requested:
                continue
            del held.requested[fault]
            setattr(thing, name, [held.without, *held.requested.values()][-1])
            if not held.requested:
                del self._held[(id(thing), name)]


@dataclass(frozen=True)
class FaultyDevices:
    """What of one cell can fail, and the clock by which faults begin and end."""

    clock: SetClock
    plant: CellPlant
    bus_wire: FaultyWire
    adapter: UsbAdapter
    bus_port: DrivenPort
    camera: CameraProcess
    rig: EmulatedRig
    overrides: Overrides = field(default_factory=Overrides)


class FaultBoard:
    """Injects and clears faults on the devices of one cell."""

    def __init__(self, cell: FaultyDevices) -> None:
        self._cell = cell
        self._lock = threading.RLock()
        self._active: list[_Active] = []
        self._plan: list[ScheduledFault] = []

    @property
    def known(self) -> tuple[str, ...]:
        """Names of all faults."""
        return tuple(sorted([*BUS_FAULTS, *CAMERA_FAULTS, *HANDS, *self._cell.rig.faults]))

    @property
    def active(self) -> tuple[str, ...]:
        """Labels (`name` or `name@target`) of the faults that are on."""
        return tuple(fault.label for fault in self._active)

    def inject(
        self, fault: str, target: str = "", duration_s: float = 0.0, arguments: Mapping[str, object] | None = None
    ) -> None:
        """Make something go wrong.

        Args:
            fault: one of `known`, or "clear" (all, or those on `target`, or the one named by `target`).
            target: tendon or servo ID for faults of one drive; empty = the first.
            duration_s: 0 = until cleared.
            arguments: fault-specific numbers; see the functions below.

        Raises:
            EmulatorError: no such fault, target or argument.
        """
        if fault == "clear":
            self.clear(target)
            return
        if not duration_s >= 0.0:
            raise EmulatorError(f"fault '{fault}': expected a duration of 0 or more seconds, found {duration_s}")
        with self._lock:
            # One that is on already starts again, perhaps with other arguments.
            label, cause = self._prepared(fault, target, dict(arguments or {}))
            self._end([one for one in self._active if one.label == label])
            undo = cause()
            until_s = self._cell.clock.now_s() + duration_s if duration_s > 0.0 else None
            self._active.append(_Active(label, undo, until_s))

    def clear(self, which: str = "") -> None:
        """End all faults, or those of one name, target or label."""
        with self._lock:
            self._end([f for f in self._active if not which or which in {f.label, *f.label.split("@")}])

    def _end(self, ending: Sequence[_Active]) -> None:
        self._active = [one for one in self._active if one not in ending]
        for fault in reversed(ending):
            fault.undo()

    def follow(self, plan: Sequence[ScheduledFault]) -> None:
        """Inject these at their times (cell time [s]).

        Raises:
            EmulatorError: a row names no known fault.
        """
        for row in plan:
            if row.fault not in self.known:
                raise EmulatorError(f"fault plan: expected names of {list(self.known)}, found '{row.fault}'")
        with self._lock:
            self._plan = sorted(plan, key=lambda row: row.at_s)

    def tick(self, now_s: float) -> None:
        """Start what is due and end what is over; called by the cell's thread."""
        if not self._plan and not self._active:
            return
        with self._lock:
            while self._plan and self._plan[0].at_s <= now_s:
                row = self._plan.pop(0)
                self.inject(row.fault, row.target, row.duration_s, row.arguments)
            self._end([f for f in self._active if f.until_s is not None and f.until_s <= now_s])

    def _prepared(self, fault: str, target: str, arguments: dict[str, object]) -> tuple[str, Callable[[], Undo]]:
        """Return the label of a fault and what starts it."""
        cell = self._cell
        label = f"{fault}@{target}" if target else fault
        if fault in cell.rig.faults:
            return label, lambda: self._on_the_rig(fault, arguments)
        cause = BUS_FAULTS.get(fault) or CAMERA_FAULTS.get(fault) or HANDS.get(fault)
        if cause is None:
            raise EmulatorError(f"fault: expected one of {list(self.known)} or 'clear', found '{fault}'")
        if _concerns_a_drive(cause):
            arguments["slot"] = self._slot(target)
            label = f"{fault}@{arguments['slot']}"
        elif target:
            raise EmulatorError(f"fault '{fault}': expected no target, it concerns the whole bus or camera")
        return label, lambda: self._started(fault, cause, arguments)

    def _on_the_rig(self, fault: str, arguments: dict[str, Any]) -> Undo:
        rig = self._cell.rig
        rig.inject(fault, **arguments)
        return lambda: rig.clear(fault)

    def _started(self, fault: str, cause: Cause, arguments: dict[str, object]) -> Undo:
        try:
            _check_numbers(cause, arguments)
            return cause(self._cell, **arguments)
        except (TypeError, ValueError) as error:
            known = [name for name in inspect.signature(cause).parameters if name not in {"cell", "slot"}]
            raise EmulatorError(f"fault '{fault}': expected arguments of {known}, found: {error}") from error

    def _slot(self, target: str) -> str:
        plant = self._cell.plant
        if not target:
            return plant.slots[0]
        if target.isdigit():
            for place, servo in zip(plant.places, plant.servos, strict=True):
                if servo.device_id == int(target):
                    return place.slot
        plant.index(target)
        return target


# -- the causes: each starts a fault and returns what ends it ---------------------------------------------------------


def _check_numbers(cause: Cause, arguments: Mapping[str, object]) -> None:
    for name, one in inspect.signature(cause).parameters.items():
        value = arguments.get(name, one.default)
        if isinstance(one.default, int | float) and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise TypeError(f"{name}: {value!r} where a number is expected")


def _concerns_a_drive(cause: Cause) -> bool:
    return "slot" in inspect.signature(cause).parameters


def _forget(values: dict[str, float], slot: str) -> None:
    values.pop(slot, None)


def _bytes_lost(cell: FaultyDevices, share: float = 0.02) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, lost=float(share))


def _bytes_flipped(cell: FaultyDevices, share: float = 0.02) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, flipped=float(share))


def _bytes_duplicated(cell: FaultyDevices, share: float = 0.02) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, duplicated=float(share))


def _bytes_delayed(cell: FaultyDevices, delay_s: float = 0.05, share: float = 1.0) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, delay_s=float(delay_s), delayed=float(share))


def _adapter_latency(cell: FaultyDevices, latency_s: float = 0.016) -> Undo:
    return cell.overrides.set(cell.adapter, latency_s=float(latency_s))


def _crc_error(cell: FaultyDevices, share: float = 1.0) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, spoiled=float(share))


def _bus_dead(cell: FaultyDevices) -> Undo:
    return cell.overrides.set(cell.bus_wire.faults, dead=True)


def _unplugged(cell: FaultyDevices) -> Undo:
    cell.bus_port.unplug()
    return cell.bus_port.plug


def _servo_silent(cell: FaultyDevices, slot: str) -> Undo:
    return cell.overrides.set(cell.plant.servos[cell.plant.index(slot)], silenced=True)


def _servo_unplugged(cell: FaultyDevices, slot: str) -> Undo:
    # It boots when it is plugged in again: the plant sees the voltage come back.
    return cell.overrides.set(cell.plant.servos[cell.plant.index(slot)], is_connected=False)


def _alert(cell: FaultyDevices, slot: str, bits: int = EmulatedHardwareError.ELECTRICAL_SHOCK) -> Undo:
    # The bits stay until the servo is rebooted, as on the real one.
    return cell.overrides.set(cell.plant.servos[cell.plant.index(slot)], forced_error_bits=int(bits))


def _overload(cell: FaultyDevices, slot: str) -> Undo:
    return _alert(cell, slot, EmulatedHardwareError.OVERLOAD)


def _overheating(cell: FaultyDevices, slot: str, temperature_c: float = 71.0) -> Undo:
    shaft = cell.plant.servos[cell.plant.index(slot)].shaft
    with cell.plant.lock:
        shaft.temperature_c = shaft.winding_c = float(temperature_c)
    # A motor that was heated cools by itself.
    return lambda: None


def _heating(cell: FaultyDevices, slot: str, power_w: float = 6.0) -> Undo:
    cell.plant.disturbances.extra_heat_w[slot] = float(power_w)
    return lambda: _forget(cell.plant.disturbances.extra_heat_w, slot)


def _brown_out(cell: FaultyDevices, voltage_v: float = 2.5) -> Undo:
    return cell.overrides.set(cell.plant.disturbances, supply_v=float(voltage_v))


def _silent_reboot(cell: FaultyDevices, slot: str) -> Undo:
    with cell.plant.lock:
        cell.plant.servos[cell.plant.index(slot)].lose_power(cell.plant.now_s)
    return lambda: None


def _wrong_baud(cell: FaultyDevices, slot: str, register: int = 1) -> Undo:
    registers = cell.plant.servos[cell.plant.index(slot)].registers
    before = registers.get("baud_rate")
    registers.put("baud_rate", int(register))
    return lambda: registers.put("baud_rate", before)


def _position_glitch(cell: FaultyDevices, slot: str, pulses: int = -4095) -> Undo:
    return cell.overrides.set(cell.plant.servos[cell.plant.index(slot)], position_glitch_pulses=int(pulses))


def _tendon_break(cell: FaultyDevices, slot: str) -> Undo:
    broken = cell.plant.disturbances.broken_tendons
    broken.add(slot)
    return lambda: broken.discard(slot)


def _slack(cell: FaultyDevices, slot: str, length_m: float = 0.010) -> Undo:
    slack = cell.plant.disturbances.extra_slack_m
    slack[slot] = float(length_m)
    return lambda: _forget(slack, slot)


def _jammed(cell: FaultyDevices, slot: str) -> Undo:
    jammed = cell.plant.disturbances.jammed
    jammed.add(slot)
    return lambda: jammed.discard(slot)


def _camera_frozen(cell: FaultyDevices) -> Undo:
    return cell.overrides.set(cell.camera.faults, frozen=True)


def _camera_dropped(cell: FaultyDevices, share: float = 0.5) -> Undo:
    return cell.overrides.set(cell.camera.faults, drop_share=float(share))


def _camera_dark(cell: FaultyDevices, gain: float = 0.08) -> Undo:
    return cell.overrides.set(cell.camera.faults, gain=float(gain))


def _camera_overexposed(cell: FaultyDevices, gain: float = 3.0) -> Undo:
    return cell.overrides.set(cell.camera.faults, gain=float(gain))


def _camera_defocused(cell: FaultyDevices, blur_px: float = 5.0) -> Undo:
    return cell.overrides.set(cell.camera.faults, blur_px=float(blur_px))


def _marker_missing(cell: FaultyDevices, marker: int = 2) -> Undo:
    return cell.overrides.set(cell.camera.faults, missing_marker=int(marker))


def _room_temperature(cell: FaultyDevices, temperature_c: float = 30.0) -> Undo:
    return cell.overrides.set(cell.plant, temperature_c=float(temperature_c))


def _gauge_in_tendon(cell: FaultyDevices, slot: str) -> Undo:
    index = cell.plant.index(slot)
    cell.rig.hang_gauge(lambda: float(cell.plant.bank.tension_n[index]))
    return lambda: cell.rig.hang_gauge(None)


BUS_FAULTS: dict[str, Cause] = {
    "bytes_lost": _bytes_lost,
    "bytes_flipped": _bytes_flipped,
    "bytes_duplicated": _bytes_duplicated,
    "bytes_delayed": _bytes_delayed,
    "crc_error": _crc_error,
    "bus_dead": _bus_dead,
    "bus_unplugged": _unplugged,
    "servo_silent": _servo_silent,
    "servo_unplugged": _servo_unplugged,
    "alert": _alert,
    "overload": _overload,
    "overheating": _overheating,
    "heating": _heating,
    "brown_out": _brown_out,
    "silent_reboot": _silent_reboot,
    "wrong_baud": _wrong_baud,
    "position_glitch": _position_glitch,
    "tendon_break": _tendon_break,
    "slack": _slack,
    "spool_jammed": _jammed,
}
"""Faults of servos, their bus and the tendons."""

CAMERA_FAULTS: dict[str, Cause] = {
    "camera_frozen": _camera_frozen,
    "camera_dropped": _camera_dropped,
    "camera_dark": _camera_dark,
    "camera_overexposed": _camera_overexposed,
    "camera_defocused": _camera_defocused,
    "marker_missing": _marker_missing,
}
"""Faults of the camera."""

HANDS: dict[str, Cause] = {
    "adapter_latency": _adapter_latency,
    "gauge_in_tendon": _gauge_in_tendon,
    "room_temperature": _room_temperature,
}
"""What a person does at the bench or to the room, through the same door; no plan draws it."""
