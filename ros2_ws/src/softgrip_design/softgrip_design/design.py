# SPDX-License-Identifier: Apache-2.0
"""A demonstration turned into fingers: which are optimised, which take another's design, and what came out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softgrip_design import hand
from softgrip_design.errors import DesignError
from softgrip_design.mesh_objective import SETTINGS, FollowOnMesh
from softgrip_design.objective import CloseUniformly, FollowTrajectory, Weights
from softgrip_design.optimiser import OptimiserSettings, Optimum, optimise, optimise_all
from softgrip_design.target import MIN_DEFLECTION_RAD, STEPS, DesignTarget, deflection_rad, target
from softgrip_design.trajectory import FingerTrajectory
from softgrip_model.finger import Finger, JointModel, MomentLaw, Solution
from softgrip_model.finger.published import CHAPTER_4_MM, OPTIMISED_ROUTING_MM, chapter_3_finger
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import Resolution

Array = NDArray[np.float64]

#: The finger whose design the others take when they hardly move, as section 4.3.1 generalises it.
LEADING_FINGER = "index"
#: [mm] bounds of section 3.4, its pulled length, and n of Eq 3.10 (0.1 mm a step).
UNIFORM_BOUNDS_MM, UNIFORM_PULL_MM, UNIFORM_STEPS = (4.0, 12.0), 20.0, 200


@dataclass(frozen=True)
class Task:
    """What to design.

    Attributes:
        law: friction of cable on finger.
        weights: of Eq 4.5.
        thickness_mm: bounds of h.
        routing_mm: bounds of r.
        moment_law: of the strips.
        joint_model: mode F or mode P.
        steps: n of Eq 4.4.
        search: how to search.
    """

    law: FrictionLaw
    weights: Weights = field(default_factory=Weights)
    thickness_mm: tuple[float, float] = hand.THICKNESS_BOUNDS_MM
    routing_mm: tuple[float, float] = hand.ROUTING_BOUNDS_MM
    moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT
    joint_model: JointModel = JointModel.FLEXURE
    steps: int = STEPS
    search: OptimiserSettings = field(default_factory=OptimiserSettings)

    def objective(self, trajectory: FingerTrajectory, name: str) -> FollowTrajectory:
        """Return Eq 4.5 for a finger of the hand.

        Raises:
            DesignError: the finger is unknown, hardly moves, or moves further than the grooves let it.
        """
        return FollowTrajectory(
            hand.blank(name, self.moment_law, self.joint_model),
            self.law,
            target(trajectory, name, self.steps),
            self.weights,
            self.thickness_mm,
            self.routing_mm,
        )


@dataclass(frozen=True, eq=False)
class Followed:
    """A finger optimised for a trajectory.

    Attributes:
        name: finger of the hand.
        finger: the design.
        target: what it should do.
        closing: what it does, (1, steps).
        error_deg: E_T, Eq 4.4.
        error_per_joint_deg: root mean square of each joint.
        force_n: E_F.
        optimum: how it was found.
        mesh_error_deg: E_T in the mesh, of the kernel's design and of this one; None: not closed there.
    """

    name: str
    finger: Finger
    target: DesignTarget
    closing: Solution
    error_deg: float
    error_per_joint_deg: tuple[float, ...]
    force_n: float
    optimum: Optimum
    mesh_error_deg: tuple[float, float] | None = None


@dataclass(frozen=True)
class Shared:
    """A finger that hardly moves in the demonstration and takes thickness and routing of another one."""

    name: str
    finger: Finger
    taken_from: str
    why: str


@dataclass(frozen=True, eq=False)
class HandDesign:
    """All fingers of a set.

    Attributes:
        followed: optimised fingers, in the order of the hand.
        shared: the others.
        seconds: the optimisation took.
    """

    followed: tuple[Followed, ...]
    shared: tuple[Shared, ...]
    seconds: float

    @property
    def fingers(self) -> dict[str, Finger]:
        """Every finger's design in the order of the hand."""
        designs = {one.name: one.finger for one in self.followed} | {one.name: one.finger for one in self.shared}
        return {name: designs[name] for name in hand.FINGERS if name in designs}


def design_hand(
    trajectory: FingerTrajectory, names: Sequence[str], task: Task, advance: Callable[[str], None] = lambda _: None
) -> HandDesign:
    """Design fingers in parallel.

    Args:
        trajectory: the demonstration.
        names: of the fingers; one alone has to move.
        task: what to design.
        advance: called with a finger's name for each of its starts.

    Raises:
        DesignError: an unknown finger, or none that moves enough.
    """
    moved = {name: deflection_rad(trajectory, name) for name in names}
    moving = [name for name in names if moved[name] >= MIN_DEFLECTION_RAD or len(names) == 1]
    if not moving:
        raise DesignError("expected a motion in which a finger closes, found none that moves; choose another motion")
    objectives = {name: task.objective(trajectory, name) for name in moving}
    began = time.perf_counter()
    optima = optimise_all(objectives, task.search, advance)
    seconds = time.perf_counter() - began
    followed = {name: evaluate(name, objectives[name], optimum) for name, optimum in optima.items()}
    return HandDesign(
        tuple(followed[name] for name in moving),
        tuple(
            _share(name, np.degrees(moved[name]), followed[_leader(moving)], task)
            for name in names
            if name not in moving
        ),
        seconds,
    )


