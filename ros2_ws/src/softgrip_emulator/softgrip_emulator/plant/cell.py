# SPDX-License-Identifier: Apache-2.0
"""The whole plant: servos, motors, tendons, fingers and the product, stepped together on the cell's clock."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.plant.fingers import FingerBank, run_in
from softgrip_emulator.plant.grasp import PlantGrasp
from softgrip_emulator.plant.motor import Motor
from softgrip_emulator.plant.out_of_plane import leave_plane, twist
from softgrip_emulator.plant.products import PlantProduct, product
from softgrip_emulator.plant.truth import FingerTruth, draw_finger
from softgrip_emulator.servos import make_servo

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.servos import PlantServo
    from softgrip_model.profile import Profile

    Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

SLOTS: Final = ("index", "middle", "thumb")
STEP_S: Final = 0.001
REST_STEP_S: Final = 0.004
"""Step while nothing moves; the joints' implicit step and the motors are stable and exact enough there."""
_REST_AFTER_S: Final = 0.3
_REST_SPEED_RAD_S: Final = 1e-3
_REST_CHANGE_N: Final = 0.3
"""A tension that changes by more in one long step shows that the step is too long for this posture: the friction of a
cable that was let off under a high tension turns to and fro in it."""
_OTHER_POSTURE_M: Final = 2e-4
_MAX_OFFSET_M: Final = 0.1
_MAX_LAG_S: Final = 0.1
"""Further behind the clock than this, the plant skips time instead of taking the processor from the others."""


@dataclass(frozen=True)
class Supply:
    """The servos' power supply."""

    voltage_v: float = 5.0
    resistance_ohm: float = 0.05


@dataclass(frozen=True)
class ServoPlace:
    """One servo on the chain and the tendon it winds."""

    slot: str
    device_id: int
    model: str = "XL330-M288"
    baud: int = 1_000_000
    return_delay_us: int = 500
    spool_radius_m: float = 0.010
    spool_direction: int = 1
    """-1: the tendon comes off the other side, so that a negative rotation winds it."""
    limits_winding: bool = False
    """Which current an XL330 or XC330 limits: the winding's, or the supply's (see `EmulatedServo`)."""
    trips_early: bool = False
    """Its overload shutdown comes as early as a user saw one (see `EmulatedServo`)."""


def default_chain() -> tuple[ServoPlace, ...]:
    """Index, middle and thumb on IDs 1, 2 and 3."""
    return tuple(ServoPlace(slot, number) for number, slot in enumerate(SLOTS, start=1))


@dataclass
class Disturbances:
    """What faults do to the plant; neutral by default."""

    supply_v: float | None = None
    broken_tendons: set[str] = field(default_factory=set)
    extra_slack_m: dict[str, float] = field(default_factory=dict)
    extra_heat_w: dict[str, float] = field(default_factory=dict)
    jammed: set[str] = field(default_factory=set)

    @property
    def of_tendons(self) -> bool:
        """Whether any motor or tendon is disturbed."""
        return bool(self.broken_tendons or self.extra_slack_m or self.extra_heat_w or self.jammed)


