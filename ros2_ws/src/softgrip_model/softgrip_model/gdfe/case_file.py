# SPDX-License-Identifier: Apache-2.0
"""Cases as YAML files: mesh, materials, supports, loads, and what to compare with. Strict: unknown keys are errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from softgrip_model.gdfe import case_values as values
from softgrip_model.gdfe.case_loads import CaseLoads, face_nodes, parse_loads
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.march import Loading
from softgrip_model.gdfe.materials import Linear, Ogden, SolidMaterial, StressPolynomial, VolumeShape, neo_hookean
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.mesh_file import read_mesh
from softgrip_model.gdfe.solver import ConstitutiveLaw, Supports

Array = NDArray[np.float64]
Index = NDArray[np.int32]

SCHEMA = 1
#: Some 10 GB of memory.
MAX_HEXAHEDRA = 1_000_000
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
STRESS_UNITS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6}


@dataclass(frozen=True)
class CaseComparison:
    """What a case is compared with: a shipped CalculiX deck, and published figures as text."""

    reference: str = ""
    published: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Case:
    """One case, ready to be marched."""

    title: str
    length_unit: str
    stress_unit: str
    mesh: Mesh
    materials: tuple[SolidMaterial, ...]
    supports: Supports
    loads: CaseLoads
    loading: Callable[[float], Loading]
    law: ConstitutiveLaw
    volume_shape: VolumeShape
    increments: int
    tolerance: float
    compare: CaseComparison

    @property
    def newtons(self) -> float:
        """Newtons in the case's unit of force."""
        return STRESS_UNITS[self.stress_unit] * LENGTH_UNITS[self.length_unit] ** 2

    def face(self, name: str) -> Index:
        """Return the nodes of a face of the mesh's bounding box."""
        return face_nodes(self.mesh, name)


@dataclass(frozen=True)
class FingerCase:
    """A finger closed by its tendon."""

    title: str
    profile: str
    finger: str
    resolution: str
    pull_m: float
    steps: int


