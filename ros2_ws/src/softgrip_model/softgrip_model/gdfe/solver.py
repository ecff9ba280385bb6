# SPDX-License-Identifier: Apache-2.0
"""Equilibria of hexahedral meshes with a constant matrix: the compiled solver behind numpy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.gdfe import _core
from softgrip_model.gdfe.cable import CableDrive, RoutedCable, friction_numbers
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.materials import (
    TABLE_CELLS,
    TABLE_END,
    Ogden,
    SolidMaterial,
    VolumeShape,
    secant_table,
    shear_secant,
)
from softgrip_model.gdfe.mesh import Mesh
from softgrip_model.gdfe.surroundings import Acts, Contact, Surroundings, Vector, contacts_of

Array = NDArray[np.float64]
Index = NDArray[np.int32]


class ConstitutiveLaw(StrEnum):
    """Local laws."""

    CALIBRATED = "calibrated"
    THESIS = "thesis"
    RIGOROUS = "rigorous"


class Metric(StrEnum):
    """Stiffness of the elements' hourglass patterns: the FE Laplacian's, or that of the thesis' matrix N."""

    LAPLACIAN = "laplacian"
    CENTRING = "centring"


class Ordering(StrEnum):
    """Elimination order of the constant matrix."""

    AUTOMATIC = "automatic"
    AMD = "amd"
    METIS = "metis"


class Method(StrEnum):
    """Solver for the constant matrix: a direct factor, or multigrid, whose cost grows with the mesh and not faster."""

    AUTOMATIC = "automatic"
    DIRECT = "direct"
    MULTIGRID = "multigrid"


@dataclass(frozen=True, eq=False)
class Supports:
    """Which unknowns are not free.

    Attributes:
        prescribed: (n, 3) True where a displacement is prescribed.
        tied: (axis, nodes): these nodes share one displacement along an axis.
    """

    prescribed: NDArray[np.bool_]
    tied: tuple[tuple[int, Index], ...] = ()

    @classmethod
    def none(cls, nodes: int) -> Supports:
        """Return supports of a free mesh."""
        return cls(np.zeros((nodes, 3), dtype=bool))

    def with_prescribed(self, nodes: Index, axes: str = "xyz") -> Supports:
        """Return these supports and prescribed displacements of nodes along axes.

        Args:
            nodes: their numbers; `Mesh.nodes_where` finds them.
            axes: some of ``xyz``. How far they are led is said to `Solver.solve`; nothing said holds them.
        """
        prescribed = self.prescribed.copy()
        for axis in axes:
            prescribed[nodes, "xyz".index(axis)] = True
        return Supports(prescribed, self.tied)

    def with_tied(self, nodes: Index, axis: str) -> Supports:
        """Return these supports and nodes tied along an axis: they move by one displacement, which is unknown.

        Args:
            nodes: their numbers.
            axis: ``x``, ``y`` or ``z``.
        """
        return Supports(self.prescribed, (*self.tied, ("xyz".index(axis), nodes)))

    def maps(self) -> list[Index]:
        """Return, for each axis, the group of unknowns of every node, -1 where prescribed."""
        maps: list[Index] = []
        for axis in range(3):
            group = np.arange(len(self.prescribed))
            for tied_axis, nodes in self.tied:
                if tied_axis == axis:
                    group[nodes] = nodes.min()
            free = ~self.prescribed[:, axis]
            first = np.zeros(len(group), dtype=np.int32)
            first[group[free]] = 1
            numbers = np.cumsum(first, dtype=np.int32) - 1
            maps.append(np.where(free, numbers[group], -1).astype(np.int32))
        return maps