class CellPlant:
    """Everything that moves. `lock` guards all state; hold it to read several values that belong together."""

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        *,
        seed: int,
        chain: Sequence[ServoPlace] | None = None,
        supply: Supply | None = None,
    ) -> None:
        self.lock = threading.RLock()
        self.profiles = profiles
        self.seed = seed
        self.supply = supply or Supply()
        self.disturbances = Disturbances()
        self.places = tuple(chain or default_chain())
        self.slots = tuple(place.slot for place in self.places)
        rng = np.random.default_rng([seed, 0x4D4F])
        self.servos: list[PlantServo] = []
        self.motors: list[Motor] = []
        for place in self.places:
            servo = make_servo(
                place.model,
                place.device_id,
                baud=place.baud,
                return_delay_us=place.return_delay_us,
                limits_winding=place.limits_winding,
                trips_early=place.trips_early,
            )
            # Nobody knows how the spool stood when the power came on; the spool is turned to a few hundredths.
            servo.shaft.angle_rad = rng.uniform(-12.0, 12.0)
            servo.shaft.supply_v = self.supply.voltage_v
            servo.lose_power(-10.0)
            radius = place.spool_direction * place.spool_radius_m * rng.normal(1.0, 0.003)
            self.servos.append(servo)
            self.motors.append(Motor(servo.model.motor, servo.shaft, radius, rng.uniform(0.8, 1.25)))
        self.grasp = PlantGrasp(self.slots, seed)
        self._crate = np.random.default_rng([seed, 0x5052])
        self.mounted: list[FingerTruth | None] = [None] * len(self.places)
        self._memories: dict[tuple[str, str], list[float]] = {}
        # A workshop's room; nobody tells the predictor.
        self._temperature_c = float(np.random.default_rng([seed, 0x524F]).uniform(21.0, 26.0))
        self.now_s = 0.0
        self.lost_time_s = 0.0
        self._powered = [True] * len(self.servos)
        self._spool_radii_m = np.array([motor.spool_radius_m for motor in self.motors])
        self._disturbed = False
        self._rebuild(keep=())

    # -- what a person does ----------------------------------------------------------------------------------------

    def mount(self, slots: Sequence[str], serials: Sequence[str], profiles: Sequence[str]) -> None:
        """Put fingers into slots; an empty serial or profile leaves the slot empty. Slots not named stay as they are.

        Raises:
            EmulatorError: unknown slot or profile, or lists of different length.
        """
        if not len(slots) == len(serials) == len(profiles):
            raise EmulatorError(
                f"mount: expected as many serials and profiles as fingers ({len(slots)}), found {len(serials)} and "
                f"{len(profiles)}"
            )
        drawn: dict[int, FingerTruth | None] = {}
        for slot, serial, profile in zip(slots, serials, profiles, strict=True):
            index = self.index(slot)
            drawn[index] = self._draw(slot, serial, profile) if serial and profile else None
        with self.lock:
            for index, finger in drawn.items():
                self.mounted[index] = finger
                self.disturbances.broken_tendons.discard(self.slots[index])
                self.disturbances.extra_slack_m.pop(self.slots[index], None)
            self._rebuild(keep=[i for i in range(len(self.slots)) if i not in drawn])

    def place(self, name: str | PlantProduct, offset_m: float = 0.0) -> None:
        """Present the next item of a product to the fingers; an empty name takes it away.

        Args:
            name: one of the shipped products, or any other as itself.
            offset_m: from the grasp's middle, along the palm [m].

        Raises:
            EmulatorError: no such product, or an offset beyond the palm.
        """
        if not abs(offset_m) <= _MAX_OFFSET_M:
            raise EmulatorError(
                f"place: expected an offset within {_MAX_OFFSET_M} m of the grasp's middle, found {offset_m}"
            )
        kind = product(name) if name and isinstance(name, str) else name
        with self.lock:
            item = kind.copy_of(self._crate) if isinstance(kind, PlantProduct) else None
            self.grasp.place(item, next((f.profile for f in self.mounted if f is not None), ""), offset_m)
            self._calm_s = 0.0

    def lift(self) -> None:
        """Lift the arm with whatever the fingers hold."""
        with self.lock:
            self.grasp.lift()
            self._calm_s = 0.0

    def _draw(self, slot: str, serial: str, profile: str) -> FingerTruth:
        if profile not in self.profiles:
            raise EmulatorError(f"mount: expected a profile of {sorted(self.profiles)}, found '{profile}'")
        described = self.profiles[profile]
        if slot not in described.slots:
            raise EmulatorError(f"mount: profile '{profile}' has no finger for '{slot}', it has {described.slots}")
        return draw_finger(
            described.finger(slot),
            described.material,
            described.cable,
            profile=profile,
            serial=serial,
            seed=self.seed,
        )

    def _rebuild(self, keep: Sequence[int]) -> None:
        """New bank for the mounted fingers; those in `keep` stay as they are, the others start straight and loose."""
        before = getattr(self, "bank", None)
        wound = self._spool_radii_m * [servo.shaft.angle_rad for servo in self.servos]
        zero = getattr(self, "_wound_zero", wound)
        if before is not None:
            self._memories |= before.memories()
        for finger in self.mounted:
            if finger is not None and (finger.profile, finger.serial) not in self._memories:
                self._memories[finger.profile, finger.serial] = run_in(finger)
        self.bank = FingerBank(self.mounted)
        self.bank.recall(self._memories)
        self.bank.warm(self._temperature_c)
        self._wound_zero = np.array([zero[i] if i in keep else wound[i] for i in range(len(wound))])
        if before is not None:
            self.bank.adopt(before, keep)
        self._base_slack = self.bank.slack_m.copy()
        self._calm_s = 0.0
        self._restless_at_m: Array | None = None

    def index(self, slot: str) -> int:
        """Number of a slot.

        Raises:
            EmulatorError: no such slot.
        """
        if slot not in self.slots:
            raise EmulatorError(f"expected a slot of {list(self.slots)}, found '{slot}'")
        return self.slots.index(slot)

    # -- time ------------------------------------------------------------------------------------------------------

    def advance_to(self, now_s: float) -> None:
        """Live until `now_s` [s] of the cell's clock; what is read then is what is.

        Time beyond a lag that a computer in difficulties would never make up for is left out, and counted.
        """
        with self.lock:
            if now_s - self.now_s > _MAX_LAG_S:
                skipped = now_s - self.now_s - STEP_S
                self.lost_time_s += skipped
                self.now_s += skipped
            while True:
                dt_s = REST_STEP_S if self._calm_s > _REST_AFTER_S else STEP_S
                if self.now_s + dt_s > now_s:
                    return
                self.step(dt_s)

    def step(self, dt_s: float = STEP_S) -> None:
        """One step of everything."""
        with self.lock:
            self.now_s += dt_s
            supply_v = self._supply_v()
            moving = False
            tensions_n = self.bank.tension_n.tolist()
            for index, (servo, motor) in enumerate(zip(self.servos, self.motors, strict=True)):
                self._power(index, servo, supply_v)
                drive = servo.step(self.now_s, dt_s)
                motor.step(drive, tensions_n[index], supply_v, dt_s)
                moving = moving or abs(servo.shaft.velocity_rad_s) > _REST_SPEED_RAD_S
            self._apply_disturbances()
            wound_m = self.wound_m()
            self.bank.step(wound_m, dt_s, self.grasp.load(self.bank, wound_m, dt_s))
            if dt_s > STEP_S and np.abs(self.bank.tension_n - tensions_n).max() > _REST_CHANGE_N:
                self._restless_at_m = wound_m
            self._calm_s = 0.0 if moving or self._restless(wound_m) else self._calm_s + dt_s

    def _restless(self, wound_m: Array) -> bool:
        """Whether long steps are too long for the fingers as they stand."""
        if self._restless_at_m is not None and np.abs(wound_m - self._restless_at_m).max() > _OTHER_POSTURE_M:
            self._restless_at_m = None
        return self._restless_at_m is not None

    def points_m(self, index: int, ago_s: float = 0.0) -> tuple[Array, Array]:
        """Joints and tip of a mounted finger (n + 1, 3) in its base frame [m], and directions of its links (n,) [rad].

        The third coordinate is out of the plane that a camera is calibrated for.

        Args:
            index: of the slot.
            ago_s: so long before now, by the speeds of the last step [s].

        Raises:
            EmulatorError: no finger is there.
        """
        finger = self.mounted[index]
        if finger is None:
            raise EmulatorError(f"slot {self.slots[index]}: expected a mounted finger, found none")
        joints = finger.joints
        chain, headings = self.bank.chain(ago_s)
        turned = twist(
            finger,
            self.bank.q[index, :joints],
            self.bank.span_tension_n[index, : 2 * joints : 2],
            float(self.grasp.forces_n[index]),
        )
        heading = headings[index, :joints]
        return leave_plane(finger, chain[index, : joints + 1], heading, turned), heading

    @property
    def temperature_c(self) -> float:
        """Of the room, and so of the fingers [degC]."""
        return self._temperature_c

    @temperature_c.setter
    def temperature_c(self, temperature_c: float) -> None:
        with self.lock:
            self._temperature_c = temperature_c
            self.bank.warm(temperature_c)

    def wound_m(self) -> Array:
        """Cable each spool has wound since its finger was mounted [m]."""
        angles_rad = np.array([servo.shaft.angle_rad for servo in self.servos])
        return np.asarray(self._spool_radii_m * angles_rad - self._wound_zero)

    def taken_slack_m(self) -> Array:
        """Cable each spool winds before its tendon is taut on the straight finger [m]."""
        return self.bank.slack_m

    def _supply_v(self) -> float:
        drawn_a = sum(abs(servo.shaft.supply_current_a) for servo in self.servos)
        source_v = self.supply.voltage_v if self.disturbances.supply_v is None else self.disturbances.supply_v
        return max(0.0, source_v - self.supply.resistance_ohm * drawn_a)

    def _power(self, index: int, servo: PlantServo, supply_v: float) -> None:
        servo.shaft.supply_v = supply_v
        if self._powered[index] and not servo.powered:
            self._powered[index] = False
        elif not self._powered[index] and servo.powered:
            # The voltage is back: it boots, without an error bit, without its turns.
            self._powered[index] = True
            servo.lose_power(self.now_s)

    def _apply_disturbances(self) -> None:
        faults = self.disturbances
        before, self._disturbed = self._disturbed, faults.of_tendons
        if not (before or self._disturbed):
            return
        for index, slot in enumerate(self.slots):
            self.bank.broken[index] = slot in faults.broken_tendons
            self.bank.slack_m[index] = self._base_slack[index] + faults.extra_slack_m.get(slot, 0.0)
            self.motors[index].jammed = slot in faults.jammed
            self.motors[index].extra_heat_w = faults.extra_heat_w.get(slot, 0.0)
