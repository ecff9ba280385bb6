# SPDX-License-Identifier: Apache-2.0
"""The three shipped fingers moved on to where the mesh closes as the thesis' rigid hinges do, and checked in CalculiX.

`python tools/docs/gdfe_redesign.py [DESIGN...]` needs `ccx` and some ten minutes; it prints the table of docs/gdfe.md.
The target is what the published design does by the kernel with rigid hinges (mode P), from rest to 14 mm pulled: what
its author meant. E_T (Eq 4.4) of the published design, and of the one that `FollowOnMesh` finds, in our mesh and in
CalculiX: same 432 hexahedra, neo-Hookean, tensions from stretch to stretch as our friction law found them.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from gdfe_cable_calculix import calculix, deck
from numpy.typing import NDArray

from softgrip_design.hand import ROUTING_BOUNDS_MM, THICKNESS_BOUNDS_MM
from softgrip_design.mesh_objective import SETTINGS, FollowOnMesh
from softgrip_design.objective import Weights
from softgrip_design.target import DesignTarget
from softgrip_model.finger import Control, Finger, JointModel, Kernel
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.calculix_cable import MATERIAL, joints_of

Array = NDArray[np.float64]

DESIGNS = ("hook", "pinch", "power")
ELEMENTS = ("C3D8", "C3D8I")
PULLED_MM, STEPS = 14.0, 50
#: Of our tension when fully closed, so that CalculiX' softer C3D8I closes as far.
SHARE = 1.3
COARSE = replace(SETTINGS, resolution=RESOLUTIONS["coarse"])


def target_of(finger: Finger, friction: FrictionLaw) -> DesignTarget:
    """Return the joint angles of the design by rigid hinges."""
    kernel = Kernel([finger.with_joint_model(JointModel.HINGE)], friction)
    pulled = np.linspace(PULLED_MM / STEPS, PULLED_MM, STEPS)
    angles = kernel.solve(pulled, Control.PULLED_LENGTH, threads=1).angle_rad[0]
    return DesignTarget(angles.sum(axis=1), angles)


def calculix_error_deg(objective: FollowOnMesh, x: Array, element: str) -> float:
    """Return E_T of a design in CalculiX [deg], at the target's deflections; NaN where it stops before."""
    meshed = objective.meshed(x)
    tensions = np.array(meshed.close(_pulled_mm(objective, x)).tension[0])[1:]
    found = calculix(deck(meshed.mesh, tensions, element, SHARE), len(meshed.mesh.mesh.nodes))
    joints = np.array([np.zeros(meshed.finger.joints), *(joints_of(meshed.mesh, moved) for _, moved in found)])
    deflection = joints.sum(axis=1)
    deflections = objective.target.deflection_rad
    if deflection[-1] < deflections[-1]:
        return float("nan")
    angles = np.stack([np.interp(deflections, deflection, joint) for joint in joints.T], axis=1)
    return float(np.sqrt(np.mean(np.degrees(angles - objective.target.angle_rad) ** 2)))


def _pulled_mm(objective: FollowOnMesh, x: Array) -> float:
    return objective.closing(x).pulled_mm[-1]


def main() -> int:
    """Print the table."""
    print("| design | E_T by | published [deg] | moved on [deg] | h, r [mm] |\n|---|---|---|---|---|")
    for design in sys.argv[1:] or DESIGNS:
        profile = load_directory(shipped_directory())[design]
        finger, law = Finger.from_profile(profile, "index"), assumed_friction(profile).law
        n = finger.joints
        bounds = zip(THICKNESS_BOUNDS_MM, ROUTING_BOUNDS_MM, strict=True)
        lower, upper = (np.repeat(ends, [n, 2 * n]) for ends in bounds)
        published = np.array([*finger.thickness_mm, *finger.routing_mm])
        objective = FollowOnMesh(finger, law, target_of(finger, law), Weights(1.0, 0.0), lower, upper, COARSE, MATERIAL)
        moved = objective.improve(published)
        numbers = " ".join(f"{value:.2f}" for value in moved)
        print(
            f"| {design} | mesh | {objective.error_deg(published):.2f} | {objective.error_deg(moved):.2f} | {numbers} |"
        )
        for element in ELEMENTS:
            errors = (calculix_error_deg(objective, x, element) for x in (published, moved))
            print(f"| | {element} | {' | '.join(f'{error:.2f}' for error in errors)} | |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