@dataclass(frozen=True)
class SolverSettings:
    """Numbers of the method.

    Attributes:
        law: local law.
        volume_shape: V^v.
        metric: of the hourglass patterns.
        single_precision_factor: keep the factor or multigrid levels in float; residuals are always computed in double.
        ordering: of the factor.
        method: a direct factor or multigrid; automatic = multigrid above 20,000 nodes.
        window: of the Anderson acceleration, 0 = plain iteration.
        threads: the bits of a result depend on their number, not on their timing.
        step_limit: largest motion of a node in one iteration; 0 = none.
        sections_after: iterations after which rigid cross-sections answer, too: for slender bodies that bend much, held
            at one end on all axes, without obstacles; negative = never.
        max_tangent_unknowns: up to so many unknowns (three a free node) the rigorous law's own tangent stands in for
            the constant matrix, where neither cables, pressures, followers nor obstacles act; 0 = never. Only with it
            is the stability of an equilibrium known.
    """

    law: ConstitutiveLaw = ConstitutiveLaw.CALIBRATED
    volume_shape: VolumeShape = VolumeShape.PROJ
    metric: Metric = Metric.LAPLACIAN
    single_precision_factor: bool = True
    ordering: Ordering = Ordering.AUTOMATIC
    method: Method = Method.AUTOMATIC
    window: int = 10
    threads: int = 1
    step_limit: float = 0.0
    sections_after: int = -1
    max_tangent_unknowns: int = 20_000

    def __post_init__(self) -> None:
        """Take names for what they name.

        Raises:
            ValueError: an unknown one.
        """
        for field_name, kind in (
            ("law", ConstitutiveLaw), ("volume_shape", VolumeShape), ("metric", Metric), ("ordering", Ordering),
            ("method", Method),
        ):  # fmt: skip
            object.__setattr__(self, field_name, kind(getattr(self, field_name)))

    def core(self) -> _core.Settings:
        """Return them as the core takes them."""
        return _core.Settings(
            law=_core.Law.__members__[self.law],
            shape=_core.VolumeShape.__members__[self.volume_shape],
            metric=_core.Metric.__members__[self.metric],
            single_precision_factor=self.single_precision_factor,
            ordering=_core.Ordering.__members__[self.ordering],
            method=_core.Method.__members__[self.method],
            window=self.window,
            threads=self.threads,
            step_limit=self.step_limit,
            sections_after=self.sections_after,
            max_tangent_unknowns=self.max_tangent_unknowns,
        )


@dataclass(frozen=True, eq=False)
class State:
    """Where a solve starts: displacements (n, 3) and each cable's tension at its anchor."""

    displacement: Array
    anchor_tension: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """What a solve gives.

    Attributes:
        converged: the residual fell below the tolerance.
        iterations: local and global steps.
        residual: out-of-balance force relative to reactions.
        displacement: (n, 3).
        reaction: (n, 3) force holding each prescribed unknown.
        strain: (m,) equivalent strain, nu = 0.5.
        tension: per cable, actuator to anchor [N].
        shortening: per cable.
        contacts: per obstacle.
        motions: of the obstacles, as asked for.
        unstable_modes: independent motions of the free unknowns that lower the energy: with any, a body leaves this
            equilibrium at a touch. None where it is not known (`SolverSettings.max_tangent_unknowns`).
        history: residual of every iteration.
    """

    converged: bool
    iterations: int
    residual: float
    length_error: float
    displacement: Array
    reaction: Array
    strain: Array
    anchor_tension: tuple[float, ...]
    tension: tuple[tuple[float, ...], ...]
    shortening: tuple[float, ...]
    contacts: tuple[Contact, ...]
    motions: tuple[Vector, ...]
    unstable_modes: int | None
    history: tuple[float, ...] = field(repr=False)

    @property
    def state(self) -> State:
        """Where another solve may start from."""
        return State(self.displacement, self.anchor_tension)


