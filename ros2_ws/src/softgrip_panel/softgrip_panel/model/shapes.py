# SPDX-License-Identifier: Apache-2.0
"""Deformed fingers for browsers: faces once for each mesh, then vertices and strain as float32."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger, FingerError
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, mesh_finger
from softgrip_model.gdfe.mesh import HEX_FACES
from softgrip_model.profile import ProfileError, load

#: First byte of a message.
FACES, SHAPE = 3, 4
#: Larger meshes are not shown.
MAX_NODES: Final = 200_000

Faces = NDArray[np.uint32]


@dataclass(frozen=True)
class PanelShape:
    """One shape/predicted.

    Attributes:
        number: grows with each.
        finger: slot.
        mesh: digest; another one means other faces.
        vertices: (3 n,) positions [m], as float32 bytes.
        faces: (4 f,) node numbers of outer quads.
        strain: (m,) equivalent strain per hexahedron, as float32 bytes.
    """

    number: int
    finger: str
    mesh: str
    vertices: bytes
    faces: Faces
    strain: bytes
    converged: bool
    pulled_length_m: float
    rate_hz: float
    reason: str


class FaceOwners:
    """Says to which hexahedron each outer face belongs: the message names no hexahedra, so their mesh is made again.

    Args:
        profiles: folder of finger profiles, None = nothing is known.
    """

    def __init__(self, profiles: Path | None) -> None:
        self._profiles = profiles
        self._known: dict[str, Faces | None] = {}

    def find(self, shape: PanelShape, profile: str) -> Faces | None:
        """Return (f,) hexahedron of each face; None where the profile's mesh is not that of the shape."""
        if shape.mesh not in self._known:
            if len(self._known) > 50:
                self._known.clear()
            self._known[shape.mesh] = self._find(shape, profile)
        return self._known[shape.mesh]

    def _find(self, shape: PanelShape, profile: str) -> Faces | None:
        if self._profiles is None or not profile or "/" in profile:
            return None
        hexahedra = len(shape.strain) // 4
        try:
            loaded = load(self._profiles / f"{profile}.yaml")
            finger = Finger.from_profile(loaded, shape.finger)
            for resolution in RESOLUTIONS.values():
                depth_mm = 1e3 * loaded.finger(shape.finger).body_height_m
                mesh = mesh_finger(finger, resolution, depth_mm).mesh
                if len(mesh.hexes) == hexahedra and np.array_equal(mesh.surface().ravel(), shape.faces):
                    quads = mesh.hexes[:, HEX_FACES].reshape(-1, 4)
                    _, first, count = np.unique(np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True)
                    return np.asarray(np.sort(first[count == 1]) // 6, dtype=np.uint32)
        except (OSError, KeyError, ProfileError, FingerError, GdfeError):
            return None
        return None


def pack_faces(shape: PanelShape, owners: Faces | None) -> bytes:
    """Return faces as one message: kind, length of the head, head, quads (uint32), owners (uint32, may be none)."""
    owned = np.zeros(0, np.uint32) if owners is None else owners
    head = {"finger": shape.finger, "mesh": shape.mesh, "faces": len(shape.faces) // 4, "owners": len(owned)}
    return _message(FACES, head, shape.faces.astype("<u4").tobytes() + owned.astype("<u4").tobytes())


def pack_shape(shape: PanelShape) -> bytes:
    """Return a shape as one message: kind, length of the head, head, vertices (float32), strain (float32)."""
    head = {
        "number": shape.number,
        "finger": shape.finger,
        "mesh": shape.mesh,
        "nodes": len(shape.vertices) // 12,
        "hexahedra": len(shape.strain) // 4,
        "converged": shape.converged,
        "pulled_mm": round(1e3 * shape.pulled_length_m, 2),
        "rate": round(shape.rate_hz, 1),
        "reason": shape.reason,
    }
    return _message(SHAPE, head, shape.vertices + shape.strain)


def _message(kind: int, head: dict[str, object], body: bytes) -> bytes:
    text = json.dumps(head).encode()
    text += b" " * (-(5 + len(text)) % 4)  # arrays of 4 bytes begin at a multiple of 4
    return struct.pack(">BI", kind, len(text)) + text + body
