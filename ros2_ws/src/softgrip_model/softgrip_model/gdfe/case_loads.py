# SPDX-License-Identifier: Apache-2.0
"""Loads, obstacles and cables of a case file: what they are, and how strong at a share of the full load."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import FRICTIONLESS
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.laws import FrictionLaw, KReading
from softgrip_model.friction.laws import Law as FrictionName
from softgrip_model.gdfe import case_values as values
from softgrip_model.gdfe.cable import CableDrive, RoutedCable, attach, guide
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.march import Loading
from softgrip_model.gdfe.mesh import Mesh
from softgrip_model.gdfe.surroundings import (
    Acts,
    FollowerPatch,
    Obstacle,
    ObstacleShape,
    Surroundings,
    face_shares,
    gravity,
)

Array = NDArray[np.float64]
Index = NDArray[np.int32]
Vector = tuple[float, float, float]

#: Faces of a mesh by the axis and end of its bounding box.
FACES = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1), "back": (2, 0), "front": (2, 1)}
#: Instead of a face: all outer nodes.
SURFACE = "surface"


def face_nodes(mesh: Mesh, name: object, where: str = "face") -> Index:
    """Return the nodes of a face of the mesh's bounding box.

    Raises:
        GdfeError: no such face.
    """
    axis, end = values.one_of(where, name, FACES)
    at = mesh.nodes[:, axis]
    edge = at.max() if end else at.min()
    return mesh.nodes_where(np.abs(at - edge) < 1e-6 * np.ptp(at))


def face_quads(mesh: Mesh, name: object, where: str = "face") -> Index:
    """Return the outer faces (f, 4) whose corners all lie on a face of the mesh's bounding box."""
    chosen = np.zeros(len(mesh.nodes), dtype=bool)
    chosen[face_nodes(mesh, name, where)] = True
    quads = mesh.surface()
    found = quads[chosen[quads].all(axis=1)]
    if not len(found):
        raise GdfeError(f"{where}: the {name} side of the mesh has no whole face to load")
    return found


@dataclass(frozen=True, eq=False)
class CaseLoads:
    """Everything that acts beside prescribed displacements, at full load; force in the case's unit.

    Attributes:
        dead: (n, 3) forces that keep their direction, or None.
        around: pressed surfaces, follower patches, obstacles.
        acts: of these.
        cables: as the solver takes them.
        drives: of these.
    """

    dead: Array | None = None
    around: Surroundings = field(default_factory=Surroundings)
    acts: Acts = field(default_factory=Acts)
    cables: tuple[RoutedCable, ...] = ()
    drives: tuple[CableDrive, ...] = ()

    def loading(self, prescribe: Callable[[float], Array]) -> Callable[[float], Loading]:
        """Return what acts at a share of the load, with the displacements that a function prescribes."""

        def at(share: float) -> Loading:
            acts = Acts(
                tuple(share * p for p in self.acts.pressures),
                tuple(_scaled(share, force) for force in self.acts.follower_forces),
                tuple(_scaled(share, motion) for motion in self.acts.motions),
            )
            drives = tuple(CableDrive(share * drive.target, drive.by_length) for drive in self.drives)
            return Loading(prescribe(share), None if self.dead is None else share * self.dead, drives, acts)

        return at

    @property
    def follow_the_body(self) -> bool:
        """Return whether anything acts that depends on the shape."""
        return bool(self.cables or self.around.pressed or self.around.followers or self.around.obstacles)


def _scaled(share: float, vector: Vector) -> Vector:
    return share * vector[0], share * vector[1], share * vector[2]


def parse_loads(
    mesh: Mesh, data: Mapping[str, Any], newtons: float, length_m: float, density_kg_m3: tuple[float | None, ...]
) -> CaseLoads:
    """Return the loads, obstacles and cables of a case.

    Args:
        mesh: in the case's unit.
        data: the case's mapping.
        newtons: newtons in the case's unit of force.
        length_m: metres in its unit of length.
        density_kg_m3: of every material number, None where the case gives none.
    """
    dead, any_dead = np.zeros_like(mesh.nodes), False
    pressed: list[Index] = []
    pressures: list[float] = []
    patches: list[FollowerPatch] = []
    follower_forces: list[Vector] = []
    for index, spec in enumerate(values.entries("loads", data.get("loads", []))):
        where = f"loads[{index}]"
        if "gravity_m_s2" in spec:
            values.keys(where, spec, {"gravity_m_s2"}, set())
            dead += _weight(where, mesh, spec, newtons, length_m, density_kg_m3)
            any_dead = True
            continue
        kind = [k for k in ("force_n", "pressure", "follower_n") if k in spec]
        if len(kind) != 1:
            raise GdfeError(
                f"{where}: expected one of force_n, pressure, follower_n, gravity_m_s2, found {sorted(spec)}"
            )
        values.keys(where, spec, {"face", kind[0]}, set())
        quads = face_quads(mesh, spec["face"], f"{where}.face")
        if kind[0] == "pressure":
            pressed.append(quads)
            pressures.append(values.number(f"{where}.pressure", spec["pressure"]))
            continue
        force = values.along_axes(f"{where}.{kind[0]}", spec[kind[0]])
        in_unit = _scaled(1.0 / newtons, force)
        if kind[0] == "follower_n":
            patches.append(FollowerPatch.of_faces(mesh, quads))
            follower_forces.append(in_unit)
        else:
            dead += face_shares(mesh.nodes, quads)[:, None] * np.array(in_unit)
            any_dead = True
    obstacles, motions = _obstacles(mesh, data.get("obstacles", []))
    cables, drives = _cables(mesh, data.get("cables", []), newtons)
    return CaseLoads(
        dead if any_dead else None,
        Surroundings(tuple(pressed), tuple(patches), obstacles),
        Acts(tuple(pressures), tuple(follower_forces), motions),
        cables,
        drives,
    )


