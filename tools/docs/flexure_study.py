# SPDX-License-Identifier: Apache-2.0
"""The finite-element study behind mode F: random fingers of hexahedra, and the constants fitted to some of them.

    python tools/docs/flexure_study.py              how far the kernel is from CalculiX
    python tools/docs/flexure_study.py calculix     CalculiX on every finger that the reference lacks; 15 s each
    python tools/docs/flexure_study.py mesh         the study's fingers by flexure_mesh.py; 2 s each
    python tools/docs/flexure_study.py check        how far that mesh is from CalculiX, at CalculiX' tensions
    python tools/docs/flexure_study.py fit          prints the constants that fit the study's fingers best

Needs `ccx` (apt-get install calculix-ccx) for the first. CalculiX' fingers are
finger/reference/flexure_calculix.npz, the study's finger/reference/flexure_study.npz; the constants stand in
softgrip_model/finger/flexure.py. No finger of CalculiX' has a part in the fit.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import gdfe_cable_calculix as cable
import numpy as np
from flexure_mesh import HalfFinger
from numpy.typing import NDArray
from scipy.optimize import least_squares

import softgrip_model.finger
from softgrip_model.finger import FRICTIONLESS, Control, Finger, FlexureStudy, JointModel, Kernel, Status
from softgrip_model.finger.flexure import FLEXURE_STUDY
from softgrip_model.friction.published import published
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, mesh_finger
from softgrip_model.gdfe.materials import Ogden
from softgrip_testing.calculix_cable import shortening_of, tip_of
from softgrip_testing.calculix_flexures import (
    FITTED_OTHER_SEEDS,
    FITTED_SEEDS,
    FRICTIONLESS_SEEDS,
    KNOWN_SEEDS,
    MODULUS_MPA,
    OTHER_SEEDS,
    UNSEEN_SEEDS,
    Closing,
    closings,
    finger_of,
    save_closings,
)

Array = NDArray[np.float64]
TIME_LIMIT_S = 3600.0
#: Unseen fingers are pulled this far, or by steps less until no groove is on its stop.
UNSEEN_PULL_MM, UNSEEN_STEP_MM = 16.0, 2.0
FRICTION = published("braid-tpu-chapter4").law
#: The fit takes states pulled by less, whose joints are this far from their stop.
FIT_PULL_MM, FIT_MARGIN_RAD = 19.0, 0.12
#: The study's fingers are pulled by so much, or less if a groove were on its stop.
MESH_PULL_MM = 19.0
MESH_SHARES = [0.15, 0.3, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0]
STUDY_FILE = Path(softgrip_model.finger.__file__).parent / "reference" / "flexure_study.npz"
#: As much as each other count 1 % of an angle (of this at least) and 0.25 % of the length in the tip.
ANGLE_RAD, ANGLE_SHARE, TIP_SHARE_PCT = 0.3, 0.01, 0.25
#: What the fit begins with.
START = FlexureStudy(1.0, 0.7, 1.0, 0.3, 1.0, 0.3, 0.3, 0.1, 0.2, 0.5)
#: A state that the kernel does not reach.
LOST = 20.0


def mesh_of(finger: Finger) -> FingerMesh:
    """Return the coarse mesh, on which docs/gdfe.md compares CalculiX, too."""
    return mesh_finger(finger, RESOLUTIONS["coarse"], finger.body_mm)


def increments_of(finger: Finger, mesh: FingerMesh, tensions_n: Array, share: float) -> list[tuple[float, Array]]:
    """Return CalculiX' increments from rest to a share of the tensions behind the first point [N]."""
    shear_mpa = MODULUS_MPA / (2.0 * (1.0 + finger.strip.poisson))
    material = Ogden("NinjaFlex at rest", (shear_mpa,), (2.0,), finger.strip.poisson)
    text = cable.deck(mesh, tensions_n, "C3D8I", share, material)
    return cable.calculix(text, len(mesh.mesh.nodes), TIME_LIMIT_S)


def study_closing(seed: int) -> Closing:
    """Close a finger without friction, from rest to beyond what mode P needs for 15 mm."""
    finger = finger_of(seed)
    mesh = mesh_of(finger)
    hinges = Kernel([finger.with_joint_model(JointModel.HINGE)], FRICTIONLESS)
    share = 1.1 if seed in OTHER_SEEDS else 1.15
    full_n = min(share * float(hinges.solve([15.0]).actuator_tension_n[0, 0]), 80.0)
    found = increments_of(finger, mesh, np.full(len(mesh.routing) - 1, full_n), 1.0)
    pulled = np.array([shortening_of(mesh, moved) for _, moved in found])
    tip = np.array([tip_of(mesh, moved) for _, moved in found]).reshape(-1, 2)
    return Closing(seed, False, np.array([full_n * s for s, _ in found]), pulled, tip)


