# SPDX-License-Identifier: Apache-2.0
"""Cases as YAML files: mesh, materials, supports, loads, and what to compare with. Strict: unknown keys are errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.march import Loading
from softgrip_model.gdfe.materials import Linear, Material, Ogden, StressPolynomial, neo_hookean
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.mesh_file import read_mesh
from softgrip_model.gdfe.solver import Law, Supports, VolumeShape

Array = NDArray[np.float64]
Index = NDArray[np.int32]

SCHEMA = 1
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
STRESS_UNITS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6}
#: Faces of a mesh by the axis and end of its bounding box.
FACES = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1), "back": (2, 0), "front": (2, 1)}


@dataclass(frozen=True)
class Comparison:
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
    materials: tuple[Material, ...]
    supports: Supports
    loading: Callable[[float], Loading]
    law: Law
    volume_shape: VolumeShape
    increments: int
    tolerance: float
    compare: Comparison

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


def face_nodes(mesh: Mesh, name: str) -> Index:
    """Return the nodes of a face of the mesh's bounding box.

    Raises:
        GdfeError: no such face.
    """
    if name not in FACES:
        raise GdfeError(f"face: expected one of {', '.join(FACES)}, found {name!r}")
    axis, end = FACES[name]
    at = mesh.nodes[:, axis]
    edge = at.max() if end else at.min()
    return mesh.nodes_where(np.abs(at - edge) < 1e-6 * np.ptp(at))


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
    _keys(
        "case",
        data,
        {"schema", "title", "units", "mesh", "materials", "boundary"},
        {"law", "volume_shape", "increments", "tolerance", "loads", "compare"},
    )
    units = _mapping("units", data["units"])
    _keys("units", units, {"length", "stress"}, set())
    _one_of("units.length", units["length"], LENGTH_UNITS)
    _one_of("units.stress", units["stress"], STRESS_UNITS)
    named = {str(k): _material(str(k), v) for k, v in _mapping("materials", data["materials"]).items()}
    mesh, used = _mesh(_mapping("mesh", data["mesh"]), named, folder, refine)
    supports, prescribe = _boundary(mesh, data["boundary"])
    newtons = STRESS_UNITS[units["stress"]] * LENGTH_UNITS[units["length"]] ** 2
    load = _loads(mesh, data.get("loads", []), newtons)

    def loading(share: float) -> Loading:
        return Loading(prescribe(share), None if load is None else share * load)

    compare = _mapping("compare", data.get("compare", {}))
    _keys("compare", compare, set(), {"reference", "published"})
    return Case(
        title=str(data["title"]),
        length_unit=units["length"],
        stress_unit=units["stress"],
        mesh=mesh,
        materials=tuple(named[name] for name in used),
        supports=supports,
        loading=loading,
        law=_enum("law", Law, data.get("law", Law.CALIBRATED)),
        volume_shape=_enum("volume_shape", VolumeShape, data.get("volume_shape", VolumeShape.PROJ)),
        increments=int(_number("increments", data.get("increments", 1), 1)),
        tolerance=_number("tolerance", data.get("tolerance", 1e-6), 1e-12),
        compare=Comparison(
            str(compare.get("reference", "")), _mapping("compare.published", compare.get("published", {}))
        ),
    )


def _finger_case(data: dict[str, Any]) -> FingerCase:
    _keys("case", data, {"schema", "title", "finger"}, set())
    finger = _mapping("finger", data["finger"])
    _keys("finger", finger, {"profile", "finger", "pull_m"}, {"resolution", "steps"})
    return FingerCase(
        str(data["title"]),
        str(finger["profile"]),
        str(finger["finger"]),
        str(finger.get("resolution", "coarse")),
        _number("finger.pull_m", finger["pull_m"], 1e-4),
        int(_number("finger.steps", finger.get("steps", 20), 1)),
    )


def _mesh(
    data: dict[str, Any], materials: Mapping[str, Material], folder: Path, refine: int
) -> tuple[Mesh, tuple[str, ...]]:
    if set(data) == {"file"}:
        mesh, names = read_mesh(folder / str(data["file"]))
        used = names or tuple(materials)
    elif set(data) == {"bar"}:
        spec = _mapping("mesh.bar", data["bar"])
        _keys("mesh.bar", spec, {"size", "elements", "materials"}, set())
        used = tuple(str(name) for name in spec["materials"])
        size = tuple(_number("mesh.bar.size", s, 1e-9) for s in spec["size"])
        count = tuple(refine * int(_number("mesh.bar.elements", n, 1)) for n in spec["elements"])
        if len(size) != 3 or len(count) != 3:
            raise GdfeError(f"mesh.bar: expected three sizes and three numbers of elements, found {size} and {count}")
        mesh = bar((size[0], size[1], size[2]), (count[0], count[1], count[2]), len(used))
    else:
        raise GdfeError(f"mesh: expected 'bar' or 'file', found {sorted(data)}")
    unknown = [name for name in used if name not in materials]
    if unknown:
        raise GdfeError(f"mesh: unknown materials {unknown}; the case defines {sorted(materials)}")
    return mesh, used


def _material(name: str, data: Any) -> Material:
    where = f"materials.{name}"
    spec = _mapping(where, data)
    if len(spec) != 1:
        raise GdfeError(f"{where}: expected one of linear, polynomial, ogden, neo_hookean, found {sorted(spec)}")
    kind, values = next(iter(spec.items()))
    values = _mapping(f"{where}.{kind}", values)
    if kind == "linear":
        _keys(where, values, {"modulus", "poisson"}, set())
        return Linear(name, _number(where, values["modulus"]), _number(where, values["poisson"]))
    if kind == "polynomial":
        _keys(where, values, {"coefficients", "poisson", "max_strain"}, set())
        limit = _number(where, values["max_strain"])
        coefficients = tuple(_number(where, c) for c in values["coefficients"])
        return StressPolynomial(name, coefficients, _number(where, values["poisson"]), (-limit, limit))
    if kind == "ogden":
        _keys(where, values, {"mu", "alpha", "poisson"}, set())
        mu, alpha = (tuple(_number(where, v) for v in values[key]) for key in ("mu", "alpha"))
        return Ogden(name, mu, alpha, _number(where, values["poisson"]))
    if kind == "neo_hookean":
        _keys(where, values, {"shear_modulus", "poisson"}, set())
        return neo_hookean(name, _number(where, values["shear_modulus"]), _number(where, values["poisson"]))
    raise GdfeError(f"{where}: expected linear, polynomial, ogden or neo_hookean, found {kind!r}")


def _boundary(mesh: Mesh, data: Any) -> tuple[Supports, Callable[[float], Array]]:
    if not isinstance(data, list) or not data:
        raise GdfeError("boundary: expected a list of conditions, found none; nothing would hold the mesh")
    supports = Supports.none(len(mesh.nodes))
    parts: list[Callable[[float, Array], None]] = []
    for number, entry in enumerate(data):
        where = f"boundary[{number}]"
        spec = _mapping(where, entry)
        _keys(where, spec, {"face"}, {"fix", "displace", "rotate", "tie"})
        nodes = face_nodes(mesh, str(spec["face"]))
        if "fix" in spec:
            supports = supports.with_prescribed(nodes, _axes(where, spec["fix"]))
        if "displace" in spec:
            moves = {_axes(where, k): _number(where, v) for k, v in _mapping(where, spec["displace"]).items()}
            supports = supports.with_prescribed(nodes, "".join(moves))
            parts.append(_displace(nodes, moves))
        if "rotate" in spec:
            turn = _mapping(where, spec["rotate"])
            _keys(f"{where}.rotate", turn, {"axis", "angle_deg"}, set())
            supports = supports.with_prescribed(nodes)
            axis = _axes(where, turn["axis"])
            parts.append(_rotate(mesh, nodes, "xyz".index(axis), np.radians(_number(where, turn["angle_deg"]))))
        if "tie" in spec:
            for axis in _axes(where, spec["tie"]):
                supports = supports.with_tied(nodes, axis)

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


def _loads(mesh: Mesh, data: Any, newtons: float) -> Array | None:
    """Dead forces in the case's unit; a face's force is shared alike by its nodes."""
    if not isinstance(data, list):
        raise GdfeError(f"loads: expected a list, found {data!r}")
    load = np.zeros_like(mesh.nodes)
    for number, entry in enumerate(data):
        where = f"loads[{number}]"
        spec = _mapping(where, entry)
        _keys(where, spec, {"face", "force_n"}, set())
        nodes = face_nodes(mesh, str(spec["face"]))
        for axis, force in _mapping(where, spec["force_n"]).items():
            load[nodes, "xyz".index(_axes(where, axis))] += _number(where, force) / newtons / len(nodes)
    return load if data else None


def _axes(where: str, value: Any) -> str:
    if not isinstance(value, str) or not value or set(value) - set("xyz"):
        raise GdfeError(f"{where}: expected axes out of x, y, z, found {value!r}")
    return value


def _keys(where: str, data: Mapping[str, Any], needed: set[str], possible: set[str]) -> None:
    missing, unknown = sorted(needed - set(data)), sorted(set(data) - needed - possible)
    if missing or unknown:
        raise GdfeError(f"{where}: missing keys {missing}, unknown keys {unknown}; it has {sorted(needed | possible)}")


def _mapping(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise GdfeError(f"{where}: expected a mapping, found {value!r}")
    return value


def _number(where: str, value: Any, least: float | None = None) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        hint = " (YAML reads exponents only as in 1.0e-6)" if isinstance(value, str) else ""
        raise GdfeError(f"{where}: expected a number, found {value!r}{hint}")
    if least is not None and value < least:
        raise GdfeError(f"{where}: expected {least:g} or more, found {value!r}")
    return float(value)


def _one_of(where: str, value: Any, known: Mapping[str, float]) -> None:
    if value not in known:
        raise GdfeError(f"{where}: expected one of {', '.join(known)}, found {value!r}")


def _enum(where: str, kind: Any, value: Any) -> Any:
    try:
        return kind(value)
    except ValueError as error:
        raise GdfeError(f"{where}: expected one of {[str(k) for k in kind]}, found {value!r}") from error