def load_case(path: Path, *, mesh_file: Path | None = None, refine: int = 1) -> Case | FingerCase:
    """Read a case.

    Args:
        path: of the YAML file.
        mesh_file: used instead of the case's own mesh.
        refine: times as many elements each way of a bar.

    Raises:
        GdfeError: what is wrong, at which key.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GdfeError(f"{path}: cannot be read as a case: {error}") from error
    if refine < 1:
        raise GdfeError(f"refinement: expected 1 or more, found {refine}")
    if isinstance(data, dict) and mesh_file is not None:
        data = {**data, "mesh": {"file": str(mesh_file.absolute())}}
    try:
        return parse_case(data, path.parent, refine)
    except GdfeError as error:
        raise GdfeError(f"{path}: {error}") from error


def parse_case(data: Any, folder: Path, refine: int = 1) -> Case | FingerCase:
    """Return the case that YAML data describe; mesh files are looked for in the folder.

    Raises:
        GdfeError: what is wrong, at which key.
    """
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        found = data.get("schema") if isinstance(data, dict) else type(data).__name__
        raise GdfeError(f"schema: expected {SCHEMA}, found {found!r}")
    if "finger" in data:
        return _finger_case(data)
    values.keys(
        "case",
        data,
        {"schema", "title", "units", "mesh", "materials", "boundary"},
        {"law", "volume_shape", "increments", "tolerance", "loads", "obstacles", "cables", "compare"},
    )
    units = values.mapping("units", data["units"])
    values.keys("units", units, {"length", "stress"}, set())
    unit_m = values.one_of("units.length", units["length"], LENGTH_UNITS)
    unit_pa = values.one_of("units.stress", units["stress"], STRESS_UNITS)
    named, density = _materials(values.mapping("materials", data["materials"]))
    mesh, used = _mesh(values.mapping("mesh", data["mesh"]), named, folder, refine)
    supports, prescribe = _boundary(mesh, data["boundary"])
    loads = parse_loads(mesh, data, unit_pa * unit_m**2, unit_m, tuple(density[name] for name in used))
    compare = values.mapping("compare", data.get("compare", {}))
    values.keys("compare", compare, set(), {"reference", "published"})
    published = values.mapping("compare.published", compare.get("published", {}))
    return Case(
        title=str(data["title"]),
        length_unit=str(units["length"]),
        stress_unit=str(units["stress"]),
        mesh=mesh,
        materials=tuple(named[name] for name in used),
        supports=supports,
        loads=loads,
        loading=loads.loading(prescribe),
        law=values.choice("law", ConstitutiveLaw, data.get("law", ConstitutiveLaw.CALIBRATED)),
        volume_shape=values.choice("volume_shape", VolumeShape, data.get("volume_shape", VolumeShape.PROJ)),
        increments=int(values.number("increments", data.get("increments", 1), 1)),
        tolerance=values.number("tolerance", data.get("tolerance", 1e-6), 1e-12),
        compare=CaseComparison(
            str(compare.get("reference", "")), {name: str(figure) for name, figure in published.items()}
        ),
    )


def _finger_case(data: dict[str, Any]) -> FingerCase:
    values.keys("case", data, {"schema", "title", "finger"}, set())
    finger = values.mapping("finger", data["finger"])
    values.keys("finger", finger, {"profile", "finger", "pull_m"}, {"resolution", "steps"})
    return FingerCase(
        str(data["title"]),
        str(finger["profile"]),
        str(finger["finger"]),
        str(finger.get("resolution", "coarse")),
        values.number("finger.pull_m", finger["pull_m"], 1e-4),
        int(values.number("finger.steps", finger.get("steps", 20), 1)),
    )


def _mesh(
    data: dict[str, Any], materials: Mapping[str, SolidMaterial], folder: Path, refine: int
) -> tuple[Mesh, tuple[str, ...]]:
    if set(data) == {"file"}:
        mesh, names = read_mesh(folder / str(data["file"]))
        used = names or tuple(materials)
    elif set(data) == {"bar"}:
        spec = values.mapping("mesh.bar", data["bar"])
        values.keys("mesh.bar", spec, {"size", "elements", "materials"}, set())
        if not isinstance(spec["materials"], list) or not spec["materials"]:
            raise GdfeError(f"mesh.bar.materials: expected a list of names, found {spec['materials']!r}")
        used = tuple(str(name) for name in spec["materials"])
        size = values.numbers("mesh.bar.size", spec["size"], 1e-9, count=3)
        each = values.numbers("mesh.bar.elements", spec["elements"], 1, count=3)
        count = tuple(refine * int(n) for n in each)
        if math.prod(count) > MAX_HEXAHEDRA:
            raise GdfeError(f"mesh.bar.elements: expected {MAX_HEXAHEDRA} hexahedra or fewer, found {count}")
        mesh = bar((size[0], size[1], size[2]), (count[0], count[1], count[2]), len(used))
    else:
        raise GdfeError(f"mesh: expected 'bar' or 'file', found {sorted(data)}")
    unknown = [name for name in used if name not in materials]
    if unknown:
        raise GdfeError(f"mesh: unknown materials {unknown}; the case defines {sorted(materials)}")
    return mesh, used


def _materials(data: dict[str, Any]) -> tuple[dict[str, SolidMaterial], dict[str, float | None]]:
    """Return materials and densities [kg/m^3] by name."""
    named: dict[str, SolidMaterial] = {}
    density: dict[str, float | None] = {}
    for key, entry in data.items():
        spec = dict(values.mapping(f"materials.{key}", entry))
        given = spec.pop("density_kg_m3", None)
        density[str(key)] = None if given is None else values.number(f"materials.{key}.density_kg_m3", given, 0.0)
        named[str(key)] = _material(str(key), spec)
    return named, density


def _material(name: str, spec: dict[str, object]) -> SolidMaterial:
    where = f"materials.{name}"
    if len(spec) != 1:
        raise GdfeError(f"{where}: expected one of linear, polynomial, ogden, neo_hookean, found {sorted(spec)}")
    kind, body = next(iter(spec.items()))
    given = values.mapping(f"{where}.{kind}", body)
    if kind == "linear":
        values.keys(where, given, {"modulus", "poisson"}, set())
        return Linear(name, values.number(where, given["modulus"]), values.number(where, given["poisson"]))
    if kind == "polynomial":
        values.keys(where, given, {"coefficients", "poisson", "max_strain"}, set())
        limit = values.number(where, given["max_strain"])
        coefficients = values.numbers(f"{where}.coefficients", given["coefficients"])
        return StressPolynomial(name, coefficients, values.number(where, given["poisson"]), (-limit, limit))
    if kind == "ogden":
        values.keys(where, given, {"mu", "alpha", "poisson"}, set())
        mu, alpha = (values.numbers(f"{where}.{key}", given[key]) for key in ("mu", "alpha"))
        return Ogden(name, mu, alpha, values.number(where, given["poisson"]))
    if kind == "neo_hookean":
        values.keys(where, given, {"shear_modulus", "poisson"}, set())
        return neo_hookean(name, values.number(where, given["shear_modulus"]), values.number(where, given["poisson"]))
    raise GdfeError(f"{where}: expected linear, polynomial, ogden or neo_hookean, found {kind!r}")


def _boundary(mesh: Mesh, data: Any) -> tuple[Supports, Callable[[float], Array]]:
    if not isinstance(data, list) or not data:
        raise GdfeError("boundary: expected a list of conditions, found none; nothing would hold the mesh")
    supports = Supports.none(len(mesh.nodes))
    parts: list[Callable[[float, Array], None]] = []
    for number, entry in enumerate(data):
        where = f"boundary[{number}]"
        spec = values.mapping(where, entry)
        values.keys(where, spec, {"face"}, {"fix", "displace", "rotate", "tie"})
        nodes = face_nodes(mesh, str(spec["face"]))
        if "fix" in spec:
            supports = supports.with_prescribed(nodes, values.axes(where, spec["fix"]))
        if "displace" in spec:
            moves = {
                values.axes(where, k): values.number(where, v)
                for k, v in values.mapping(where, spec["displace"]).items()
            }
            supports = supports.with_prescribed(nodes, "".join(moves))
            parts.append(_displace(nodes, moves))
        if "rotate" in spec:
            turn = values.mapping(where, spec["rotate"])
            values.keys(f"{where}.rotate", turn, {"axis", "angle_deg"}, set())
            supports = supports.with_prescribed(nodes)
            axis = values.axis(f"{where}.rotate.axis", turn["axis"])
            parts.append(_rotate(mesh, nodes, axis, np.radians(values.number(where, turn["angle_deg"]))))
        if "tie" in spec:
            for letter in values.axes(where, spec["tie"]):
                supports = supports.with_tied(nodes, letter)

    def prescribe(share: float) -> Array:
        prescribed = np.zeros_like(mesh.nodes)
        for part in parts:
            part(share, prescribed)
        return prescribed

    return supports, prescribe


def _displace(nodes: Index, moves: Mapping[str, float]) -> Callable[[float, Array], None]:
    def act(share: float, prescribed: Array) -> None:
        for axis, distance in moves.items():
            prescribed[nodes, "xyz".index(axis)] = share * distance

    return act


def _rotate(mesh: Mesh, nodes: Index, axis: int, angle: float) -> Callable[[float, Array], None]:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    centre = mesh.nodes[nodes].mean(axis=0)
    y, z = mesh.nodes[nodes, j] - centre[j], mesh.nodes[nodes, k] - centre[k]

    def act(share: float, prescribed: Array) -> None:
        c, s = np.cos(share * angle), np.sin(share * angle)
        prescribed[nodes, j] = c * y - s * z - y
        prescribed[nodes, k] = s * y + c * z - z

    return act
