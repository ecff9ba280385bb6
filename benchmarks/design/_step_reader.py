# SPDX-License-Identifier: Apache-2.0
"""Measure STEP files with gmsh: `python _step_reader.py FILE...` prints planes, cylinders and size of each as JSON.

A program of its own: gmsh brings its own Open CASCADE, which must not meet build123d's in one process, and may live in
another environment.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import gmsh


def surfaces(path: str) -> dict[str, Any]:
    """Return what a file's surfaces are, as gmsh finds them [mm].

    Returns:
        ``box``: six numbers; ``planes``: normal, a point, bounding box and area; ``cylinders``: two points of the axis
        and the radius.
    """
    gmsh.clear()
    gmsh.open(path)
    found: dict[str, Any] = {"box": gmsh.model.getBoundingBox(-1, -1), "planes": [], "cylinders": []}
    for dimension, tag in gmsh.model.getEntities(2):
        kind = gmsh.model.getType(dimension, tag)
        low, high = gmsh.model.getParametrizationBounds(dimension, tag)
        middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        if kind == "Plane":
            found["planes"].append({
                "normal": list(gmsh.model.getNormal(tag, middle)),
                "point": list(gmsh.model.getValue(dimension, tag, middle)),
                "box": gmsh.model.getBoundingBox(dimension, tag),
                "area": gmsh.model.occ.getMass(dimension, tag),
            })  # fmt: skip
        elif kind == "Cylinder":
            found["cylinders"].append(_cylinder(dimension, tag, high[1] - low[1], low[1]))
    return found


def _cylinder(dimension: int, tag: int, length: float, start: float) -> dict[str, Any]:
    """Return axis and radius from three points around the start and one of the end."""
    half_turn = 3.141592653589793
    first, opposite, along = (
        list(gmsh.model.getValue(dimension, tag, at))
        for at in ((0.0, start), (half_turn, start), (0.0, start + length))
    )
    centre = [0.5 * (a + b) for a, b in zip(first, opposite, strict=True)]
    end = [c + b - a for c, a, b in zip(centre, first, along, strict=True)]
    radius = 0.5 * sum((a - b) ** 2 for a, b in zip(first, opposite, strict=True)) ** 0.5
    return {"start": centre, "end": end, "radius": radius}


if __name__ == "__main__":
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    print(json.dumps([surfaces(path) for path in sys.argv[1:]]))