def evaluate(name: str, objective: FollowTrajectory, optimum: Optimum) -> Followed:
    """Return what an optimum does, joint by joint."""
    closing = objective.solve(optimum.x)
    deviation = np.degrees(closing.angle_rad[0] - objective.target.angle_rad)
    return Followed(
        name=name,
        finger=objective.finger(optimum.x),
        target=objective.target,
        closing=closing,
        error_deg=float(np.sqrt(np.mean(deviation**2))),
        error_per_joint_deg=tuple(np.sqrt(np.mean(deviation**2, axis=0)).tolist()),
        force_n=float(closing.tension_n[0, -1, 0]),
        optimum=optimum,
    )


def improve_on_mesh(followed: Followed, objective: FollowTrajectory, task: Task, resolution: Resolution) -> Followed:
    """Return a finger that follows its target in the mesh, near the kernel's design (`mesh_objective`).

    Raises:
        DesignError: the kernel's design does not close so far in the mesh.
    """
    on_mesh = FollowOnMesh(
        followed.finger,
        task.law,
        objective.target,
        task.weights,
        objective.lower,
        objective.upper,
        replace(SETTINGS, resolution=resolution),
    )
    x = followed.optimum.x
    try:
        before = on_mesh.error_deg(x)
        improved = on_mesh.improve(x)
        after = on_mesh.error_deg(improved)
    except GdfeError as error:
        raise DesignError(f"{followed.name} in the mesh: {error}; cut the motion shorter") from error
    found = evaluate(followed.name, objective, replace(followed.optimum, x=improved))
    return replace(found, mesh_error_deg=(before, after))


def published_on(objective: FollowTrajectory) -> dict[str, tuple[float, float]]:
    """Return error [deg] and force [N] of the designs of Fig 4.4 on a target for three joints; NaN where they fail."""
    vectors = {grasp: np.array([*thickness, *routing]) for grasp, (thickness, routing) in CHAPTER_4_MM.items()}
    return {grasp: (objective.error_deg(x), objective.force_n(x)) for grasp, x in vectors.items()}


@dataclass(frozen=True, eq=False)
class Uniform:
    """The finger of section 3.4.

    Attributes:
        finger: the design.
        closing: what it does, (1, steps).
        pulls_mm: (steps,).
        spread_deg: Eq 3.10 with squares.
        published_spread_deg: of the routing that the thesis prints.
        optimum: how it was found.
        seconds: the optimisation took.
    """

    finger: Finger
    closing: Solution
    pulls_mm: Array
    spread_deg: float
    published_spread_deg: float
    optimum: Optimum
    seconds: float


def design_uniform(law: FrictionLaw, search: OptimiserSettings) -> Uniform:
    """Design the routing of the chapter 3 finger so that its joints close alike.

    Raises:
        DesignError: no start found a finger that closes.
    """
    objective = CloseUniformly(
        chapter_3_finger(OPTIMISED_ROUTING_MM), law, UNIFORM_BOUNDS_MM, UNIFORM_PULL_MM, UNIFORM_STEPS
    )
    began = time.perf_counter()
    optimum = optimise(objective, search)
    return Uniform(
        finger=objective.finger(optimum.x),
        closing=objective.solve(optimum.x),
        pulls_mm=objective.pulls_mm,
        spread_deg=optimum.value,
        published_spread_deg=objective.value(np.array(OPTIMISED_ROUTING_MM)),
        optimum=optimum,
        seconds=time.perf_counter() - began,
    )


def _leader(moving: Sequence[str]) -> str:
    others = [name for name in moving if name != "thumb"]
    return LEADING_FINGER if LEADING_FINGER in moving else (others or list(moving))[0]


def _share(name: str, moved_deg: float, leader: Followed, task: Task) -> Shared:
    own = hand.blank(name, task.moment_law, task.joint_model)
    if own.joints > leader.finger.joints:
        raise DesignError(f"{name}: hardly moves, and {leader.name} has too few joints to lend it a design")
    return Shared(
        name=name,
        finger=own.with_design(leader.finger.thickness_mm[: own.joints], leader.finger.routing_mm[: 2 * own.joints]),
        taken_from=leader.name,
        why=f"deflects {moved_deg:.0f} deg in all",
    )
