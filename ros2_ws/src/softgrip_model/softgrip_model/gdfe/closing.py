# SPDX-License-Identifier: Apache-2.0
"""The shape of a finger at any pulled length, solved in the mesh: cable, friction and material together.

The cable runs through the mesh's routing points with the calibrated friction law, or that of the profile as long as
there is none; its pulled length is prescribed, the tension follows. Every shape starts from the keyframes next to its
own length, which are computed when a shape first needs them. So a shape depends on its pulled length alone, not on what
was before. Mesh and factored matrix know nothing of friction: closings of one finger share them (`Body`).
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from softgrip_model.digest import text_digest
from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import ActiveFriction, assumed_friction
from softgrip_model.gdfe.cable import CableDrive, RoutedCable
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, Resolution, mesh_finger
from softgrip_model.gdfe.materials import SolidMaterial, StressPolynomial
from softgrip_model.gdfe.solver import ConstitutiveLaw, Equilibrium, Method, Solver, SolverSettings, State, Supports
from softgrip_model.gdfe.validity import warnings_of
from softgrip_model.profile import Material as ProfileMaterial
from softgrip_model.profile import Profile, digest

Array = NDArray[np.float64]
Index = NDArray[np.uint32]

#: Volume term of the interactive fingers: nearer to 0.5 costs many more iterations, as a Laplacian conditions it badly.
POISSON = 0.3
#: Why a finger that nobody pulls is shown undeformed: nothing is wrong with it.
AT_REST = "cable slack: shown at rest"
#: [mm] of cable length, everywhere in this module.
LENGTH_TOLERANCE_MM = 1e-3
#: Of the acceleration, and the iterations after which the cross-sections answer, too: a shape that starts near another
#: converges sooner, by cheaper iterations; what starts far from one has lost its short waves by then.
WINDOW, SECTIONS_AFTER = 20, 6
#: Share of a material's strain range that the equivalent strain (above half of any principal one) must reach before
#: principal stretches are worked out.
NEAR_RANGE = 0.5
#: [N] Below it the convergence of a hardly pulled finger is measured against this force.
FORCE_FLOOR_N = 0.5
#: Shares of the keyframes' distance between rest and the first of them: from slack to taut a shape changes fastest.
FIRST_STEPS = (0.05, 0.2, 0.5)
#: Keyframes that the next one is extrapolated from, and that the one halfway is interpolated from.
EXTRAPOLATED_FROM, INTERPOLATED_FROM = 3, 4

#: How an equilibrium is found: pulled length [mm], state to start from.
Solve = Callable[[float, State], Equilibrium]


@dataclass(frozen=True)
class ClosingSettings:
    """How closings are computed.

    Attributes:
        resolution: elements along the finger's parts.
        travel_mm: longest pulled length.
        keyframe_mm: distance of the keyframes that shapes are started from.
        tolerance: out-of-balance force relative to reactions.
        max_iterations: of one shape; a keyframe may take half of them.
    """

    resolution: Resolution = RESOLUTIONS["fine"]
    travel_mm: float = 22.0
    keyframe_mm: float = 1.0
    tolerance: float = 1e-4
    max_iterations: int = 300


@dataclass(frozen=True, eq=False)
class ClosingShape:
    """One shape of one finger; lengths in m.

    Attributes:
        pulled_length_m: [m] that was asked for.
        vertices: (n, 3) [m] in the finger's base frame.
        strain: (m,) equivalent strain of each hexahedron.
        tension: [N] from the actuator to the anchor.
        tip: [m] end of the last link on the line of the apexes.
        converged: False: vertices are those of the last keyframe that converged.
        residual: out-of-balance force relative to reactions.
        iterations: of this solve.
        solve_time: [s]
        reason: why not converged, or what to know.
    """

    pulled_length_m: float
    vertices: Array
    strain: Array
    tension: tuple[float, ...]
    tip: Array
    converged: bool
    residual: float
    iterations: int
    solve_time: float
    reason: str


def profile_material(material: ProfileMaterial, poisson: float = POISSON) -> StressPolynomial:
    """Return the stress curve [MPa] whose slope is the profile's tangent modulus a e^2 + b e + c."""
    a, b, c = (
        1e-6 * m for m in (material.modulus_quadratic_pa, material.modulus_linear_pa, material.modulus_constant_pa)
    )
    limit = material.max_strain
    return StressPolynomial(material.name, (c, b / 2.0, a / 3.0), poisson, (-limit, limit))


