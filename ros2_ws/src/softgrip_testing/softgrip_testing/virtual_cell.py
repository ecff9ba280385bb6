# SPDX-License-Identifier: Apache-2.0
"""The emulated cell in virtual time: the emulator's plant and servos under the driver's own backend and controller.

Nothing is left out but the serial port and the middleware: the driver's code reads registers and writes goals as it
does on a bus, and what comes out is what tendon/state, tendon/status and finger/predicted would carry.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from random import Random
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_cell.grasp.commands import Close, Command, Open, Press
from softgrip_cell.grasp.sequence import GraspSequence, GraspStep
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspTask
from softgrip_cell.observation import FreeMotion, ObservedPair, SeenTip, TendonFault, TendonSample
from softgrip_cell.products import Product
from softgrip_cell.swap.check import CheckSettings, EmptyClosing, FingerCheck
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Policies, Ticket
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.trajectory import TendonTrajectory
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.plant.cell import CellPlant, default_chain
from softgrip_emulator.rig.truth import FrictionTruth
from softgrip_model.finger.matching import TendonInput as ModelSample
from softgrip_model.finger.predictor import ActiveFriction, Validity
from softgrip_model.finger.session import Session
from softgrip_model.finger.wear import WearSettings
from softgrip_model.friction.fit import fit
from softgrip_model.friction.measurements import Measurements
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.virtual_bus import VirtualBus
from softgrip_time.units import to_ns

Array = NDArray[np.float64]

SLOTS = ("index", "middle", "thumb")

CHECK = CheckSettings()
#: As the manager opens fingers, and the largest tension that it asks for.
OPEN_M_PER_S, LIMIT_N = 0.05, GraspSettings().tension_limit_n

#: A product that hangs from the fingers for so long is held (thesis 4.3.3) [s], still for the last part of it [s], [m].
HANGS_S = 5.0
STILL_S = 0.5
STILL_M = 0.001

#: What the marker tracker makes of the index finger's tip: noise [m], driver periods per frame, exposure to result [s].
TIP_NOISE_M = 0.0005
SEEN_EVERY = 3
SEEN_AFTER_S = 0.05


@dataclass(frozen=True)
class Lateness:
    """A computer with other things to do, as the driver's loop feels it.

    Some periods begin late, and the next ones are on time again, as far as time is left; some goals are written late
    after the reading that they follow from. A servo under proportional control falls back meanwhile and catches up
    with a current that passes for tension, all servos of the bus at once.

    Attributes:
        share: of the periods that begin late, and as much of the goals that are written late.
        mean_s: how late these are, exponentially distributed [s].
        writes_after_s: from a reading to its goal on a computer that has nothing else to do [s].
    """

    share: float = 0.0
    mean_s: float = 0.004
    writes_after_s: float = 0.0

    def late_s(self, rng: Random) -> float:
        """How late something is this time [s]."""
        return rng.expovariate(1.0 / self.mean_s) if rng.random() < self.share else 0.0


#: Every period and every goal to the microsecond.
PUNCTUAL = Lateness()

#: Periods and tensions that scatter as in a shift on two slow processors: 2 % of the samples of free motion are 0.35 N
#: or more above their neighbours, 0.7 % are 0.5 N above.
LOADED = Lateness(share=0.07, writes_after_s=0.002)

#: Twice as often late as that, and half as long again: more than a shift was seen to bear.
OVERLOADED = Lateness(share=0.14, mean_s=0.006, writes_after_s=0.002)


class VirtualCell:
    """Plant, servos, driver and predictor on one virtual clock.

    Args:
        seed: of the emulated cell.
        finger_set: profile mounted in every slot.
        rate: of the driver's loop [Hz].
        copy: number of the mounted fingers among those of their set.
        lateness: of the driver's loop.
        limits: which current the servos limit, and the driver knows that they do.
        believed: what the driver takes the current that they report, and the one that they limit, for; None: what they
            are.
    """

    def __init__(
        self,
        seed: int,
        finger_set: str,
        rate: float = 100.0,
        copy: int = 1,
        lateness: Lateness = PUNCTUAL,
        limits: CurrentSensing = CurrentSensing.SUPPLY,
        believed: CurrentSensing | None = None,
        trips_early: bool = False,
    ) -> None:
        self.profiles: Mapping[str, Profile] = load_directory(shipped_directory())
        limits_winding = limits is CurrentSensing.WINDING
        chain = [replace(place, limits_winding=limits_winding, trips_early=trips_early) for place in default_chain()]
        self.plant = CellPlant(self.profiles, seed=seed, chain=chain)
        self._friction = calibrated(seed)
        self.period_s = 1.0 / rate
        self._lateness = lateness
        self._delays = Random(seed)
        self._behind_s = 0.0
        self._read_s = self.plant.now_s
        tendon_limits = TendonLimits(break_confirm=0.25)
        model = MODELS["XL330-M288"]
        model = replace(model, senses=believed or model.senses)
        torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
        servos = [
            ServoConfiguration(s, i, model, Spool(0.010, 1), torque, limits=believed or limits)
            for i, s in enumerate(SLOTS, start=1)
        ]
        # The servos' watchdog looks at the wall's clock on the driver's side: no business of virtual time.
        emulated = [servo for servo in self.plant.servos if isinstance(servo, EmulatedServo)]
        self._backend = DynamixelBackend(VirtualBus(emulated, lambda: self.plant.now_s), servos, watchdog=0.0)
        self.controller = GripperController(dict.fromkeys(SLOTS, tendon_limits), Policies())
        self._frames: deque[SeenTip] = deque()
        self._periods = 0
        self._closing: Ticket | None = None
        self._camera_noise = Random(seed)
        self._backend.connect()
        self.mount(finger_set, copy)
        self.cycle()
        self.switch_on()

    def switch_on(self) -> None:
        """Take hold with every drive that has no power."""
        for drive in self.controller.drives.values():
            if not drive.powered:
                self._act({drive.tendon: drive.switch_on()})

    def set_true_zeros(self) -> None:
        """Give the driver the true zeros, as after a homing without error."""
        taut_m = self.plant.wound_m() - self.plant.bank.slack_m
        for drive, length_m in zip(self.controller.drives.values(), taut_m.tolist(), strict=True):
            self._backend.mark_session(drive.tendon, 1)
            drive.set_zero(drive.position - length_m, 1)

    def mount(self, finger_set: str, copy: int = 1, said: str | None = None) -> None:
        """Put a set into the slots; the predictor is told ``said`` (the same set when None)."""
        serials = [f"{finger_set}-{slot}-{copy}" for slot in SLOTS]
        self.plant.mount(list(SLOTS), serials, [finger_set] * 3)
        self.session = Session(self.profiles, dict.fromkeys(SLOTS, said or finger_set), WearSettings())
        self.session.set_friction(self._friction)

    @property
    def now_ns(self) -> int:
        """Virtual time of the last reading [ns]."""
        return to_ns(self._read_s)

    def home(self) -> None:
        """Home all tendons."""
        ticket = self.controller.home(self.plant.now_s)
        outcome = self.finish(ticket, 40.0)
        if outcome is not MoveOutcome.REACHED:
            raise RuntimeError(f"homing: {self.controller.result(ticket)}")

    def move(self, target_m: float, speed: float, limit_n: float = LIMIT_N, slots: Sequence[str] = SLOTS) -> Ticket:
        """Start a move."""
        request = MoveRequest(slots, MoveMode.LENGTH, [target_m] * len(slots), speed, limit_n)
        ticket = self.controller.move(request, self.plant.now_s)
        if ticket.refusal:
            raise RuntimeError(ticket.refusal)
        return ticket

    def finish(self, ticket: Ticket, limit_s: float) -> MoveOutcome | None:
        """Live until a ticket is done."""
        for _ in range(round(limit_s / self.period_s)):
            self.cycle()
            outcome, _ = self.controller.result(ticket)
            if outcome is not None:
                return outcome
        return None

    def cycles(self) -> Iterator[tuple[ModelSample, ...]]:
        """Live one driver period after the other; yields the three tendons' samples."""
        while True:
            self.cycle()
            yield self.samples()

    def live(self) -> tuple[ModelSample, ...]:
        """Live one driver period; return what tendon/state would carry then."""
        self.cycle()
        return self.samples()

    def follow(self, lengths_m: Sequence[float], within_s: float, slots: Sequence[str] = SLOTS) -> None:
        """Stream targets as tendon/trajectory does.

        Args:
            lengths_m: pulled length of each slot's tendon [m].
            within_s: when they are to be reached from now [s].
            slots: of the tendons.

        Raises:
            RuntimeError: the driver refuses, for instance after a fault.
        """
        limits = {slot: self.controller.drives[slot].limits for slot in slots}
        trajectories = {
            slot: TendonTrajectory.checked((within_s,), (length_m,), (), limits[slot].travel, limits[slot].speed)
            for slot, length_m in zip(slots, lengths_m, strict=True)
        }
        ticket = self.controller.follow(trajectories, self.plant.now_s)
        if ticket.refusal:
            raise RuntimeError(ticket.refusal)

    def samples(self) -> tuple[ModelSample, ...]:
        """What tendon/state would carry now."""
        return tuple(
            ModelSample(self.now_ns, s.pulled_length_m, s.speed, s.tension) for s in self.controller.snapshots()
        )

    def pulled_length_m(self) -> Mapping[str, float]:
        """How far each tendon is pulled now [m], as a movement's result says it."""
        return {drive.tendon: drive.pulled_length_m for drive in self.controller.snapshots()}

    def cycle(self) -> None:
        """Live one driver period."""
        self.plant.advance_to(self._begin_s())
        self._read_s = self.plant.now_s
        readings = {name: replace(r, time=self._read_s) for name, r in self._backend.read().items()}
        actions = self.controller.step(self._read_s, readings)
        writes_after_s = self._lateness.writes_after_s + self._lateness.late_s(self._delays)
        if writes_after_s:
            self.plant.advance_to(self._read_s + writes_after_s)
        self._act(actions)

    def _begin_s(self) -> float:
        """When the next period begins [s]: a delay is made up for, but for whole periods, which are left out."""
        due_s = self._read_s + self.period_s - self._behind_s % self.period_s
        begin_s = max(due_s + self._lateness.late_s(self._delays), self.plant.now_s)
        self._behind_s = begin_s - due_s
        return begin_s

    def _act(self, actions: Mapping[str, Any]) -> None:
        setpoints = {}
        for tendon, action in actions.items():
            if action.power is not None:
                self._backend.power(tendon, action.power)
            if action.setpoint is not None:
                setpoints[tendon] = action.setpoint
        if setpoints:
            self._backend.write(setpoints)

    # --- what grasp_mix_manager does with it --------------------------------------------------------------------------

    def observe(self) -> ObservedPair:
        """Live one driver period and return what the manager would see of it."""
        self.cycle()
        samples = self.samples()
        predictions = self.session.predict(samples, SLOTS)
        pulled = tuple(sample.pulled_length_m for sample in samples)
        free = FreeMotion(
            stamp_ns=self.now_ns,
            pulled_length_m=pulled,
            tension_n=tuple(prediction.tension for prediction in predictions),
            tip_m=tuple(prediction.tip for prediction in predictions),
            friction_model=self.session.configuration.friction_id,
            objections=tuple(p.reason if p.validity == Validity.FAILED else "" for p in predictions),
        )
        return ObservedPair(TendonSample(self.now_ns, pulled, tuple(sample.tension for sample in samples)), free)

    def open(self) -> None:
        """Open the fingers."""
        self.finish(self.move(0.0, 0.05), 5.0)

    def check(self, settings: CheckSettings = CHECK) -> Mapping[str, FingerCheck]:
        """Close on nothing and judge, as a swap does."""
        self.open()
        closing = EmptyClosing(SLOTS, settings)
        ticket = self.move(settings.length_m, settings.speed_m_per_s, settings.tension_limit_n)
        while self.controller.result(ticket)[0] is None:
            closing.observe(self.observe())
        closing.end(self.pulled_length_m())
        self.open()
        return closing.judge()

    def fault(self) -> TendonFault | None:
        """What tendon/status would say."""
        for drive in self.controller.snapshots():
            if drive.fault:
                return TendonFault(drive.tendon, drive.fault, drive.fault_reason)
        return None

    def grasp(self, task: GraspTask, settings: GraspSettings) -> Iterator[tuple[GraspStep, GraspSequence]]:
        """Grasp; yields every step, the last one with a verdict."""
        sequence = GraspSequence(task, settings)
        step = sequence.start()
        self._closing = None
        self._obey(step.commands)
        yield step, sequence
        while step.verdict is None:
            pair = self.observe()
            for tip in self._seen():
                sequence.observe_tip(tip)
            fault = self.fault()
            step = sequence.fault(fault, self.now_ns) if fault is not None else sequence.observe(pair)
            self._obey(step.commands)
            if self._has_closed():
                sequence.closing_ended()
            yield step, sequence

    def _has_closed(self) -> bool:
        """Whether the closing that the sequence asked for has come to its end."""
        if self._closing is None:
            return False
        return self.controller.result(self._closing)[0] in (MoveOutcome.REACHED, MoveOutcome.TENSION_LIMIT)

    def tip_m(self) -> Array:
        """Where the index finger's tip is, (2,) [m] in the finger's base frame."""
        assert self.plant.bank.fingers[0] is not None, "the index slot is empty"
        return np.array(self.plant.points_m(0)[0][-1][:2])

    def tip_heading_rad(self) -> float:
        """Direction of the index finger's last link, from the base's towards the closing side [rad]."""
        return float(self.plant.points_m(0)[1][-1])

    def see_tip(self, rng: Random) -> SeenTip:
        """The index finger's tip as the camera sees it now; the tracker follows this finger only."""
        x, y = self.tip_m().tolist()
        tip_m = (x + rng.gauss(0.0, TIP_NOISE_M), y + rng.gauss(0.0, TIP_NOISE_M))
        return SeenTip(self.now_ns, SLOTS[0], tip_m, TIP_NOISE_M)

    def _seen(self) -> Iterator[SeenTip]:
        """Frames that have gone through camera and tracker by now."""
        self._periods += 1
        if self._periods % SEEN_EVERY == 0:
            self._frames.append(self.see_tip(self._camera_noise))
        while self._frames and self.now_ns - self._frames[0].stamp_ns >= to_ns(SEEN_AFTER_S):
            yield self._frames.popleft()

    def hangs(self, for_s: float) -> bool:
        """Keep the arm up, let the plant go on, and say whether the product still hangs then and hung still at last.

        By where the product is, not by how hard it is pressed: a grape that lies in a closed fist weighs 0.05 N.
        """
        end_s = self.plant.now_s + max(for_s, STILL_S)
        places_m: list[tuple[float, float]] = []
        for _ in self.cycles():
            self.plant.lift()
            state = self.plant.grasp.state()
            if state.slipped or not state.product:
                return False
            if self.plant.now_s > end_s - STILL_S:
                places_m.append(self.plant.grasp.centre_m)
            if self.plant.now_s >= end_s:
                break
        return all(math.dist(place_m, places_m[-1]) < STILL_M for place_m in places_m)

    def recover(self) -> None:
        """What a person does after a fault: reset, home, open."""
        self.controller.reset()
        self.switch_on()
        if not all(drive.homed for drive in self.controller.drives.values()):
            self.home()

    def _obey(self, commands: Sequence[Command]) -> None:
        now_s = self.plant.now_s
        for command in commands:
            if isinstance(command, Open):
                self.move(0.0, OPEN_M_PER_S)
            elif isinstance(command, Close):
                names = [SLOTS[slot] for slot in command.slots]
                request = MoveRequest(
                    names, MoveMode.LENGTH, command.targets_m, command.speed_m_per_s, command.tension_limit_n
                )
                self._closing = self.controller.move(request, now_s)
            elif isinstance(command, Press):
                names = [SLOTS[slot] for slot in command.slots]
                request = MoveRequest(names, MoveMode.TENSION, command.tensions_n, command.speed_m_per_s)
                self.controller.move(request, now_s)
            else:
                ticket = self.controller.move(
                    MoveRequest(
                        SLOTS,
                        MoveMode.LENGTH,
                        [max(0.0, s.pulled_length_m) for s in self.controller.snapshots()],
                        OPEN_M_PER_S,
                        LIMIT_N,
                    ),
                    now_s,
                )
                self.controller.cancel(ticket, now_s)


