# SPDX-License-Identifier: Apache-2.0
"""The shape of a finger at any pulled length, solved in the mesh: cable, friction and material together.

The cable runs through the mesh's routing points with the calibrated friction law, or that of the profile as long as
there is none; its pulled length is prescribed, the tension follows. A closing is computed once from rest in equal
steps (its keyframes); every later shape starts from the keyframes next to its own length. So a shape depends on its
pulled length alone, not on what was before.
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import ActiveFriction, assumed_friction
from softgrip_model.gdfe.cable import Cable, Drive
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, Resolution, mesh_finger
from softgrip_model.gdfe.materials import Material, StressPolynomial
from softgrip_model.gdfe.solver import Equilibrium, Law, Settings, Solver, State, Supports
from softgrip_model.gdfe.validity import warnings_of
from softgrip_model.profile import Material as ProfileMaterial
from softgrip_model.profile import Profile, digest

Array = NDArray[np.float64]
Index = NDArray[np.uint32]

#: Volume term of the interactive fingers: nearer to 0.5 costs many more iterations, as a Laplacian conditions it badly.
POISSON = 0.3
#: [mm] of cable length, everywhere in this module.
LENGTH_TOLERANCE_MM = 1e-3
#: Of the acceleration: slender hinges pulled by a force are badly conditioned, and a long memory pays.
WINDOW = 30
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
        keyframe_mm: distance of the keyframes.
        tolerance: out-of-balance force relative to reactions.
        max_iterations: of one shape.
    """

    resolution: Resolution = RESOLUTIONS["fine"]
    travel_mm: float = 22.0
    keyframe_mm: float = 1.0
    tolerance: float = 1e-4
    max_iterations: int = 1000


@dataclass(frozen=True, eq=False)
class Shape:
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


class Closing:
    """One finger of one profile, ready to be shown at any pulled length."""

    def __init__(
        self,
        profile: Profile,
        slot: str,
        settings: ClosingSettings | None = None,
        *,
        friction: ActiveFriction | None = None,
        material: Material | None = None,
        law: Law = Law.CALIBRATED,
    ) -> None:
        """Mesh the finger and compute its keyframes.

        Args:
            profile: of the finger.
            slot: it sits in.
            settings: how closings are computed.
            friction: calibrated model; None = the one that the profile names.
            material: instead of the profile's.
            law: of the elements.

        Raises:
            ProfileError: no such finger.
            GdfeError: a finger that cannot be meshed.
            FingerError: impossible design, or unknown friction.
        """
        self.settings = settings or ClosingSettings()
        finger = Finger.from_profile(profile, slot)
        self.finger_mesh: FingerMesh = mesh_finger(
            finger, self.settings.resolution, 1e3 * profile.finger(slot).body_height_m
        )
        mesh = self.finger_mesh.mesh
        self.material = material or profile_material(profile.material)
        self.friction = friction or assumed_friction(profile)
        supports = Supports.none(len(mesh.nodes)).with_prescribed(self.finger_mesh.clamped)
        cable = Cable(self.finger_mesh.routing, self.friction.law)
        # a node that jumps further than half the thinnest strip in one iteration turns elements over
        limit = 0.5 * min(finger.thickness_mm)
        method = Settings(law=law, step_limit=limit, window=WINDOW)
        self._solver = Solver(mesh, [self.material], supports, [cable], method)
        self.faces: Index = mesh.surface().astype(np.uint32)
        self.hexahedra = len(mesh.hexes)
        text = f"{digest(profile)}:{slot}:{self.settings}:{POISSON}"
        if friction is not None:
            text += f":{friction.id}:{friction.law}"
        if material is not None or law is not Law.CALIBRATED:
            text += f":{material}:{law}"
        self.digest = hashlib.sha256((mesh.digest + text).encode()).hexdigest()[:16]
        self._keyframes: list[Equilibrium] = []
        self.reach_mm = 0.0
        self._compute_keyframes()

    def shape(self, pulled_length: float) -> Shape:
        """Return the shape at a pulled length [m]."""
        started = time.perf_counter()
        pulled_mm = 1e3 * pulled_length
        reason = ""
        if not pulled_mm > 0.0:
            pulled_mm, reason = 0.0, "cable slack: shown at rest"
        if pulled_mm > self.reach_mm + LENGTH_TOLERANCE_MM:
            last = self._keyframes[-1]
            reason = f"pulled {pulled_mm:.2f} mm; the last shape that converged is at {self.reach_mm:.2f} mm"
            return self._shape(pulled_length, last, started, reason, converged=False)
        found = self._solve(pulled_mm, self._start(pulled_mm))
        if not found.converged:
            nearest = self._keyframes[round(pulled_mm / self.settings.keyframe_mm)]
            reason = f"residual {found.residual:.1e} after {found.iterations} iterations; shown: nearest keyframe"
            return self._shape(pulled_length, nearest, started, reason, converged=False)
        return self._shape(pulled_length, found, started, reason, converged=True)

    def state(self, pulled_mm: float) -> State:
        """Return a state near the shape at a pulled length [mm], to start another solve of the same mesh from."""
        return State(self._start(pulled_mm).displacement)

    def _compute_keyframes(self) -> None:
        step, count = self.settings.keyframe_mm, round(self.settings.travel_mm / self.settings.keyframe_mm)
        self._keyframes.append(self._solve(0.0, self._solver.rest()))
        for k in range(1, count + 1):
            found = self._solve(k * step, self._start(k * step))
            if not found.converged:
                break
            self._keyframes.append(found)
            self.reach_mm = k * step

    def _solve(self, pulled_mm: float, start: State) -> Equilibrium:
        return self._solver.solve(
            start=start,
            drives=[Drive(pulled_mm)],
            tolerance=self.settings.tolerance,
            force_floor=FORCE_FLOOR_N,
            length_tolerance=LENGTH_TOLERANCE_MM,
            max_iterations=self.settings.max_iterations,
        )

    def _start(self, pulled_mm: float) -> State:
        """Lagrange's parabola through the three keyframes nearest to a length; fewer where there are fewer."""
        at = pulled_mm / self.settings.keyframe_mm
        count = min(3, len(self._keyframes))
        first = min(max(round(at) - 1, 0), len(self._keyframes) - count)
        chosen = range(first, first + count)
        weights = [np.prod([(at - other) / (own - other) for other in chosen if other != own]) for own in chosen]
        displacement = sum(w * self._keyframes[k].displacement for w, k in zip(weights, chosen, strict=True))
        tension = sum(w * self._keyframes[k].anchor_tension[0] for w, k in zip(weights, chosen, strict=True))
        return State(np.asarray(displacement), (max(0.0, float(tension)),))

    def _shape(
        self, pulled_length: float, found: Equilibrium, started: float, reason: str, *, converged: bool
    ) -> Shape:
        if converged:
            reason = "; ".join(filter(None, (reason, *self._out_of_range(found))))
        vertices = self.finger_mesh.mesh.nodes + found.displacement
        tip = self.finger_mesh.tip
        return Shape(
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
