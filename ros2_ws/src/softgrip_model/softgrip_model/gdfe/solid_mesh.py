# SPDX-License-Identifier: Apache-2.0
"""A finger as it is printed: the STEP file of `parts`, meshed by gmsh, every tetrahedron cut into four hexahedra.

gmsh runs as a program of its own (apt-get install gmsh): nothing of it is loaded here. Frame as in finger_mesh.py; the
joint is the apex of its groove: the strip lies on the far side of it.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger
from softgrip_model.gdfe.cable import RoutingPoint, guide
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import FingerMesh
from softgrip_model.gdfe.mesh import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int32]

#: Material around a routing point that holds the cable there; more of it where elements are larger.
MOUTH_REACHES_MM = (2.5, 4.0, 6.0)
#: The end of the last link, that the anchor and the tip move with.
TIP_REACH_MM = 4.0
#: A solid may be longer or shorter, its strips thicker or thinner than the profile says by this much.
SIZE_TOLERANCE_MM = 0.1
#: Nodes so near to a flank lie on it.
ON_THE_FLANK_MM = 1e-3
TIME_LIMIT_S = 900.0

_EDGES = tuple(combinations(range(4), 2))
_FACES = tuple(combinations(range(4), 3))
#: The other corners in the order in which a positive tetrahedron shows them to a corner.
_OPPOSITE = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))


@dataclass(frozen=True)
class ElementSize:
    """How finely gmsh meshes: largest and smallest edge [mm], and edges around a full circle."""

    largest_mm: float = 3.0
    smallest_mm: float = 0.25
    around: int = 6


def tetrahedra_of(step: Path, size: ElementSize | None = None, program: str = "gmsh") -> tuple[Array, Index]:
    """Return nodes (n, 3) and tetrahedra (m, 4) of a solid in a STEP file.

    Raises:
        GdfeError: no gmsh, no such file, no solid, or a solid that gmsh cannot mesh.
    """
    size = size or ElementSize()
    if not step.is_file():
        raise GdfeError(f"{step}: expected a STEP file, as `ros2 run softgrip_design parts` writes it; found none")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "solid.msh"
        numbers = {
            "Mesh.MeshSizeMax": size.largest_mm,
            "Mesh.MeshSizeMin": size.smallest_mm,
            "Mesh.MeshSizeFromCurvature": size.around,
            "Mesh.Algorithm3D": 10,  # HXT: the others stop at the small edges around a channel's mouth
        }
        options = [text for name, value in numbers.items() for text in ("-setnumber", name, f"{value:g}")]
        command = [program, str(step.absolute()), "-3", "-v", "1", *options, "-format", "msh22", "-o", str(out)]
        try:
            ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIME_LIMIT_S)
        except FileNotFoundError as error:
            raise GdfeError(f"gmsh: expected the program {program!r}, found none; apt-get install gmsh") from error
        except subprocess.TimeoutExpired as error:
            raise GdfeError(f"{step}: gmsh took longer than {TIME_LIMIT_S:g} s; ask for larger elements") from error
        cells = meshio.read(out).cells_dict if out.exists() else {}
        if ran.returncode != 0 or "tetra" not in cells:
            said = (ran.stdout + ran.stderr).strip().splitlines()
            raise GdfeError(f"{step}: expected a solid that gmsh can mesh; it says: {' '.join(said[-3:]) or 'nothing'}")
        return np.asarray(meshio.read(out).points, dtype=np.float64), np.asarray(cells["tetra"], dtype=np.int32)


def cut_into_hexahedra(nodes: Array, tetrahedra: Index) -> tuple[Array, Index]:
    """Return nodes and hexahedra of tetrahedra cut at the middles of edges, faces and themselves: four of each.

    An affine map takes any tetrahedron to any other, so none of the four is inverted.
    """
    edges_of = nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]
    inside_out = np.linalg.det(edges_of) < 0.0
    tetrahedra = np.where(inside_out[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)
    edges, edge_of = np.unique(np.sort(tetrahedra[:, _EDGES], axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    faces, face_of = np.unique(np.sort(tetrahedra[:, _FACES], axis=2).reshape(-1, 3), axis=0, return_inverse=True)
    first_face = len(nodes) + len(edges)
    edge_of = edge_of.reshape(-1, len(_EDGES)) + len(nodes)
    face_of = face_of.reshape(-1, len(_FACES)) + first_face
    middle = np.arange(len(tetrahedra)) + first_face + len(faces)

    def between(*of: int) -> NDArray[np.int_]:
        known = tuple(sorted(of))
        return np.asarray(edge_of[:, _EDGES.index(known)] if len(of) == 2 else face_of[:, _FACES.index(known)])

    hexes = [
        np.stack([tetrahedra[:, v], between(v, p), between(v, p, q), between(v, q),
                  between(v, r), between(v, p, r), middle, between(v, q, r)], axis=1)
        for v, (p, q, r) in enumerate(_OPPOSITE)
    ]  # fmt: skip
    all_nodes = [nodes, *(nodes[part].mean(axis=1) for part in (edges, faces, tetrahedra))]
    return np.concatenate(all_nodes), np.concatenate(hexes).astype(np.int32)


def mesh_solid(step: Path, finger: Finger, size: ElementSize | None = None, program: str = "gmsh") -> FingerMesh:
    """Return the mesh of a printed finger, without what lies behind its first groove: that is held.

    Args:
        step: of the finger, in the frame of `parts`: x from the first joint, closing towards -y [mm].
        finger: the profile's, as the kernel computes it: joints, grooves and routing points are where it says.
        size: of the elements.
        program: gmsh.

    Raises:
        GdfeError: as `tetrahedra_of`, or a solid that is not this finger's.
    """
    nodes, tetrahedra = tetrahedra_of(step, size, program)
    return SolidFinger(finger, step).cut(*cut_into_hexahedra(nodes + np.array([finger.base_mm, 0.0, 0.0]), tetrahedra))


class SolidFinger:
    """Where the joints, grooves and routing points of a finger lie in a solid of it."""

    def __init__(self, finger: Finger, step: Path) -> None:
        self.finger, self.step = finger, step
        self.apex = finger.base_mm + np.concatenate([[0.0], np.cumsum(finger.link_mm[:-1])])
        self.end = finger.base_mm + sum(finger.link_mm)

    def side_of(self, nodes: Array, joint: int) -> Array:
        """Return -1 for nodes before a joint's groove and its strip, 1 for those behind, 0 for those of the strip.

        Below the strip the flanks of the groove count alone: a lip reaches under the strip (docs/parts.md).
        """
        depth, half = -nodes[:, 1], 0.5 * self.finger.length_mm[joint]
        flank = depth * math.tan(0.5 * self.finger.opening_rad[joint])
        reach = np.where(depth > ON_THE_FLANK_MM, flank, half) - ON_THE_FLANK_MM
        away = nodes[:, 0] - self.apex[joint]
        return np.asarray(np.sign(away) * (np.abs(away) >= reach))

    def cut(self, nodes: Array, hexes: Index) -> FingerMesh:
        """Return the finger of hexahedra of the whole solid."""
        self._check_sizes(nodes)
        kept = hexes[~(self.side_of(nodes, 0) < 0.0)[hexes].all(axis=1)]
        used, renumbered = np.unique(kept, return_inverse=True)
        mesh = Mesh(nodes[used], renumbered.reshape(-1, 8).astype(np.int32), np.zeros(len(kept), dtype=np.int32))
        return FingerMesh(
            mesh,
            self.clamped(mesh.nodes),
            self.routing(mesh.nodes),
            self.tip(mesh.nodes),
            self.links(mesh.nodes),
            self.sections(mesh),
        )

    def clamped(self, nodes: Array) -> Index:
        """Return the nodes that are held: those before the first groove and its strip."""
        return _numbers(self.side_of(nodes, 0) < 0.0)

    def routing(self, nodes: Array) -> tuple[RoutingPoint, ...]:
        """Return the cable's points from the base to the anchor; the material around each carries it."""
        points = []
        for joint, half in enumerate(0.5 * np.asarray(self.finger.opening_rad)):
            for side, radius in zip((-1.0, 1.0), self.finger.routing_mm[2 * joint : 2 * joint + 2], strict=True):
                x = float(self.apex[joint]) + side * radius * math.sin(half)
                position = (x, -radius * math.cos(half), 0.0)
                if joint == 0 and side < 0.0:
                    points.append(guide(position))
                    continue
                away = np.linalg.norm(nodes - position, axis=1)
                own = self.side_of(nodes, joint) == side
                choices = [_numbers(own & (away < reach)) for reach in MOUTH_REACHES_MM]
                points.append(self._tab(nodes, position, f"routing point {len(points)}", choices))
        anchor = (float(self.end), points[-1].position[1], 0.0)
        return (*points, self._tab(nodes, anchor, "the anchor", [self._at_tip(nodes)]))

    def tip(self, nodes: Array) -> RoutingPoint:
        """Return the end of the last link on the line of the apexes."""
        return self._tab(nodes, (float(self.end), 0.0, 0.0), "the tip", [self._at_tip(nodes)])

    def links(self, nodes: Array) -> tuple[Index, ...]:
        """Return the nodes of each link beyond the flanks of its grooves and the ends of their strips."""
        sides = [self.side_of(nodes, joint) for joint in range(self.finger.joints)]
        before = [*(side < 0.0 for side in sides[1:]), np.ones(len(nodes), dtype=bool)]
        return tuple(_numbers((side > 0.0) & end) for side, end in zip(sides, before, strict=True))

    def sections(self, mesh: Mesh) -> Index:
        """Return the cross-section of each node: slices as thin as the elements allow.

        Elements of a solid lie in no layers: what is equally far from the base, counted in them, is no cross-section.
        """
        return slices(self.along(mesh.nodes), mesh.hexes, float(self.apex[0] - 0.5 * self.finger.length_mm[0]))

    def along(self, nodes: Array) -> Array:
        """Return where along the finger the nodes are: a lip is where its link begins, as the strip bends beside it."""
        along = nodes[:, 0].copy()
        for joint, half in enumerate(0.5 * np.asarray(self.finger.length_mm)):
            side, apex = self.side_of(nodes, joint), self.apex[joint]
            in_lip = (np.abs(nodes[:, 0] - apex) < half) & (side != 0.0)
            along[in_lip] = apex + side[in_lip] * half
        return along

    def _at_tip(self, nodes: Array) -> Index:
        return _numbers(nodes[:, 0] > self.end - TIP_REACH_MM)

    def _check_sizes(self, nodes: Array) -> None:
        expected = {"end of the finger, from its first joint": self.end - self.apex[0]}
        found = {next(iter(expected)): nodes[:, 0].max() - self.apex[0]}
        for joint, thickness in enumerate(self.finger.thickness_mm):
            name = f"thickness of strip {joint}"
            beside = np.abs(nodes[:, 0] - self.apex[joint]) < 0.5 * self.finger.length_mm[joint]
            expected[name], found[name] = thickness, nodes[beside, 1].max(initial=0.0)
        for name, size in expected.items():
            if abs(found[name] - size) > SIZE_TOLERANCE_MM:
                raise GdfeError(
                    f"{self.step}: {name}: expected {size:.2f} mm, as the profile says, found {found[name]:.2f} mm; "
                    "make the parts of this profile and finger, or name the solid's own (--finger PROFILE/FINGER)"
                )

    def _tab(
        self, nodes: Array, position: tuple[float, float, float], name: str, choices: Sequence[Index]
    ) -> RoutingPoint:
        """Weights of least norm that reproduce any affine motion of the first choice of nodes that has one."""
        required = np.array([1.0, 0.0, 0.0, 0.0])
        for chosen in choices:
            moments = np.vstack([np.ones(len(chosen)), (nodes[chosen] - position).T])
            weights = np.linalg.lstsq(moments, required, rcond=None)[0]
            if np.abs(moments @ weights - required).max() < 1e-6:
                return RoutingPoint(position, chosen, weights)
        raise GdfeError(
            f"{self.step}: expected material around {name} at {tuple(round(p, 2) for p in position)} mm, found "
            f"{len(choices[-1])} nodes; make the parts of this profile and finger, or ask for smaller elements"
        )


def slices(along: Array, hexes: Index, start: float) -> Index:
    """Return the slice of each node, from 0: as thin ones as leave only neighbours in a hexahedron.

    Args:
        along: (n,) where the nodes are, of hexahedra that hang together.
        hexes: (m, 8)
        start: nodes up to here are in the first slice.
    """
    first, last = along[hexes].min(axis=1), along[hexes].max(axis=1)
    cuts: list[float] = []
    cut = start
    while cut < last.max():
        cut = float(last[first <= cut].max())
        cuts.append(cut)
    return np.searchsorted(np.array(cuts), along, side="left").astype(np.int32)


def _numbers(chosen: NDArray[np.bool_]) -> Index:
    return np.flatnonzero(chosen).astype(np.int32)