class Solver:
    """A mesh with its materials, supports and cables; the matrix is factored once, here."""

    def __init__(
        self,
        mesh: Mesh,
        materials: Sequence[SolidMaterial],
        supports: Supports,
        cables: Sequence[RoutedCable] = (),
        settings: SolverSettings | None = None,
        surroundings: Surroundings | None = None,
        sections: Index | None = None,
    ) -> None:
        """Prepare.

        Args:
            mesh: hexahedra.
            materials: that the mesh's elements name.
            supports: which unknowns are not free.
            cables: through the mesh.
            settings: numbers of the method.
            surroundings: what acts from outside.
            sections: (n,) of each node, from 0, where `sections_after` asks for them: only neighbours meet in an
                element. None = counted in elements from the support, for layers across the body.

        Raises:
            GdfeError: a mesh that names unknown materials or is not held.
        """
        self.mesh, self.supports, self.cables = mesh, supports, tuple(cables)
        self.settings = settings or SolverSettings()
        self.surroundings = surroundings or Surroundings()
        self._sections = np.zeros(0, dtype=np.int32) if sections is None else sections
        if mesh.materials.min() < 0 or mesh.materials.max() >= len(materials):
            element = int(np.argmax((mesh.materials < 0) | (mesh.materials >= len(materials))))
            raise GdfeError(
                f"element {element} has material {mesh.materials[element]}, known are 0 to {len(materials) - 1}: "
                f"{', '.join(material.name for material in materials)}"
            )
        self.materials = tuple(materials)
        try:
            self._core = _core.Solver(self.problem(), self.settings.core())
        except ValueError as error:
            raise GdfeError(str(error)) from error
        except RuntimeError as error:
            raise GdfeError(f"{error}; prescribe displacements so that no part can move freely") from error

    @cached_property
    def tables(self) -> _core.SecantTables:
        """mu(eps) of every material, as the core takes it."""
        return _core.SecantTables(self._secants, TABLE_CELLS, TABLE_END, self._lame_per_mu)

    @cached_property
    def _secants(self) -> Array:
        shape = self.settings.volume_shape
        return np.vstack([secant_table(partial(shear_secant, one, shape=shape)) for one in self.materials])

    @property
    def _lame_per_mu(self) -> list[float]:
        return [2.0 * one.poisson / (1.0 - 2.0 * one.poisson) for one in self.materials]

    def problem(self, rest: Array | None = None, *, is_disassembled: bool = False) -> _core.Problem:
        """Return what the core computes.

        Args:
            rest: (n, 3) the nodes at rest, where they are not this mesh's.
            is_disassembled: every element has eight nodes of its own, in the elements' order; supports, cables and
                surroundings are left out. For `_core.ElementForces`.
        """
        nodes = self.mesh.nodes if rest is None else rest
        weights = self._matrix_weights(self._secants, self._lame_per_mu)[self.mesh.materials]
        problem = partial(
            _core.Problem,
            materials=self.mesh.materials,
            tables=self.tables,
            matrix_weight=weights,
            ogden=self._ogden(),
        )
        if is_disassembled:
            hexes = np.arange(self.mesh.hexes.size, dtype=np.int32).reshape(-1, 8)
            maps = Supports.none(self.mesh.hexes.size).maps()
            return problem(rest=nodes[self.mesh.hexes].reshape(-1, 3), hexes=hexes, maps=maps)
        return problem(
            rest=nodes,
            hexes=self.mesh.hexes,
            maps=self.supports.maps(),
            cables=[cable.core() for cable in self.cables],
            surroundings=self.surroundings.core(),
            sections=self._sections,
        )

    def _matrix_weights(self, tables: Array, lame_per_mu: Sequence[float]) -> Array:
        """Return k of every material: 1 for the thesis law, else about the stiffest it answers with at rest."""
        if self.settings.law is ConstitutiveLaw.THESIS:
            return np.ones(len(self.materials))
        if self.settings.law is ConstitutiveLaw.RIGOROUS:
            return np.array([2.0 * (o.shear_modulus + o.bulk_modulus / 3.0) for o in self._ogden_materials()])
        return np.array([tables[4 * i, 0] * (2.0 + lame) for i, lame in enumerate(lame_per_mu)])

    def _ogden_materials(self) -> list[Ogden]:
        found = [material for material in self.materials if isinstance(material, Ogden)]
        if len(found) < len(self.materials):
            others = [material.name for material in self.materials if not isinstance(material, Ogden)]
            raise GdfeError(f"the rigorous law takes Ogden (or neo-Hookean) materials only, found {', '.join(others)}")
        return found

    def _ogden(self) -> list[_core.OgdenMaterial]:
        if self.settings.law is not ConstitutiveLaw.RIGOROUS:
            return []
        return [_core.OgdenMaterial(o.moduli, o.exponents, o.bulk_modulus) for o in self._ogden_materials()]

    def set_thesis_state(self, omega: Array, last_strain: Array) -> None:
        """Set the thesis law's shape factor and last converged strain of every element, both (m,)."""
        self._core.set_thesis_state(omega, last_strain)

    def set_friction(self, cable: int, friction: FrictionLaw) -> None:
        """Set the friction law of a cable; matrix and factor stay, as friction acts on forces only."""
        changed = replace(self.cables[cable], friction=friction)
        self.cables = (*self.cables[:cable], changed, *self.cables[cable + 1 :])
        self._core.set_friction(cable, *friction_numbers(friction))

    def internal_force(self, displacement: Array) -> Array:
        """Return the elements' forces on the nodes, (n, 3), at displacements (n, 3)."""
        return self._core.internal_force(displacement)

    def strain(self) -> Array:
        """Return the equivalent strain (nu = 0.5) of every element at the state last looked at, (m,)."""
        return np.array(self._core.strain())

    def energy(self, displacement: Array) -> float:
        """Return the strain energy at displacements (n, 3); the rigorous law only."""
        if self.settings.law is not ConstitutiveLaw.RIGOROUS:
            raise GdfeError(f"only the law 'rigorous' has an energy, this solver has {self.settings.law!r}")
        return self._core.energy(displacement)

    @property
    def matrix_entries(self) -> int:
        """Entries of the factor along x, or of the matrices of all multigrid levels."""
        return self._core.inverse_nonzeros(0)

    @property
    def bytes_per_iteration(self) -> int:
        """What one iteration must at least move.

        Factors twice, or multigrid levels as often as a cycle reads them, one for axes alike; constants of the elements
        once; the acceleration's history, in float, once; six vectors of unknowns (position, force, residual, step,
        last point, last residual) once.
        """
        maps = self.supports.maps()
        distinct = [axis for axis in range(3) if not any(np.array_equal(maps[axis], other) for other in maps[:axis])]
        inverse = sum(self._core.inverse_bytes(axis) for axis in distinct)
        unknown = 4 * 2 * self.settings.window + 8 * 6
        return inverse + self._core.element_bytes + unknown * self._core.unknowns

    def rest(self) -> State:
        """Return the undeformed state."""
        return State(np.zeros_like(self.mesh.nodes), (0.0,) * len(self.cables))

    def solve(
        self,
        prescribed: Array | None = None,
        *,
        start: State | None = None,
        load: Array | None = None,
        drives: Sequence[CableDrive] = (),
        acts: Acts | None = None,
        since: Equilibrium | None = None,
        tolerance: float = 1e-6,
        force_floor: float = 0.0,
        length_tolerance: float = 1e-6,
        max_iterations: int = 2000,
    ) -> Equilibrium:
        """Find the equilibrium.

        Args:
            prescribed: (n, 3) displacements where they are prescribed; None = zero.
            start: where to start; None = at rest.
            load: (n, 3) dead forces.
            drives: one per cable.
            acts: of the surroundings; None = no pressure, no force, obstacles where they were at rest.
            since: equilibrium that sliding against obstacles counts from; None = rest.
            tolerance: out-of-balance force relative to the reactions.
            force_floor: reactions and loads below this count as this.
            length_tolerance: of driven cable lengths, and of contact gaps.
            max_iterations: then it is given back as not converged.

        Raises:
            GdfeError: drives or a start that are not those of this mesh and its cables.
        """
        if len(drives) != len(self.cables):
            raise GdfeError(f"expected {len(self.cables)} cable drives, found {len(drives)}")
        zero = np.zeros_like(self.mesh.nodes)
        start = start or self.rest()
        if len(start.anchor_tension) != len(self.cables) or start.displacement.shape != zero.shape:
            raise GdfeError(
                f"start: expected displacements {zero.shape} and {len(self.cables)} anchor tensions, found "
                f"{start.displacement.shape} and {len(start.anchor_tension)}"
            )
        acts = acts or Acts.nothing(self.surroundings)
        acts.check(self.surroundings)
        task = _core.Task(
            prescribed=zero if prescribed is None else prescribed,
            load=zero if load is None else load,
            drives=[drive.core() for drive in drives],
            pressures=acts.pressures,
            follower_forces=acts.follower_forces,
            motions=acts.motions,
            motions_before=since.motions if since else Acts.nothing(self.surroundings).motions,
            before=since.displacement if since else zero,
            tolerance=tolerance,
            force_floor=force_floor,
            length_tolerance=length_tolerance,
            max_iterations=max_iterations,
        )
        out = self._core.solve(task, start.displacement, start.anchor_tension)
        return Equilibrium(
            converged=out.converged,
            iterations=out.iterations,
            residual=out.residual,
            length_error=out.length_error,
            displacement=out.displacement,
            reaction=out.reaction,
            strain=np.array(out.strain),
            anchor_tension=tuple(out.anchor_tension),
            tension=tuple(tuple(t) for t in out.tension),
            shortening=tuple(out.shortening),
            contacts=contacts_of(out.touches, len(self.surroundings.obstacles)),
            motions=acts.motions,
            unstable_modes=None if out.unstable_modes < 0 else out.unstable_modes,
            history=tuple(out.history),
        )