class Body:
    """What a finger's closings have in common, whatever the cable's friction: mesh, material, factored matrix.

    It is made on any thread; its `solver` is one thread's.
    """

    def __init__(
        self,
        profile: Profile,
        slot: str,
        resolution: Resolution,
        *,
        material: SolidMaterial | None = None,
        law: ConstitutiveLaw = ConstitutiveLaw.CALIBRATED,
        finger_mesh: FingerMesh | None = None,
    ) -> None:
        """Mesh the finger; its matrix is factored with the first shape.

        Args:
            profile: of the finger.
            slot: it sits in.
            resolution: elements along the finger's parts.
            material: instead of the profile's.
            law: of the elements.
            finger_mesh: of this finger, instead of one at the resolution.

        Raises:
            ProfileError: no such finger.
            GdfeError: a finger that cannot be meshed.
            FingerError: impossible design, or unknown friction.
        """
        self.profile, self.slot, self.resolution = profile, slot, resolution
        finger = Finger.from_profile(profile, slot)
        body_height_mm = 1e3 * profile.finger(slot).body_height_m
        self.finger_mesh: FingerMesh = finger_mesh or mesh_finger(finger, resolution, body_height_mm)
        mesh = self.finger_mesh.mesh
        self.material = material or profile_material(profile.material)
        supports = Supports.none(len(mesh.nodes)).with_prescribed(self.finger_mesh.clamped)
        cable = RoutedCable(self.finger_mesh.routing, assumed_friction(profile).law)
        # a node that jumps further than half the thinnest strip in one iteration turns elements over
        limit = 0.5 * min(finger.thickness_mm)
        # a direct factor, however fine the mesh: what multigrid leaves hides what the cross-sections answer
        method = SolverSettings(
            law=law, method=Method.DIRECT, step_limit=limit, window=WINDOW, sections_after=SECTIONS_AFTER
        )
        sections = self.finger_mesh.sections
        self._make_solver = partial(Solver, mesh, [self.material], supports, [cable], method, sections=sections)
        self.faces: Index = mesh.surface().astype(np.uint32)
        self.changes = "" if material is None and law is ConstitutiveLaw.CALIBRATED else f":{material}:{law}"

    @cached_property
    def solver(self) -> Solver:
        """That of the thread that shows shapes; made with the first of them."""
        return self.new_solver()

    def new_solver(self) -> Solver:
        """Return a solver of this body for another thread."""
        return self._make_solver()


def solve_closing(
    settings: ClosingSettings,
    friction: ActiveFriction,
    solver: Solver,
    pulled_mm: float,
    start: State,
    *,
    is_keyframe: bool = False,
) -> Equilibrium:
    """Find the equilibrium at a pulled length.

    Args:
        settings: how closings are computed.
        friction: the cable's.
        solver: of the body; closings with other friction use it as well.
        pulled_mm: pulled length.
        start: where to start.
        is_keyframe: take half the iterations at most, and keep what other solves start from only.
    """
    solver.set_friction(0, friction.law)
    return solve_mesh(settings, solver, pulled_mm, start, is_keyframe=is_keyframe)


def solve_mesh(
    settings: ClosingSettings, solver: Solver, pulled_mm: float, start: State, *, is_keyframe: bool = False
) -> Equilibrium:
    """Find the equilibrium at a pulled length with the solver's own friction; arguments as in `solve_closing`."""
    found = solver.solve(
        start=start,
        drives=[CableDrive(pulled_mm)],
        tolerance=settings.tolerance,
        force_floor=FORCE_FLOOR_N,
        length_tolerance=LENGTH_TOLERANCE_MM,
        max_iterations=settings.max_iterations // 2 if is_keyframe else settings.max_iterations,
    )
    if not is_keyframe:
        return found
    # a copy, as the core's own array keeps all that it found: reactions, which nobody looks at, are half of that
    return replace(found, displacement=found.displacement.copy(), reaction=np.zeros((0, 3)))