def unseen_closing(seed: int) -> Closing:
    """Close a finger with friction; how the tension falls from point to point is what the kernel finds."""
    finger = finger_of(seed)
    mesh = mesh_of(finger)
    pull = UNSEEN_PULL_MM
    solution = Kernel([finger], FRICTION).solve([pull])
    while int(solution.status[0, 0]) & int(Status.STOP_ENGAGED | Status.FAILURE):
        pull -= UNSEEN_STEP_MM
        solution = Kernel([finger], FRICTION).solve([pull])
    tensions = solution.tension_n[0, 0]
    found = increments_of(finger, mesh, tensions[1:], cable.FULL_SHARE)
    one = cable.at_length(mesh, found, pull, cable.FULL_SHARE * float(tensions[0]))
    return Closing(seed, True, np.array([one.tension_n]), np.array([pull]), one.tip_mm[None, :])


def run_calculix() -> None:
    """Add what the reference lacks; what is there stays."""
    try:
        known = {one.seed: one for one in closings()}
    except FileNotFoundError:
        known = {}
    for seeds, close in (
        (UNSEEN_SEEDS, unseen_closing),
        (KNOWN_SEEDS, unseen_closing),
        (FRICTIONLESS_SEEDS, study_closing),
        (OTHER_SEEDS, study_closing),
    ):
        for seed in seeds:
            if seed in known:
                continue
            one = close(seed)
            if not (len(one.tension_n) and np.isfinite(one.tension_n).all()):
                sys.stdout.write(f"{seed}: CalculiX did not get there within {TIME_LIMIT_S:g} s\n")
                continue
            known[seed] = one
            save_closings(known.values())
            sys.stdout.write(f"{seed}: {one.pulled_mm[-1:]} mm, {one.tip_mm[-1:]} mm, {one.tension_n[-1:]} N\n")
            sys.stdout.flush()


def differences(one: Closing, study: FlexureStudy) -> tuple[Array, Array]:
    """Return tip differences (K, 2) as shares of the length and tension differences (K,) of a study's closing."""
    finger = dataclasses.replace(one.finger, study=study)
    solution = Kernel([finger], FRICTION if one.friction else FRICTIONLESS).solve(one.pulled_mm)
    used = solution.angle_rad[0].max(axis=1) < min(finger.opening_rad) - FIT_MARGIN_RAD
    used &= (one.pulled_mm < FIT_PULL_MM) & ~solution.failed[0]
    tip = (solution.tip_mm[0] - one.tip_mm) / finger.length_from_joint_mm
    return tip[used], (solution.tension_n[0, :, 0] / one.tension_n - 1.0)[used]


