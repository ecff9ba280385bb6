# SPDX-License-Identifier: Apache-2.0
"""Parts as files: STEP for CAD, STL and 3MF for the printer, the latter two as the part lies on the bed."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_description.solids import stl_of
from softgrip_design.parts.printing import MATERIALS, Filament
from softgrip_design.parts.solid import Solid, write_step

Array = NDArray[np.float64]

#: Middle of the bed whose shape stands in the settings.
BED_MIDDLE_MM = (125.0, 105.0)
#: Where PrusaSlicer and its descendants look for settings in a 3MF.
SETTINGS_PATH = "/Metadata/Slic3r_PE.config"
_RELATION = "http://schemas.openxmlformats.org/package/2006/relationships/meta-data"


def as_printed(solid: Solid) -> Array:
    """Return a part's vertices (n, 3) [mm] as it lies in the middle of the bed: its `up` is z, its lowest point 0."""
    up = np.array(solid.form.up)
    beside = np.eye(3)[int(np.argmin(np.abs(up)))]
    beside = beside - (beside @ up) * up
    beside /= np.linalg.norm(beside)
    placed = solid.vertices @ np.array([beside, np.cross(up, beside), up]).T
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    return np.asarray(placed - (middle[0] - BED_MIDDLE_MM[0], middle[1] - BED_MIDDLE_MM[1], placed[:, 2].min()))


def write_part(solid: Solid, folder: Path) -> list[Path]:
    """Write a part as STEP (in its own frame), STL and 3MF (as printed) and return the files.

    Raises:
        OSError: a file cannot be written.
    """
    paths = [folder / f"{solid.form.name}.{ending}" for ending in ("step", "stl", "3mf")]
    write_step(solid, paths[0])
    vertices = as_printed(solid)
    paths[1].write_bytes(stl_of(vertices[solid.triangles]))
    paths[2].write_bytes(three_mf(solid, vertices, MATERIALS[solid.form.material]))
    return paths


def settings_text(material: Filament) -> str:
    """Return print settings as PrusaSlicer keeps them in a 3MF: one comment line each, in the order of its keys."""
    rows = [f"; {key} = {value}" for key, value in sorted(material.settings.items())]
    return "\n".join(["; softgrip: layers along the cable, full TPU (docs/parts.md)", *rows, ""])


def three_mf(solid: Solid, vertices: Array, material: Filament) -> bytes:
    """Return a part as 3MF with material, orientation and print settings."""
    from lib3mf import Lib3MF  # noqa: PLC0415  an extra, comes with build123d

    wrapper = Lib3MF.Wrapper()
    model: Any = wrapper.CreateModel()
    model.SetUnit(Lib3MF.ModelUnit.MilliMeter)
    about = model.GetMetaDataGroup()
    for key, value in (("Title", solid.form.title), ("Application", "softgrip"), ("Description", material.title)):
        about.AddMetaData("", key, value, "xs:string", True)
    mesh = model.AddMeshObject()
    mesh.SetName(solid.form.name)
    mesh.SetGeometry(
        [Lib3MF.Position((ctypes.c_float * 3)(*vertex)) for vertex in vertices],
        [Lib3MF.Triangle((ctypes.c_uint32 * 3)(*triangle)) for triangle in solid.triangles],
    )
    group = model.AddBaseMaterialGroup()
    number = group.AddMaterial(material.title, wrapper.RGBAToColor(220, 170, 90, 255))
    mesh.SetObjectLevelProperty(group.GetResourceID(), number)
    model.AddBuildItem(mesh, wrapper.GetIdentityTransform())
    model.AddCustomContentType("config", "text/plain")
    settings = settings_text(material).encode()
    model.AddAttachment(SETTINGS_PATH, _RELATION).ReadFromBuffer(settings)
    return bytes(model.QueryWriter("3mf").WriteToBuffer())
