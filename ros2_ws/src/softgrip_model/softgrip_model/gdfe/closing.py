# SPDX-License-Identifier: Apache-2.0
"""The shape of a finger at any pulled length, solved in the mesh: cable, friction and material together.

The cable runs through the mesh's routing points with the calibrated friction law, or that of the profile as long as
there is none; its pulled length is prescribed, the tension follows. Every shape starts from the keyframes next to its
own length, which are computed when a shape first needs them. So a shape depends on its pulled length alone, not on what
was before. Mesh and factored matrix know nothing of friction: closings of one finger share them (`Body`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from softgrip_model.digest import text_digest
from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import ActiveFriction, assumed_friction
from softgrip_model.gdfe.cable import CableDrive, RoutedCable
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, Resolution, mesh_finger
from softgrip_model.gdfe.keyframes import Keyframes
from softgrip_model.gdfe.materials import SolidMaterial, StressPolynomial
from softgrip_model.gdfe.solver import ConstitutiveLaw, Equilibrium, Solver, SolverSettings, State, Supports
from softgrip_model.gdfe.validity import warnings_of
from softgrip_model.profile import Material as ProfileMaterial
from softgrip_model.profile import Profile, digest

Array = NDArray[np.float64]
Index = NDArray[np.uint32]

#: Volume term of the interactive fingers: nearer to 0.5 costs many more iterations, as a Laplacian conditions it badly.
POISSON = 0.3
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
        pulled_length: [m] that was asked for.
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

    pulled_length: float
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
    ) -> None:
        """Mesh the finger; its matrix is factored with the first shape.

        Args:
            profile: of the finger.
            slot: it sits in.
            resolution: elements along the finger's parts.
            material: instead of the profile's.
            law: of the elements.

        Raises:
            ProfileError: no such finger.
            GdfeError: a finger that cannot be meshed.
            FingerError: impossible design, or unknown friction.
        """
        self.profile, self.slot, self.resolution = profile, slot, resolution
        finger = Finger.from_profile(profile, slot)
        self.finger_mesh: FingerMesh = mesh_finger(finger, resolution, 1e3 * profile.finger(slot).body_height_m)
        mesh = self.finger_mesh.mesh
        self.material = material or profile_material(profile.material)
        supports = Supports.none(len(mesh.nodes)).with_prescribed(self.finger_mesh.clamped)
        cable = RoutedCable(self.finger_mesh.routing, assumed_friction(profile).law)
        # a node that jumps further than half the thinnest strip in one iteration turns elements over
        limit = 0.5 * min(finger.thickness_mm)
        method = SolverSettings(law=law, step_limit=limit, window=WINDOW, sections_after=SECTIONS_AFTER)
        self._make_solver = partial(Solver, mesh, [self.material], supports, [cable], method)
        self.faces: Index = mesh.surface().astype(np.uint32)
        self.changes = "" if material is None and law is ConstitutiveLaw.CALIBRATED else f":{material}:{law}"

    @cached_property
    def solver(self) -> Solver:
        """That of the thread that shows shapes; made with the first of them."""
        return self.new_solver()

    def new_solver(self) -> Solver:
        """Return a solver of this body for another thread."""
        return self._make_solver()


@dataclass(frozen=True)
class _Equations:
    """What is solved, with a solver of the body."""

    settings: ClosingSettings
    friction: ActiveFriction

    def shape(self, solver: Solver, pulled_mm: float, start: State) -> Equilibrium:
        return self.solve(solver, self.settings.max_iterations, pulled_mm, start)

    def keyframe(self, solver: Solver, pulled_mm: float, start: State) -> Equilibrium:
        found = self.solve(solver, self.settings.max_iterations // 2, pulled_mm, start)
        # a copy, as the core's own array keeps all that it found: reactions, which nobody looks at, are half of that
        return replace(found, displacement=found.displacement.copy(), reaction=np.zeros((0, 3)))

    def solve(self, solver: Solver, max_iterations: int, pulled_mm: float, start: State) -> Equilibrium:
        solver.set_friction(0, self.friction.law)  # another closing may have used it in between
        return solver.solve(
            start=start,
            drives=[CableDrive(pulled_mm)],
            tolerance=self.settings.tolerance,
            force_floor=FORCE_FLOOR_N,
            length_tolerance=LENGTH_TOLERANCE_MM,
            max_iterations=max_iterations,
        )


def _own_keyframe(equations: _Equations, body: Body, pulled_mm: float, start: State) -> Equilibrium:
    return equations.keyframe(body.solver, pulled_mm, start)


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
        self._equations = _Equations(self.settings, self.friction)
        self.keyframes = Keyframes(
            self.settings.keyframe_mm,
            self.settings.travel_mm,
            LENGTH_TOLERANCE_MM,
            partial(_own_keyframe, self._equations, self.body),
            State(np.zeros_like(self.finger_mesh.mesh.nodes), (0.0,)),
        )
        self._last: tuple[float, Equilibrium] | None = None

    def shape(self, pulled_length: float) -> ClosingShape:
        """Return the shape at a pulled length [m]."""
        started = time.perf_counter()
        pulled_mm = 1e3 * pulled_length
        reason = ""
        if not pulled_mm > 0.0:
            pulled_mm, reason = 0.0, "cable slack: shown at rest"
        known = self.keyframes
        known.cover(pulled_mm)
        if not known.within_reach(pulled_mm):
            reason = f"pulled {pulled_mm:.2f} mm; the last shape that converged is at {known.reach_mm:.2f} mm"
            return self._shape(pulled_length, known.last, started, reason, converged=False)
        found = self._found(pulled_mm)
        if not found.converged:
            nearest = known.nearest(pulled_mm)
            reason = f"residual {found.residual:.1e} after {found.iterations} iterations; shown: nearest keyframe"
            return self._shape(pulled_length, nearest, started, reason, converged=False)
        return self._shape(pulled_length, found, started, reason, converged=True)

    def state(self, pulled_mm: float) -> State:
        """Return a state near the shape at a pulled length [mm], to start another solve of the same mesh from."""
        self.keyframes.cover(pulled_mm)
        return State(self.keyframes.start(pulled_mm).displacement)

    def work_ahead(self, solver: Solver) -> bool:
        """Compute a keyframe that no shape asked for, by a solver of this thread's own; False where none is left."""
        return self.keyframes.ahead(partial(self._equations.keyframe, solver))

    def _found(self, pulled_mm: float) -> Equilibrium:
        """Return the equilibrium at a length that is covered; at once where the tendon stands still."""
        if self._last is None or self._last[0] != pulled_mm:
            start = self.keyframes.start(pulled_mm)
            self._last = pulled_mm, self._equations.shape(self.body.solver, pulled_mm, start)
        return self._last[1]

    def _shape(
        self, pulled_length: float, found: Equilibrium, started: float, reason: str, *, converged: bool
    ) -> ClosingShape:
        if converged:
            reason = "; ".join(filter(None, (reason, *self._out_of_range(found))))
        vertices = self.finger_mesh.mesh.nodes + found.displacement
        tip = self.finger_mesh.tip
        return ClosingShape(
            pulled_length=pulled_length,
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
