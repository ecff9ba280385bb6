# SPDX-License-Identifier: Apache-2.0
"""GDFE: hyperelastic equilibria of hexahedral meshes with a matrix that never changes (docs/gdfe.md).

Start with `Solver(bar(...), [ninjaflex()], supports)`, or, for a finger, with
`softgrip_model.gdfe.closing.ClosingPath(profile, "index").shape(0.01)`.
"""

from softgrip_model.gdfe.cable import CableDrive, RoutedCable, RoutingPoint
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.materials import Linear, Ogden, SolidMaterial, StressPolynomial, VolumeShape
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.solver import (
    ConstitutiveLaw,
    Equilibrium,
    Method,
    Metric,
    Ordering,
    Solver,
    SolverSettings,
    State,
    Supports,
)
from softgrip_model.gdfe.surroundings import Acts, Contact, FollowerPatch, Obstacle, ObstacleShape, Surroundings

__all__ = [
    "Acts",
    "CableDrive",
    "ConstitutiveLaw",
    "Contact",
    "Equilibrium",
    "FollowerPatch",
    "GdfeError",
    "Linear",
    "Mesh",
    "Method",
    "Metric",
    "Obstacle",
    "ObstacleShape",
    "Ogden",
    "Ordering",
    "RoutedCable",
    "RoutingPoint",
    "SolidMaterial",
    "Solver",
    "SolverSettings",
    "State",
    "StressPolynomial",
    "Supports",
    "Surroundings",
    "VolumeShape",
    "bar",
]
