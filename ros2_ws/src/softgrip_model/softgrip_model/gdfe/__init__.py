# SPDX-License-Identifier: Apache-2.0
"""GDFE: hyperelastic equilibria of hexahedral meshes with a matrix that never changes (docs/gdfe.md).

Start with `Solver(bar(...), [ninjaflex()], supports)`, or, for a finger, with
`softgrip_model.gdfe.closing.Closing(profile, "index").shape(0.01)`.
"""

from softgrip_model.gdfe.cable import Cable, Drive, RoutingPoint
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.materials import Linear, Material, Ogden, StressPolynomial
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.solver import (
    Equilibrium,
    Law,
    Method,
    Metric,
    Ordering,
    Settings,
    Solver,
    State,
    Supports,
    VolumeShape,
)
from softgrip_model.gdfe.surroundings import Acts, Contact, FollowerPatch, Obstacle, Shape, Surroundings

__all__ = [
    "Acts",
    "Cable",
    "Contact",
    "Drive",
    "Equilibrium",
    "FollowerPatch",
    "GdfeError",
    "Law",
    "Linear",
    "Material",
    "Mesh",
    "Method",
    "Metric",
    "Obstacle",
    "Ogden",
    "Ordering",
    "RoutingPoint",
    "Settings",
    "Shape",
    "Solver",
    "State",
    "StressPolynomial",
    "Supports",
    "Surroundings",
    "VolumeShape",
    "bar",
]
