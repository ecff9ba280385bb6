# SPDX-License-Identifier: Apache-2.0
"""The shipped fingers closed by their tendons in CalculiX: makes the reference that docs/gdfe.md compares with.

`python tools/docs/gdfe_cable_calculix.py` needs `ccx` (apt-get install calculix-ccx) and some twenty minutes; it writes
softgrip_model/gdfe/reference/finger_cable_calculix.npz. Named designs (`... power pinch`) are renewed alone.
How CalculiX gets a cable: softgrip_model/softgrip_testing/calculix_cable.py.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.cable import RoutingPoint
from softgrip_model.gdfe.finger_mesh import FingerMesh
from softgrip_model.gdfe.materials import Ogden
from softgrip_testing.calculix_cable import (
    MATERIAL,
    ClosedFinger,
    calculix_closings,
    closing_of,
    joints_of,
    save_closings,
    shortening_of,
    tip_of,
)

Array = NDArray[np.float64]
DESIGNS = ("hook", "pinch", "power")
ELEMENTS = ("C3D8", "C3D8I")
PULLS_MM = (4.0, 8.0, 12.0, 16.0)
#: CalculiX is loaded up to this share of our tensions: its own at the same pulled length lies below.
FULL_SHARE = 1.15
TIME_LIMIT_S = 300
#: Longer than any stretch of the cable [mm].
ANY_LENGTH_MM = 1e3


def deck(
    finger: FingerMesh, tensions: Array, element: str, share: float = FULL_SHARE, material: Ogden = MATERIAL
) -> str:
    """Return the CalculiX input [mm, N, MPa]: from rest to a share of the cable's tensions (stretches,) [N]."""
    nodes, hexes = finger.mesh.nodes, finger.mesh.hexes
    points = [len(nodes) + 1 + p for p in range(len(finger.routing))]
    lines = ["*NODE,NSET=NALL", *(_node(i + 1, place) for i, place in enumerate(nodes))]
    lines += ["*NODE,NSET=NCABLE", *(_node(points[p], point.position) for p, point in enumerate(finger.routing))]
    lines.append(f"*ELEMENT,TYPE={element},ELSET=EALL")
    lines += [",".join(str(n) for n in (e + 1, *(corners + 1))) for e, corners in enumerate(hexes)]
    for p in range(len(tensions)):
        lines += [f"*ELEMENT,TYPE=SPRINGA,ELSET=STRETCH{p}", f"{len(hexes) + 1 + p},{points[p]},{points[p + 1]}"]
    for p, point in enumerate(finger.routing):
        lines += _tied(points[p], point)
    # neo-Hookean by name: given as Ogden's, by principal stretches, it stops CalculiX near rest
    lines += ["*MATERIAL,NAME=M", "*HYPERELASTIC,NEO HOOKE"]
    lines.append(f"{0.5 * material.shear_modulus:.9g},{2.0 / material.bulk_modulus:.9g}")
    lines.append("*SOLID SECTION,ELSET=EALL,MATERIAL=M")
    for p, tension in enumerate(tensions):
        lines.append(f"*SPRING,ELSET=STRETCH{p},NONLINEAR")
        # force, elongation, temperature: the force does not depend on the length, and grows with the temperature
        lines += [
            f"{f:.8e},{e:.1f},{t:.1f}"
            for t, f in ((0.0, 0.0), (1.0, share * tension))
            for e in (-ANY_LENGTH_MM, ANY_LENGTH_MM)
        ]
    lines += ["*INITIAL CONDITIONS,TYPE=TEMPERATURE", "NALL,0.", "NCABLE,0.", "*BOUNDARY"]
    held = [*(finger.clamped + 1), *(points[p] for p, point in enumerate(finger.routing) if not len(point.nodes))]
    lines += [f"{n},1,3" for n in held]
    lines += ["*STEP,NLGEOM,INC=1000", "*STATIC", "0.1,1.0,1e-5,0.1", "*TEMPERATURE", "NALL,1.", "NCABLE,1."]
    lines += ["*NODE PRINT,NSET=NALL", "U", "*END STEP"]
    return "\n".join([*lines, ""])


