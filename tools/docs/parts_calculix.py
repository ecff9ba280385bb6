# SPDX-License-Identifier: Apache-2.0
"""The index finger of the power grasp as a solid, closed in GDFE and in CalculiX: the table of docs/parts.md.

Needs gmsh and ccx on the PATH (apt-get install gmsh calculix-ccx), build123d (make parts-setup) and some minutes. The
solid is the printed one without cable channels, marker seats and text, so that CalculiX' C3D10 are few: neo-Hookean,
cable as in softgrip_testing.calculix_cable. Both programs have the same tetrahedra: quadratic ones there, each cut into
four hexahedra here. A finer mesh in GDFE, the profile's own and the predictor's finger of the same modulus are beside.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from gdfe_cable_calculix import FULL_SHARE, at_length, calculix, deck
from numpy.typing import NDArray

from softgrip_description.hand import shipped_hand
from softgrip_design.parts.files import write_part
from softgrip_design.parts.finger_form import finger_form
from softgrip_design.parts.palm import palm_seat
from softgrip_design.parts.solid import make_solid
from softgrip_model.finger import Finger, MomentLaw, Solution, Strip, close
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, mesh_finger
from softgrip_model.gdfe.solid_mesh import ElementSize, SolidFinger, cut_into_hexahedra, mesh_solid, tetrahedra_of
from softgrip_model.profile import Profile, load, shipped_directory
from softgrip_testing.calculix_cable import MATERIAL, ClosedFinger, our_closing
from softgrip_testing.calculix_flexures import MODULUS_MPA

Array = NDArray[np.float64]
Index = NDArray[np.int32]
PULLS_MM = (4.0, 8.0, 12.0)
#: A strip has two layers of tetrahedra.
COARSE = ElementSize(4.0, 1.2, 4)
TIME_LIMIT_S = 2400.0
#: Abaqus' order of the middles of a tetrahedron's edges.
EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))


def plain_step(folder: Path) -> Path:
    """Write the STEP file of the finger without bores and pockets."""
    profile, hand = load(shipped_directory() / "power.yaml"), shipped_hand()
    form = finger_form(profile.finger("index"), 1e3 * profile.cable.radius_m, "index", palm_seat(hand, "index"), "")
    write_part(make_solid(dataclasses.replace(form.form, bores=(), pockets=())), folder)
    return folder / "finger_index.step"


def quadratic(solid: SolidFinger, nodes: Array, tetrahedra: Index) -> Any:
    """Return the finger of quadratic tetrahedra, as `deck` takes a mesh."""
    assert all(pair in combinations(range(4), 2) for pair in EDGES)
    tetrahedra = tetrahedra[~(solid.side_of(nodes, 0) < 0.0)[tetrahedra].all(axis=1)]
    flipped = np.linalg.det(nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]) < 0.0
    tetrahedra[flipped] = tetrahedra[flipped][:, [0, 2, 1, 3]]
    edges, edge_of = np.unique(np.sort(tetrahedra[:, EDGES], axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    cells = np.hstack([tetrahedra, edge_of.reshape(-1, 6) + len(nodes)])
    nodes = np.concatenate([nodes, nodes[edges].mean(axis=1)])
    used, renumbered = np.unique(cells, return_inverse=True)
    nodes = nodes[used]
    return SimpleNamespace(
        mesh=SimpleNamespace(nodes=nodes, hexes=renumbered.reshape(-1, 10)),
        clamped=solid.clamped(nodes),
        routing=solid.routing(nodes),
        tip=solid.tip(nodes),
        link_nodes=solid.links(nodes),
    )


def closing_of(mesh: FingerMesh, spacing_mm: float) -> ClosingPath:
    """Return our closing of a mesh of the finger."""
    profile = load(shipped_directory() / "power.yaml")
    settings = ClosingSettings(travel_mm=max(PULLS_MM), keyframe_mm=spacing_mm, max_iterations=2000)
    body = Body(profile, "index", settings.resolution, material=MATERIAL, finger_mesh=mesh)
    return ClosingPath(profile, "index", settings, body=body)


def predicted(finger: Finger, profile: Profile) -> Solution:
    """Return the predictor's finger (mode F) at the pulls, its strips of the neo-Hookean material's modulus."""
    same = dataclasses.replace(finger, strip=Strip((0.0, 0.0, MODULUS_MPA), MomentLaw.LINEAR))
    return close(same, assumed_friction(profile).law, np.array(PULLS_MM))


def show(name: str, pull_mm: float, one: ClosedFinger) -> None:
    """Print a row of the table."""
    say(f"{pull_mm:g} mm, {name}: tip {one.tip_mm.round(2)} mm, {one.tension_n:.3f} N")


def say(text: str) -> None:
    """Print at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> int:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    profile = load(shipped_directory() / "power.yaml")
    finger = Finger.from_profile(profile, "index")
    depth_mm = 1e3 * profile.finger("index").body_height_m
    with tempfile.TemporaryDirectory() as folder:
        step = plain_step(Path(folder))
        nodes, tetrahedra = tetrahedra_of(step, COARSE)
        nodes = nodes + np.array([finger.base_mm, 0.0, 0.0])
        printed = SolidFinger(finger, step)
        theirs = quadratic(printed, nodes, tetrahedra)
        say(f"CalculiX: {len(theirs.mesh.hexes)} C3D10, {len(theirs.mesh.nodes)} nodes")
        solid = closing_of(printed.cut(*cut_into_hexahedra(nodes, tetrahedra)), 2.0)
        finer = closing_of(mesh_solid(step, finger), 2.0)
        own = closing_of(mesh_finger(finger, RESOLUTIONS["fine"], depth_mm, strip_below=0.0), 1.0)
        meshes = {"solid": solid, "solid, finer": finer, "profile's mesh": own}
        for name, closing in meshes.items():
            say(f"GDFE, {name}: {closing.hexahedra} hexahedra")
            for pull in PULLS_MM:
                show(name, pull, our_closing(closing, pull))
        predictor = predicted(finger, profile)
        for k, pull in enumerate(PULLS_MM):
            show("predictor", pull, ClosedFinger(predictor.tip_mm[0, k], np.zeros(0), predictor.tension_n[0, k, 0]))
        last = solid.shape(1e-3 * PULLS_MM[-1])
        full_n = FULL_SHARE * last.tension[0]
        increments = calculix(deck(theirs, np.array(last.tension[1:]), "C3D10"), len(theirs.mesh.nodes), TIME_LIMIT_S)
        for pull in PULLS_MM:
            show("CalculiX", pull, at_length(theirs, increments, pull, full_n))
    return 0


if __name__ == "__main__":
    sys.exit(main())