class Keyframes:
    """Equilibria along a closing that shapes are started from, each computed when a shape first needs it or before.

    Keyframes of the chain are extrapolated from those before and lie far apart; halfway between two of them another one
    is interpolated where a shape falls in between. All follow from the chain, not from the order of requests. One
    thread requests them; one more may `prefetch`: what it has computed is there at once when it is requested, and
    leaves no other trace.

    Args:
        spacing_mm: pulled length between them.
        travel_mm: longest pulled length.
        tolerance_mm: of a pulled length.
        solve: finds an equilibrium.
        rest: the undeformed state.
    """

    def __init__(
        self,
        spacing_mm: float,
        travel_mm: float,
        tolerance_mm: float,
        solve: Solve,
        rest: State,
    ) -> None:
        count = round(travel_mm / spacing_mm)
        self._lengths = [0.0, *(spacing_mm * share for share in FIRST_STEPS), *(spacing_mm * np.arange(1, count + 1))]
        self._tolerance, self._solve, self._rest = tolerance_mm, solve, rest
        self._known: list[Equilibrium] = []
        self._halfway: dict[int, Equilibrium] = {}
        self._requested = 0
        self._end: int | None = None  # how many there are, once that is known
        self._condition = threading.Condition()
        self._busy = False

    @property
    def reach_mm(self) -> float:
        """Longest pulled length that a requested keyframe is known at."""
        return float(self._lengths[max(0, self._usable - 1)])

    @property
    def last(self) -> Equilibrium:
        """The one at the reach."""
        return self._known[self._usable - 1]

    @property
    def requested(self) -> int:
        """How many were requested, whoever computed them."""
        return self._requested

    @property
    def complete(self) -> bool:
        """Whether all that there are have been computed."""
        return self._end is not None

    def missing(self, pulled_mm: float) -> int:
        """Return how many are left to request for a shape at a length."""
        return 0 if self._ended else max(0, self._above(pulled_mm) + 1 - self._requested)

    def covers(self, pulled_mm: float) -> bool:
        """Return whether nothing is left to request for a shape at a length."""
        return self.missing(pulled_mm) == 0

    def advance(self) -> None:
        """Request one more; none beyond the travel or beyond one that does not converge."""
        if self._ended:
            return
        self._requested += 1
        while not self._tried(self._requested):
            self._compute_once(lambda: self._tried(self._requested), lambda: self._compute(self._solve))

    def prefetch(self, solve: Solve) -> bool:
        """Compute one that nobody has requested yet, and the one halfway to it; False where none is left.

        Args:
            solve: must give the same bits as the one that these keyframes were made with; it is called on this thread.
        """
        if self._end is not None:
            return False
        count = len(self._known)
        self._compute_once(lambda: self._tried(count + 1), lambda: self._compute(solve))
        if self._end is None and count > 0:
            self._halve(count, solve)
        return True

    def cover(self, pulled_mm: float) -> None:
        """Compute what a shape at a length needs."""
        while not self.covers(pulled_mm):
            self.advance()

    def within_reach(self, pulled_mm: float) -> bool:
        """Return whether a length lies within the reach; `cover` it first."""
        return pulled_mm <= self.reach_mm + self._tolerance

    def start(self, pulled_mm: float) -> State:
        """Return the interpolated state at a length that is covered."""
        above = min(self._above(pulled_mm), self._usable - 1)
        if self._lengths[above] == pulled_mm:  # the interpolation would say the same, after one more solve
            return _interpolate([self._at(above)], pulled_mm)
        near = []
        for k in range(max(0, above - 2), above + 1):
            if k > max(0, above - 2):
                near += self._between(k)
            near.append(self._at(k))
        return _interpolate(near, pulled_mm)

    def nearest(self, pulled_mm: float) -> Equilibrium:
        """Return the known one nearest to a length."""
        lengths = np.asarray(self._lengths[: self._usable])
        return self._known[int(np.argmin(np.abs(lengths - pulled_mm)))]

    def _above(self, pulled_mm: float) -> int:
        """Return the number of the first at or beyond a length."""
        return bisect_left(self._lengths, pulled_mm - self._tolerance)

    def _at(self, number: int) -> tuple[float, Equilibrium]:
        return float(self._lengths[number]), self._known[number]

    def _between(self, number: int) -> list[tuple[float, Equilibrium]]:
        """Return the one halfway to the keyframe before; none where that does not converge."""
        self._halve(number, self._solve)
        found = self._halfway[number]
        return [(self._middle(number), found)] if found.converged else []

    def _middle(self, number: int) -> float:
        return 0.5 * float(self._lengths[number - 1] + self._lengths[number])

    def _halve(self, number: int, solve: Solve) -> None:
        def compute() -> None:
            length = self._middle(number)
            near = [self._at(k) for k in range(max(0, number + 1 - INTERPOLATED_FROM), number + 1)]
            self._halfway[number] = solve(length, _interpolate(near, length))

        while number not in self._halfway:
            self._compute_once(lambda: number in self._halfway, compute)

    @property
    def _ended(self) -> bool:
        return self._end is not None and self._requested > self._end

    @property
    def _usable(self) -> int:
        """How many of those requested there are."""
        return self._requested if self._end is None else min(self._requested, self._end)

    def _tried(self, count: int) -> bool:
        return self._end is not None or len(self._known) >= count

    def _compute(self, solve: Solve) -> None:
        """Compute the next of the chain, or find that there is none."""
        count = len(self._known)
        if count == len(self._lengths):
            self._end = count
            return
        length = float(self._lengths[count])
        before = range(max(0, count - EXTRAPOLATED_FROM), count)
        found = solve(length, _interpolate([self._at(k) for k in before], length) if count > 1 else self._rest)
        if found.converged or not self._known:
            self._known.append(found)
        else:
            self._end = count

    def _compute_once(self, done: Callable[[], bool], compute: Callable[[], None]) -> None:
        """Compute when the other thread does not, unless it has done it by then."""
        with self._condition:
            self._condition.wait_for(lambda: done() or not self._busy)
            if done():
                return
            self._busy = True
        try:
            compute()
        finally:
            with self._condition:
                self._busy = False
                self._condition.notify_all()


