# SPDX-License-Identifier: Apache-2.0
"""The three bars of thesis section 5.4 with CalculiX' answers: what tests, commands and benchmarks share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.march import Loading
from softgrip_model.gdfe.materials import Linear, SolidMaterial, cheetah_ogden, ninjaflex_ogden
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.solver import Supports

Array = NDArray[np.float64]
Index = NDArray[np.int32]

#: Young's moduli of the five-material bar, from the left [kPa].
FIVE_MODULI = (100.0, 80.0, 60.0, 40.0, 20.0)


@dataclass(frozen=True, eq=False)
class BarCase:
    """One bar.

    Attributes:
        mesh: in the deck's unit of length.
        left, right: nodes of the end faces.
        supports: what is held.
        loading: what acts at a share of the load.
        first_guess: displacement at full load to start from, or None.
        deck: name of the CalculiX deck.
    """

    mesh: Mesh
    left: Index
    right: Index
    supports: Supports
    loading: Callable[[float], Loading]
    first_guess: Array | None
    deck: str

    def reference(self) -> Array:
        """Return CalculiX' displacements, (n, 3)."""
        return reference_displacements(self.deck)


def reference_displacements(deck: str) -> Array:
    """Return the displacements (n, 3) that a shipped deck ends with."""
    path = resources.files("softgrip_model.gdfe") / "reference" / "displacements.npz"
    with resources.as_file(path) as file, np.load(file) as data:
        return np.asarray(data[deck], dtype=np.float64)


def _ends(mesh: Mesh) -> tuple[Index, Index]:
    x = mesh.nodes[:, 0]
    return mesh.nodes_where(x < x.min() + 1e-9), mesh.nodes_where(x > x.max() - 1e-9)


def five_materials(poisson: float = 0.3) -> tuple[BarCase, list[SolidMaterial]]:
    """Return the bar of section 5.4.1 [cm, kPa] and its materials: right face lifted by 10 cm, level, free along x."""
    mesh = bar((50.0, 5.0, 5.0), (50, 5, 5), 5)
    left, right = _ends(mesh)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right, "yz").with_tied(right, "x")

    def loading(share: float) -> Loading:
        prescribed = np.zeros_like(mesh.nodes)
        prescribed[right, 1] = share * 10.0
        return Loading(prescribed)

    materials: list[SolidMaterial] = [Linear(f"{e:g} kPa", e, poisson) for e in FIVE_MODULI]
    deck = f"bend_C3D8I_nu{round(100 * poisson)}_u10"
    return BarCase(mesh, left, right, supports, loading, None, deck), materials


def rotation(angle: float = np.pi / 2, poisson: float = 0.45) -> tuple[BarCase, list[SolidMaterial]]:
    """Return the bar of section 5.4.2 [cm, MPa]: right face turned about the bar's axis [rad]."""
    mesh = bar((20.0, 5.0, 5.0), (20, 5, 5), 2)
    left, right = _ends(mesh)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)
    y, z = mesh.nodes[right, 1], mesh.nodes[right, 2]

    def loading(share: float) -> Loading:
        prescribed = np.zeros_like(mesh.nodes)
        c, s = np.cos(share * angle), np.sin(share * angle)
        prescribed[right, 1] = c * y - s * z - y
        prescribed[right, 2] = s * y + c * z - z
        return Loading(prescribed)

    materials: list[SolidMaterial] = [cheetah_ogden(poisson), ninjaflex_ogden(poisson)]
    return BarCase(mesh, left, right, supports, loading, None, "rot_C3D8I_nu49"), materials


def tension(
    elongation: float = 1.0, materials: tuple[SolidMaterial, ...] = (), poisson: float = 0.45
) -> tuple[BarCase, list[SolidMaterial]]:
    """Return the bar of section 5.4.3 [mm, MPa]: both ends clamped, drawn out by a share of its length."""
    mesh = bar((40.0, 10.0, 10.0), (20, 5, 5), 2)
    left, right = _ends(mesh)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)

    def loading(share: float) -> Loading:
        prescribed = np.zeros_like(mesh.nodes)
        prescribed[right, 0] = 40.0 * share * elongation
        return Loading(prescribed)

    # stretched alike everywhere: the first increment starts from there
    guess = elongation * mesh.nodes * [1.0, -0.4, -0.4]
    guess[right, 1:] = guess[left, 1:] = 0.0
    chosen = list(materials) or [cheetah_ogden(poisson), ninjaflex_ogden(poisson)]
    return BarCase(mesh, left, right, supports, loading, guess, "tens_hyp_C3D8R_nu49"), chosen


def joint_position(case: BarCase, displacement: Array) -> float:
    """Return where the materials' joint of the tension bar lies, as a share of the drawn bar's length."""
    nodes = case.mesh.nodes
    at_joint = np.abs(nodes[:, 0] - 0.5 * nodes[:, 0].max()) < 1e-9
    moved = nodes[:, 0] + displacement[:, 0]
    return float(moved[at_joint].mean() / moved[case.right].mean())


def difference(displacement: Array, reference: Array) -> tuple[float, float]:
    """Return mean and largest distance between two displacements, as shares of the reference's largest."""
    distance = np.linalg.norm(displacement - reference, axis=1)
    largest = np.linalg.norm(reference, axis=1).max()
    return float(distance.mean() / largest), float(distance.max() / largest)