def _weight(
    where: str, mesh: Mesh, spec: dict[str, Any], newtons: float, length_m: float, density: tuple[float | None, ...]
) -> Array:
    missing = [str(number) for number, known in enumerate(density) if known is None]
    if missing:
        raise GdfeError(
            f"{where}: weight needs density_kg_m3 in every material, missing in number {', '.join(missing)}"
        )
    acceleration = values.along_axes(f"{where}.gravity_m_s2", spec["gravity_m_s2"])
    scale = length_m**3 / newtons  # N/m^3 -> the case's force per its volume
    return gravity(mesh, tuple(scale * d for d in density if d is not None), acceleration)


_OBSTACLE_KEYS = {
    ObstacleShape.PLANE: {"point", "normal"},
    ObstacleShape.SPHERE: {"centre", "radius"},
    ObstacleShape.CYLINDER: {"point", "axis", "radius"},
}


def _obstacles(mesh: Mesh, data: Any) -> tuple[tuple[Obstacle, ...], tuple[Vector, ...]]:
    obstacles: list[Obstacle] = []
    motions: list[Vector] = []
    for index, spec in enumerate(values.entries("obstacles", data)):
        where = f"obstacles[{index}]"
        kinds = [shape for shape in ObstacleShape if str(shape) in spec]
        if len(kinds) != 1:
            raise GdfeError(f"{where}: expected one of {', '.join(ObstacleShape)}, found {sorted(spec)}")
        shape = kinds[0]
        values.keys(where, spec, {str(shape)}, {"touches", "friction", "move"})
        body = values.mapping(f"{where}.{shape}", spec[str(shape)])
        values.keys(f"{where}.{shape}", body, _OBSTACLE_KEYS[shape], set())
        touches = spec.get("touches", SURFACE)
        nodes = np.unique(mesh.surface()) if touches == SURFACE else face_nodes(mesh, touches, f"{where}.touches")
        axis = body.get("normal", body.get("axis", [0.0, 1.0, 0.0]))
        try:
            obstacle = Obstacle(
                shape,
                values.vector(f"{where}.{shape}", body.get("point", body.get("centre"))),
                nodes.astype(np.int32),
                values.vector(f"{where}.{shape}", axis),
                values.number(f"{where}.{shape}.radius", body.get("radius", 0.0)),
                values.number(f"{where}.friction", spec.get("friction", 0.0)),
            )
        except GdfeError as error:
            raise error if str(error).startswith(where) else GdfeError(f"{where}: {error}") from error
        obstacles.append(obstacle)
        motions.append(values.along_axes(f"{where}.move", spec.get("move", {})))
    return tuple(obstacles), tuple(motions)


def _cables(mesh: Mesh, data: Any, newtons: float) -> tuple[tuple[RoutedCable, ...], tuple[CableDrive, ...]]:
    cables: list[RoutedCable] = []
    drives: list[CableDrive] = []
    for index, spec in enumerate(values.entries("cables", data)):
        where = f"cables[{index}]"
        if abs(newtons - 1.0) > 1e-12:
            raise GdfeError(f"{where}: cables need units whose force is the newton (mm and MPa, or m and Pa)")
        values.keys(where, spec, {"points"}, {"guides", "entry", "friction", "pull", "tension_n"})
        if ("pull" in spec) == ("tension_n" in spec):
            raise GdfeError(f"{where}: expected either pull (a length) or tension_n, found {sorted(spec)}")
        if not isinstance(spec["points"], list) or len(spec["points"]) < 2:
            raise GdfeError(f"{where}.points: expected two points or more, found {spec['points']!r}")
        positions = [values.vector(f"{where}.points", point) for point in spec["points"]]
        guides = int(values.number(f"{where}.guides", spec.get("guides", 0), 0.0))
        points = [guide(at) for at in positions[:guides]]
        try:
            points += [attach(mesh, at) for at in positions[guides:]]
        except GdfeError as error:
            raise GdfeError(f"{where}.points: {error}") from error
        entry = values.vector(f"{where}.entry", spec["entry"]) if "entry" in spec else None
        if entry is not None and not np.linalg.norm(entry) > 0.0:
            raise GdfeError(f"{where}.entry: expected a direction other than 0, found {entry}")
        unit = None if entry is None else _scaled(1.0 / float(np.linalg.norm(entry)), entry)
        cables.append(RoutedCable(tuple(points), _friction(f"{where}.friction", spec.get("friction")), unit))
        by_length = "pull" in spec
        drives.append(CableDrive(values.number(where, spec["pull" if by_length else "tension_n"], 0.0), by_length))
    return tuple(cables), tuple(drives)


def _friction(where: str, data: Any) -> FrictionLaw:
    if data is None:
        return FRICTIONLESS
    spec = values.mapping(where, data)
    values.keys(where, spec, {"law", "coefficients", "radius_mm"}, {"k_reading"})
    law = values.choice(f"{where}.law", FrictionName, spec["law"])
    reading = values.choice(f"{where}.k_reading", KReading, spec.get("k_reading", KReading.PRINTED))
    if not isinstance(spec["coefficients"], list):
        raise GdfeError(f"{where}.coefficients: expected a list, found {spec['coefficients']!r}")
    coefficients = tuple(values.number(f"{where}.coefficients", c) for c in spec["coefficients"])
    try:
        return FrictionLaw(law, coefficients, values.number(f"{where}.radius_mm", spec["radius_mm"]), reading)
    except FrictionError as error:
        raise GdfeError(f"{where}: {error}") from error
