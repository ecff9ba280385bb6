# SPDX-License-Identifier: Apache-2.0
"""The strips of the power finger of Fig 4.4, bent as its tendon bends them, with CalculiX' moments for that motion."""

from __future__ import annotations

from importlib import resources

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.closing import ClosingPath, ClosingSettings
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh
from softgrip_model.gdfe.materials import Linear
from softgrip_model.gdfe.solver import Solver, Supports
from softgrip_model.profile import load_directory, shipped_directory

Array = NDArray[np.float64]
Index = NDArray[np.int32]

NAME = "finger_strips_C3D8I_nu30"
#: CalculiX is led along these pulled lengths [mm].
STEPS_MM = tuple(float(k) for k in range(1, 13))
#: NinjaFlex at rest by Table 5.1; Hooke's law, in which CalculiX converges in these strips.
MATERIAL = Linear("NinjaFlex at rest", 11.03, 0.3)


def reference_closing(travel_mm: float = STEPS_MM[-1]) -> ClosingPath:
    """Return the finger of the reference, ready up to a pulled length."""
    profile = load_directory(shipped_directory())["power"]
    settings = ClosingSettings(RESOLUTIONS["fine"], travel_mm, tolerance=1e-5, max_iterations=4000)
    return ClosingPath(profile, "index", settings, material=MATERIAL)


def led_nodes(finger: FingerMesh) -> Index:
    """Return the nodes of base and links: they are moved, the strips between them are free."""
    return np.unique(np.concatenate([finger.clamped, *finger.link_nodes])).astype(np.int32)


def strip_moments(finger: FingerMesh, displacement: Array, held: Array) -> Array:
    """Return the moment [N mm] about z in the middle of each strip, (joints,).

    Args:
        finger: its mesh.
        displacement: (n, 3) [mm] of base and links.
        held: (n, 3) [N] forces that hold them there.
    """
    at = finger.mesh.nodes + displacement
    free = np.setdiff1d(np.arange(len(at)), led_nodes(finger))
    links_x = [finger.mesh.nodes[nodes, 0].mean() for nodes in finger.link_nodes]
    strip_of = np.searchsorted(links_x, finger.mesh.nodes[free, 0])
    moments = []
    for joint in range(len(finger.link_nodes)):
        beyond = np.unique(np.concatenate(finger.link_nodes[joint:]))
        centre = at[free[strip_of == joint]].mean(axis=0)
        moments.append(np.cross(at[beyond] - centre, held[beyond]).sum(axis=0)[2])
    return np.array(moments)


def our_moments(closing: ClosingPath, pulled_mm: float) -> Array:
    """Return the moments [N mm] of our strips when base and links stand as at a pulled length, (joints,).

    Raises:
        GdfeError: no equilibrium.
    """
    finger = closing.finger_mesh
    moved = 1e3 * closing.shape(1e-3 * pulled_mm).vertices - finger.mesh.nodes
    supports = Supports.none(len(moved)).with_prescribed(led_nodes(finger))
    solver = Solver(finger.mesh, [MATERIAL], supports)
    found = solver.solve(moved, start=closing.state(pulled_mm), tolerance=1e-6, max_iterations=4000)
    if not found.converged:
        raise GdfeError(
            f"strips at {pulled_mm:g} mm: residual {found.residual:.1e} after {found.iterations} iterations"
        )
    return strip_moments(finger, moved, found.reaction)


def calculix_moments() -> dict[float, Array]:
    """Return pulled length [mm] -> CalculiX' moments [N mm], (joints,)."""
    path = resources.files("softgrip_model.gdfe") / "reference" / f"{NAME}.npz"
    with resources.as_file(path) as file, np.load(file) as data:
        return dict(zip(data["pulled_mm"].tolist(), data["moment_nmm"], strict=True))
