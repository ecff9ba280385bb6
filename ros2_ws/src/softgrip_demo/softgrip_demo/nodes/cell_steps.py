# SPDX-License-Identifier: Apache-2.0
"""Steps on the running cell: homing, friction, checks of the mounted fingers, and the first grasp."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from std_srvs.srv import Trigger

from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES
from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.cube import TEST_CUBE
from softgrip_demo.first_run.figures import Figure, at_least, at_most, equal_to
from softgrip_demo.nodes import convert
from softgrip_demo.nodes.bench_hands import BenchHands
from softgrip_demo.nodes.cell_session import CellSession
from softgrip_demo.nodes.link import calibrate
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import MountedFinger

#: [s] for homing, for a plan of nine points with a person, for a grasp
HOMING_TIMEOUT_S, FRICTION_TIMEOUT_S, GRASP_TIMEOUT_S = 60.0, 3600.0, 90.0
FRICTION_POINTS = 9
#: average and largest error of a usable model, relative (average_error_limit, maximum_error_limit of the rig)
MAX_AVERAGE_ERROR, MAX_ERROR = 0.05, 0.15
#: share of the wanted rate that the control loop must keep
MIN_RATE_SHARE = 0.95


@dataclass(frozen=True)
class HomeStep:
    """The cell starts, homes, and its loop keeps its rate."""

    session: CellSession
    rate_hz: float
    key = "home"
    title = "Cell: start and homing"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield what each tendon's status says after homing."""
        link = self.session.link
        link.call(Trigger, "tendon/home", Trigger.Request(), timeout=HOMING_TIMEOUT_S)
        link.until(self._is_homed, 10.0, "homed tendons in tendon/status")
        for row in self.session.status.tendons:
            yield equal_to(f"{row.tendon}: homed", "yes" if row.homed else "no", "yes", "docs/bench.md, section 3")
            yield equal_to(f"{row.tendon}: fault", row.fault or "none", "none", row.reason or "see tendon/status")
        remedy = "close other programs; allow real-time priority (docs/build/computer.md)"
        rate, bound = self.session.status.loop_rate, MIN_RATE_SHARE * self.rate_hz
        yield at_least("control loop", rate, bound, "Hz", remedy)

    def _is_homed(self) -> bool:
        return all(row.homed for row in self.session.status.tendons)


@dataclass(frozen=True)
class FrictionStep:
    """Nine points on the rig give a usable friction model."""

    session: CellSession
    hands: BenchHands
    cable_radius_m: float = 0.000125
    surface_radius_m: float = 0.003
    key = "friction"
    title = "Rig: friction of nine points"
    needs = ("servos", "rig")

    def measure(self) -> Iterator[Figure]:
        """Yield the points, and what the fit leaves over."""
        friction = convert.friction_result(self._calibrated())
        remedy = "look at the cable and the surface, then measure again (docs/friction.md)"
        yield equal_to("points accepted", len(friction.points), FRICTION_POINTS, remedy)
        yield at_most("average error of the fit", friction.average_error, MAX_AVERAGE_ERROR, "", remedy)
        yield at_most("largest error of the fit", friction.maximum_error, MAX_ERROR, "", remedy)
        yield equal_to("verdict", friction.verdict, "usable", remedy)

    def _calibrated(self) -> CalibrateFriction.Result:
        def set_up(feedback: CalibrateFriction.Feedback) -> None:
            self.hands.set_rig(feedback.angle, feedback.load, feedback.instruction)

        goal = CalibrateFriction.Goal(
            plan=str(FRICTION_POINTS), law="matte", cable="first run", surface="first run",
            cable_radius=self.cable_radius_m, surface_radius=self.surface_radius_m, activate=True,
        )  # fmt: skip
        return calibrate(self.session.link, goal, set_up, FRICTION_TIMEOUT_S)


@dataclass(frozen=True)
class ChecksStep:
    """A finger set is mounted, and the empty closing of each finger lies where it is predicted."""

    session: CellSession
    hands: BenchHands
    finger_set: str
    slots: Sequence[str]
    key = "checks"
    title = "Fingers: three checks"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield the state of each finger after the swap."""
        result = self.session.controller.swap(self.finger_set, self.hands.seat)
        if result.outcome != result.SUCCEEDED:
            raise FirstRunError(f"swap to {self.finger_set}: {result.reason}")
        states = {one.finger: one.state == MountedFinger.VERIFIED for one in result.mounted}
        for slot in self.slots:
            remedy = "seat the finger again; docs/cell.md says what the check compares"
            yield equal_to(f"{slot}: check", "good" if states.get(slot) else "not verified", "good", remedy)


@dataclass(frozen=True)
class GraspCubeStep:
    """The test cube is gripped and held."""

    session: CellSession
    hands: BenchHands
    max_tension_n: float
    key = "grasp"
    title = "First grasp: the test cube"
    needs = ("servos",)

    def measure(self) -> Iterator[Figure]:
        """Yield the outcome of the grasp and the largest tension."""
        controller = self.session.controller
        self.hands.place(TEST_CUBE.id)
        result = controller.grasp(TEST_CUBE.id, trial=True, timeout_s=GRASP_TIMEOUT_S)
        outcome = GRASP_OUTCOMES.get(result.outcome, "UNSET")
        yield equal_to("outcome", outcome, "GRIPPED", result.reason)
        yield at_most("largest tension", max(result.tensions, default=0.0), self.max_tension_n, "N", "lower the recipe")
        controller.release()
        self.hands.place("")
