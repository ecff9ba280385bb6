# SPDX-License-Identifier: Apache-2.0
"""GDFE: hyperelastic equilibria of hexahedral meshes with a matrix that never changes (docs/gdfe.md).

Start with `Solver(bar(...), [ninjaflex()], supports)`, or with `Closing(profile, "index").shape(0.01)` for a finger.
"""

from softgrip_model.gdfe.closing import Closing, ClosingSettings, Shape
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, Resolution, mesh_finger
from softgrip_model.gdfe.materials import Linear, Material, Ogden, StressPolynomial
from softgrip_model.gdfe.mesh import Mesh, bar
from softgrip_model.gdfe.solver import Cable, Drive, Equilibrium, Law, Settings, Solver, State, Supports, VolumeShape

__all__ = [
    "RESOLUTIONS",
    "Cable",
    "Closing",
    "ClosingSettings",
    "Drive",
    "Equilibrium",
    "FingerMesh",
    "GdfeError",
    "Law",
    "Linear",
    "Material",
    "Mesh",
    "Ogden",
    "Resolution",
    "Settings",
    "Shape",
    "Solver",
    "State",
    "StressPolynomial",
    "Supports",
    "VolumeShape",
    "bar",
    "mesh_finger",
]
