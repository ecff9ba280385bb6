# SPDX-License-Identifier: Apache-2.0
"""The fingers of Fig 4.4 closed by their tendons in CalculiX, and ours with the same mesh, material and cable.

CalculiX knows no cable that slides through points with friction, but springs whose force does not depend on their
length: one between every two routing points, which are tied to the mesh as ours are, pulls as that stretch of a cable
does, in whatever direction it turns. The tensions from stretch to stretch are those that our friction law found.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.closing import ClosingPath, ClosingSettings
from softgrip_model.gdfe.finger_gradient import link_angles
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh
from softgrip_model.gdfe.materials import Ogden
from softgrip_model.profile import load_directory, shipped_directory

Array = NDArray[np.float64]

NAME = "finger_cable_calculix"
#: Neo-Hookean, NinjaFlex' modulus at rest by Table 5.1: the same uniaxial curve and Poisson's ratio in both.
MATERIAL = Ogden("NinjaFlex at rest", (11.03 / 2.6,), (2.0,), 0.3)


@dataclass(frozen=True)
class ClosedFinger:
    """A finger closed by a pulled length.

    Attributes:
        tip_mm: (2,) end of the last link in the plane of closing.
        joint_rad: (joints,) how far each link is turned against the one before, positive closing.
        tension_n: at the actuator.
    """

    tip_mm: Array
    joint_rad: Array
    tension_n: float


def closing_of(design: str) -> ClosingPath:
    """Return our closing of a shipped design's index finger on the coarse mesh."""
    profile = load_directory(shipped_directory())[design]
    settings = ClosingSettings(RESOLUTIONS["coarse"], travel_mm=18.0, tolerance=1e-5, max_iterations=6000)
    return ClosingPath(profile, "index", settings, material=MATERIAL)


def tip_of(finger: FingerMesh, displacement: Array) -> Array:
    """Return the tip (2,) [mm] of a mesh displaced by (n, 3) [mm]."""
    nodes = finger.tip.nodes
    return np.asarray(finger.tip.weights @ (finger.mesh.nodes[nodes, :2] + displacement[nodes, :2]))


def joints_of(finger: FingerMesh, displacement: Array) -> Array:
    """Return joint angles (joints,) [rad]: mean rotations about z of the links' nodes, from link to link."""
    turned, _ = link_angles(finger, finger.mesh.nodes + displacement)
    return np.diff(turned, prepend=0.0)


def shortening_of(finger: FingerMesh, displacement: Array) -> float:
    """Return by how much [mm] the cable through the routing points has become shorter."""

    def length(moved: Array) -> float:
        at = finger.mesh.nodes + moved
        points = [p.weights @ at[p.nodes] if len(p.nodes) else np.array(p.position) for p in finger.routing]
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    return length(np.zeros_like(displacement)) - length(displacement)


def our_closing(closing: ClosingPath, pulled_mm: float) -> ClosedFinger:
    """Return ours at a pulled length; nan where it does not converge."""
    shape = closing.shape(1e-3 * pulled_mm)
    moved = 1e3 * shape.vertices - closing.finger_mesh.mesh.nodes
    value = 1.0 if shape.converged else np.nan
    joints = value * joints_of(closing.finger_mesh, moved)
    return ClosedFinger(value * tip_of(closing.finger_mesh, moved), joints, value * shape.tension[0])


def calculix_closings() -> dict[tuple[str, str, float], ClosedFinger]:
    """Return (design, element type, pulled length [mm]) -> CalculiX' finger; nan where it does not converge."""
    with resources.as_file(resources.files("softgrip_model.gdfe") / "reference" / f"{NAME}.npz") as file:
        data = np.load(file)
        keys = zip(data["design"].tolist(), data["element"].tolist(), data["pulled_mm"].tolist(), strict=True)
        values = zip(data["tip_mm"], data["joint_rad"], data["tension_n"].tolist(), strict=True)
        return {key: ClosedFinger(*value) for key, value in zip(keys, values, strict=True)}


def save_closings(found: dict[tuple[str, str, float], ClosedFinger]) -> None:
    """Write what `calculix_closings` reads."""

    def column(values: Iterable[object]) -> NDArray[np.generic]:
        return np.array(list(values))

    with resources.as_file(resources.files("softgrip_model.gdfe") / "reference") as folder:
        np.savez_compressed(
            folder / f"{NAME}.npz",
            design=column(key[0] for key in found),
            element=column(key[1] for key in found),
            pulled_mm=column(key[2] for key in found),
            tip_mm=column(one.tip_mm for one in found.values()),
            joint_rad=column(one.joint_rad for one in found.values()),
            tension_n=column(one.tension_n for one in found.values()),
        )