def _node(number: int, place: Array | tuple[float, float, float]) -> str:
    return f"{number},{place[0]:.10g},{place[1]:.10g},{place[2]:.10g}"


def _tied(number: int, point: RoutingPoint) -> list[str]:
    """Return the equations that keep a node at the point's weighted mean of the mesh's nodes."""
    lines = []
    for axis in (1, 2, 3) if len(point.nodes) else ():
        terms = [f"{number},{axis},-1."]
        terms += [f"{n + 1},{axis},{w:.12g}" for n, w in zip(point.nodes, point.weights, strict=True) if abs(w) > 1e-12]
        lines += ["*EQUATION", str(len(terms)), *(",".join(terms[i : i + 4]) for i in range(0, len(terms), 4))]
    return lines


def calculix(text: str, nodes: int, time_limit_s: float = TIME_LIMIT_S) -> list[tuple[float, Array]]:
    """Return share of the step and displacements (nodes, 3) of every increment that converged."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "job.inp").write_text(text, encoding="utf-8")
        environment = {**os.environ, "OMP_NUM_THREADS": "2"}
        with contextlib.suppress(subprocess.TimeoutExpired):  # what it printed by then counts
            subprocess.run(
                ["ccx", "job"], cwd=folder, env=environment, check=False, capture_output=True, timeout=time_limit_s
            )
        file = Path(folder, "job.dat")
        printed = file.read_text(encoding="utf-8") if file.exists() else ""
    found = []
    for block in re.split(r" displacements \(vx,vy,vz\) for set NALL", printed)[1:]:
        head, *rows = block.splitlines()
        values = [[float(v) for v in row.split()[1:]] for row in rows if len(row.split()) == 4]
        if len(values) == nodes:
            found.append((float(head.split()[-1]), np.array(values)))
    return found


def at_length(
    finger: FingerMesh, increments: list[tuple[float, Array]], pulled_mm: float, full_n: float
) -> ClosedFinger:
    """Return the finger at a pulled length, by a cubic through the increments next to it; nan beyond the last one."""
    pulls = np.array([0.0, *(shortening_of(finger, moved) for _, moved in increments)])
    rest = np.zeros((len(finger.mesh.nodes), 3))
    states = [(0.0, rest), *increments]
    rows = np.array([[*tip_of(finger, moved), *joints_of(finger, moved), share * full_n] for share, moved in states])
    if pulls[-1] < pulled_mm or len(states) < 4:
        rows = np.full_like(rows[0], np.nan)
    else:
        above = int(np.searchsorted(pulls, pulled_mm))
        near = slice(max(0, min(above - 2, len(states) - 4)), None)
        x, y = pulls[near][:4], rows[near][:4]
        rows = sum(y[i] * np.prod([(pulled_mm - x[j]) / (x[i] - x[j]) for j in range(4) if j != i]) for i in range(4))
    return ClosedFinger(rows[:2], rows[2:-1], float(rows[-1]))


def main() -> int:
    """Write the reference."""
    found = calculix_closings() if sys.argv[1:] else {}
    for design in sys.argv[1:] or DESIGNS:
        closing = closing_of(design)
        finger = closing.finger_mesh
        for pull in PULLS_MM:
            shape = closing.shape(1e-3 * pull)
            if not shape.converged:
                continue
            for element in ELEMENTS:
                # the first tension acts in front of the first point
                text = deck(finger, np.array(shape.tension[1:]), element)
                increments = calculix(text, len(finger.mesh.nodes))
                one = at_length(finger, increments, pull, FULL_SHARE * shape.tension[0])
                found[design, element, pull] = one
                reached = increments[-1][0] if increments else 0.0
                sys.stdout.write(f"{design} {element} {pull:g} mm: {one}, reached {FULL_SHARE * reached:.2f}\n")
                sys.stdout.flush()
                save_closings(found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