def middle_nodes(half: HalfFinger, link: int) -> NDArray[np.int_]:
    """Nodes of the cross-section in the middle of a link."""
    columns = half.mesh.link_nodes[link].reshape(RESOLUTIONS["coarse"].link_along + 1, -1)
    middle = half.number[columns[len(columns) // 2]]
    return middle[middle >= 0]


def mesh_closing(seed: int) -> Array:
    """Close a finger without friction up to what the kernel says is needed; rows as of `mesh_states`."""
    finger = finger_of(seed)
    pull = MESH_PULL_MM
    solution = Kernel([finger], FRICTIONLESS).solve([pull])
    while int(solution.status[0, 0]) & int(Status.STOP_ENGAGED | Status.FAILURE):
        pull -= 1.0
        solution = Kernel([finger], FRICTIONLESS).solve([pull])
    return mesh_states(finger, float(solution.tension_n[0, 0, 0]))


def mesh_states(finger: Finger, full_n: float) -> Array:
    """Return rows of tension, pulled length, tip and joint angles (from middle to middle of links), up to a tension."""
    mesh = mesh_of(finger)
    half = HalfFinger(finger, mesh, MODULUS_MPA)
    middles = [middle_nodes(half, link) for link in range(finger.joints)]
    rows = []
    for share, moved in half.closing(np.full(len(mesh.routing) - 1, full_n), MESH_SHARES):
        angles = np.diff(np.unwrap([0.0, *(half.turned(nodes, moved) for nodes in middles)]))
        rows.append([share * full_n, half.shortening(moved), *half.tip(moved), *angles])
    return np.array(rows)


def mesh_beside_calculix(one: Closing) -> tuple[float, float]:
    """Return by how much pulled lengths and tips [mm] of the mesh differ from CalculiX at its tensions, at most."""
    mesh = mesh_of(one.finger)
    half = HalfFinger(one.finger, mesh, MODULUS_MPA)
    used = one.pulled_mm < FIT_PULL_MM
    full_n = float(one.tension_n[used][-1])
    states = half.closing(np.full(len(mesh.routing) - 1, full_n), (one.tension_n[used] / full_n).tolist())
    pulled_mm = np.array([half.shortening(moved) for _, moved in states])
    tip_mm = np.array([half.tip(moved) for _, moved in states])
    apart = np.linalg.norm(tip_mm - one.tip_mm[used], axis=1)
    return float(np.abs(pulled_mm - one.pulled_mm[used]).max()), float(apart.max())


def run_check() -> None:
    """Print how far the mesh is from CalculiX, for every finger that CalculiX closed without friction."""
    for one in closings():
        if not one.friction:
            sys.stdout.write(
                "{}: pulled length {:.3f} mm, tip {:.3f} mm\n".format(one.seed, *mesh_beside_calculix(one))
            )
            sys.stdout.flush()


def run_mesh() -> None:
    """Write the study's fingers."""
    found = {}
    for seed in (*FITTED_SEEDS, *FITTED_OTHER_SEEDS):
        found[str(seed)] = mesh_closing(seed)
        sys.stdout.write(f"{seed}: {found[str(seed)][-1]}\n")
        sys.stdout.flush()
    np.savez_compressed(STUDY_FILE, **found)


def mesh_differences(seed: int, states: Array, study: FlexureStudy) -> Array:
    """Return what the kernel is off at the same tensions: angles, pulled length and tip, in tolerances."""
    finger = dataclasses.replace(finger_of(seed), study=study)
    used = states[:, 4:].max(axis=1) < min(finger.opening_rad) - FIT_MARGIN_RAD
    states = states[used]
    solution = Kernel([finger], FRICTIONLESS).solve(states[:, 0], Control.TENSION, march=False)
    angle = (solution.angle_rad[0] - states[:, 4:]) / np.maximum(states[:, 4:], ANGLE_RAD) / ANGLE_SHARE
    # at the same pulled length the tip is what counts
    by_pull = Kernel([finger], FRICTIONLESS).solve(states[:, 1], march=False)
    tip = 100.0 * (by_pull.tip_mm[0] - states[:, 2:4]) / finger.length_from_joint_mm / TIP_SHARE_PCT
    return np.nan_to_num(np.concatenate([angle.ravel(), tip.ravel()]), nan=LOST)


def fit() -> FlexureStudy:
    """Return the constants that fit the study's fingers best."""
    study = {int(seed): states for seed, states in np.load(STUDY_FILE).items()}

    def residuals(constants: Array) -> Array:
        found = np.concatenate([mesh_differences(*one, FlexureStudy(*constants)) for one in study.items()])
        # what counts is the largest: the sum of fourth powers is near it
        return np.asarray(found * np.abs(found))

    found = least_squares(residuals, START.constants, x_scale=0.1, diff_step=1e-4)
    return FlexureStudy(*found.x.tolist())


def report(study: FlexureStudy) -> None:
    """Print how far the kernel is from CalculiX."""
    groups: dict[str, Sequence[int]] = {
        "CalculiX, thesis' bounds": FRICTIONLESS_SEEDS,
        "others": OTHER_SEEDS,
        "known": KNOWN_SEEDS,
        "unseen": UNSEEN_SEEDS,
    }
    for name, seeds in groups.items():
        parts = [differences(one, study) for one in closings() if one.seed in seeds]
        tip = np.array([np.linalg.norm(t, axis=1).max() for t, _ in parts if len(t)])
        tension = np.array([np.abs(n).max() for t, n in parts if len(t)])
        if not len(tip):
            continue
        sys.stdout.write(
            f"{name}: {len(tip)} fingers, largest tip difference {100 * tip.mean():.2f} % in the mean, at most "
            f"{100 * tip.max():.2f} %; of the tension at most {100 * tension.max():.1f} %\n"
        )


def main() -> int:
    """Run what is asked for."""
    if sys.argv[1:] == ["calculix"]:
        run_calculix()
    elif sys.argv[1:] == ["mesh"]:
        run_mesh()
    elif sys.argv[1:] == ["check"]:
        run_check()
    elif not sys.argv[1:]:
        report(FLEXURE_STUDY)
    elif sys.argv[1:] == ["fit"]:
        study = fit()
        sys.stdout.write(f"{study}\n")
        report(study)
    else:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