def calibrated(seed: int) -> ActiveFriction:
    """A friction model as the rig's nine points give it: 200, 600, 1000 g at 10, 50, 90 degrees, 1 % scatter."""
    truth, rng = FrictionTruth.from_seed(seed), np.random.default_rng(seed)
    angle, low_n = (g.ravel() for g in np.meshgrid(np.radians([10.0, 50.0, 90.0]), 9.81 * np.array([0.2, 0.6, 1.0])))
    high_n = truth.ratio(angle, low_n) * low_n * rng.normal(1.0, 0.01, angle.size)
    found = fit(Measurements(angle, low_n, high_n), radius_mm=3.125)
    return ActiveFriction(f"nine points, seed {seed}", found.law, found.covariance)


def task(
    product: Product, finger_set: str, checks: Mapping[str, FingerCheck], *, confirm_lift: bool = True
) -> GraspTask:
    """The task that the manager would begin; every finger has to have passed its check."""
    references = []
    for slot in SLOTS:
        reference = checks[slot].reference
        assert reference is not None, checks[slot]
        references.append(reference)
    return GraspTask(
        product,
        product.recipe_for(finger_set),
        SLOTS,
        tuple(references),
        SLOTS.index("thumb"),
        confirm_lift,
        finger_set != "hook",
    )
