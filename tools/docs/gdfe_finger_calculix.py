# SPDX-License-Identifier: Apache-2.0
"""The strips of the power finger in CalculiX: makes the reference that docs/gdfe.md compares with.

Base and links are led along our closing, the strips between them are free: C3D8I on the same mesh, Hooke's law. Needs
`ccx` (apt-get install calculix-ccx) and two minutes. Writes softgrip_model/gdfe/reference/finger_strips_C3D8I_nu30.npz.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.finger_mesh import FingerMesh
from softgrip_testing.calculix_finger import (
    MATERIAL,
    NAME,
    STEPS_MM,
    led_nodes,
    our_moments,
    reference_closing,
    strip_moments,
)

Array = NDArray[np.float64]


def deck(finger: FingerMesh, moved: Sequence[Array]) -> str:
    """Return the CalculiX input [mm, N, MPa]: one step for each displacement (n, 3) of base and links."""
    lines = ["*NODE,NSET=NALL"]
    lines += [f"{i + 1},{x:.10g},{y:.10g},{z:.10g}" for i, (x, y, z) in enumerate(finger.mesh.nodes)]
    lines.append("*ELEMENT,TYPE=C3D8I,ELSET=EALL")
    lines += [",".join(str(n) for n in (e + 1, *(corners + 1))) for e, corners in enumerate(finger.mesh.hexes)]
    lines += ["*MATERIAL,NAME=M", "*ELASTIC", f"{MATERIAL.modulus:.9g},{MATERIAL.poisson:.9g}"]
    lines.append("*SOLID SECTION,ELSET=EALL,MATERIAL=M")
    led = led_nodes(finger)
    for displacement in moved:
        lines += ["*STEP,NLGEOM,INC=1000", "*STATIC", "0.5,1.0,1e-6,1.0", "*BOUNDARY"]
        lines += [f"{n + 1},{a + 1},{a + 1},{displacement[n, a]:.10g}" for n in led for a in range(3)]
        lines += ["*NODE PRINT,NSET=NALL,FREQUENCY=100000", "RF", "*END STEP"]
    return "\n".join([*lines, ""])


def calculix(text: str, nodes: int) -> list[Array]:
    """Return the forces (nodes, 3) that hold the nodes at the end of every step."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "job.inp").write_text(text, encoding="utf-8")
        environment = {**os.environ, "OMP_NUM_THREADS": "2"}
        subprocess.run(["ccx", "job"], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        printed = Path(folder, "job.dat").read_text(encoding="utf-8").split("forces")[1:]
    rows = [[line.split() for line in block.splitlines()[1:] if len(line.split()) == 4] for block in printed]
    return [np.array([[float(v) for v in row[1:]] for row in block]) for block in rows if len(block) == nodes]


def main() -> int:
    """Write the reference."""
    closing = reference_closing()
    finger = closing.finger_mesh
    moved = [1e3 * closing.shape(1e-3 * pull).vertices - finger.mesh.nodes for pull in STEPS_MM]
    forces = calculix(deck(finger, moved), len(finger.mesh.nodes))
    moments = np.array([strip_moments(finger, d, f) for d, f in zip(moved, forces, strict=True)])
    for pull, theirs in zip(STEPS_MM, moments, strict=True):
        sys.stdout.write(f"{pull:g} mm: CalculiX {theirs.round(3)} N mm, ours {our_moments(closing, pull).round(3)}\n")
    with resources.as_file(resources.files("softgrip_model.gdfe") / "reference") as folder:
        np.savez_compressed(folder / f"{NAME}.npz", pulled_mm=np.array(STEPS_MM), moment_nmm=moments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