def _interpolate(near: Sequence[tuple[float, Equilibrium]], pulled_mm: float) -> State:
    """Return Lagrange's polynomial through equilibria at lengths, at another length [mm]."""
    at = [length for length, _ in near]
    weights = [np.prod([(pulled_mm - other) / (own - other) for other in at if other != own]) for own in at]
    known = [equilibrium for _, equilibrium in near]
    displacement = sum(w * one.displacement for w, one in zip(weights, known, strict=True))
    tension = sum(w * one.anchor_tension[0] for w, one in zip(weights, known, strict=True))
    return State(np.asarray(displacement), (max(0.0, float(tension)),))


def _solve_keyframe(solve: Callable[..., Equilibrium], body: Body, pulled_mm: float, start: State) -> Equilibrium:
    """Solve on the thread that shows shapes: the body makes its solver with the first of them."""
    return solve(body.solver, pulled_mm, start, is_keyframe=True)


class ClosingPath:
    """One finger of one profile with one friction law, at any pulled length."""

    def __init__(
        self,
        profile: Profile,
        slot: str,
        settings: ClosingSettings | None = None,
        *,
        friction: ActiveFriction | None = None,
        material: SolidMaterial | None = None,
        law: ConstitutiveLaw = ConstitutiveLaw.CALIBRATED,
        body: Body | None = None,
    ) -> None:
        """Mesh the finger, unless its body is there already; nothing is factored or solved yet.

        Args:
            profile: of the finger.
            slot: it sits in.
            settings: how closings are computed.
            friction: calibrated model; None = the one that the profile names.
            material: instead of the profile's.
            law: of the elements.
            body: of this finger at this resolution, shared with other closings; the four above it then say nothing new.

        Raises:
            ProfileError: no such finger.
            GdfeError: a finger that cannot be meshed.
            FingerError: impossible design, or unknown friction.
        """
        self.settings = settings or ClosingSettings()
        self.body = body or Body(profile, slot, self.settings.resolution, material=material, law=law)
        self.finger_mesh, self.material = self.body.finger_mesh, self.body.material
        self.friction = friction or assumed_friction(profile)
        self.faces = self.body.faces
        self.hexahedra = len(self.finger_mesh.mesh.hexes)
        text = f"{digest(profile)}:{slot}:{self.settings}:{POISSON}"
        if friction is not None:
            text += f":{friction.id}:{friction.digest}:{friction.law}"
        text += self.body.changes
        self.digest = text_digest(self.finger_mesh.mesh.digest + text)
        # nothing that keyframes hold leads back to this closing: they are large, and go with it
        self._solve = partial(solve_closing, self.settings, self.friction)
        self.keyframes = Keyframes(
            self.settings.keyframe_mm,
            self.settings.travel_mm,
            LENGTH_TOLERANCE_MM,
            partial(_solve_keyframe, self._solve, self.body),
            State(np.zeros_like(self.finger_mesh.mesh.nodes), (0.0,)),
        )
        self._last: tuple[float, Equilibrium] | None = None

    def shape(self, pulled_length_m: float) -> ClosingShape:
        """Return the shape at a pulled length [m]."""
        started = time.perf_counter()
        pulled_mm = 1e3 * pulled_length_m
        reason = ""
        if not pulled_mm > 0.0:
            pulled_mm, reason = 0.0, AT_REST
        known = self.keyframes
        known.cover(pulled_mm)
        if not known.within_reach(pulled_mm):
            reason = f"pulled {pulled_mm:.2f} mm; the last shape that converged is at {known.reach_mm:.2f} mm"
            return self._shape(pulled_length_m, known.last, started, reason, converged=False)
        found = self._found(pulled_mm)
        if not found.converged:
            nearest = known.nearest(pulled_mm)
            reason = f"residual {found.residual:.1e} after {found.iterations} iterations; shown: nearest keyframe"
            return self._shape(pulled_length_m, nearest, started, reason, converged=False)
        return self._shape(pulled_length_m, found, started, reason, converged=True)

    def state(self, pulled_mm: float) -> State:
        """Return a state near the shape at a pulled length [mm]: where a solve of the mesh without cables may start."""
        self.keyframes.cover(pulled_mm)
        return State(self.keyframes.start(pulled_mm).displacement)

    def prefetch(self, solver: Solver) -> bool:
        """Compute a keyframe that no shape has requested, by this thread's own solver; False where none is left."""
        return self.keyframes.prefetch(partial(self._solve, solver, is_keyframe=True))

    def _found(self, pulled_mm: float) -> Equilibrium:
        """Return the equilibrium at a length that is covered; at once where the tendon stands still."""
        if self._last is None or self._last[0] != pulled_mm:
            start = self.keyframes.start(pulled_mm)
            self._last = pulled_mm, self._solve(self.body.solver, pulled_mm, start)
        return self._last[1]

    def _shape(
        self, pulled_length_m: float, found: Equilibrium, started: float, reason: str, *, converged: bool
    ) -> ClosingShape:
        if converged:
            reason = "; ".join(filter(None, (reason, *self._out_of_range(found))))
        vertices = self.finger_mesh.mesh.nodes + found.displacement
        tip = self.finger_mesh.tip
        return ClosingShape(
            pulled_length_m=pulled_length_m,
            vertices=1e-3 * vertices,
            strain=found.strain,
            tension=found.tension[0],
            tip=1e-3 * (tip.weights @ vertices[tip.nodes]),
            converged=converged,
            residual=found.residual,
            iterations=found.iterations,
            solve_time=time.perf_counter() - started,
            reason=reason,
        )

    def _out_of_range(self, found: Equilibrium) -> list[str]:
        """Return where the material leaves what it is known for; looked at closely only when a strain is near it."""
        known = min(-self.material.strain_range[0], self.material.strain_range[1])
        if float(found.strain.max()) < NEAR_RANGE * known:
            return []
        return warnings_of(self.finger_mesh.mesh, [self.material], found.displacement)
