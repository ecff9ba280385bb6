# SPDX-License-Identifier: Apache-2.0
"""One finger without friction, closed by all that can close it: plant, kernel (hinges and flexures) and MuJoCo.

The index finger of every shipped set, its strips of one constant modulus (the material's at rest), no gravity, the same
pulled lengths. Each program has its own mechanics of a strip: the kernel's flexures were fitted to finite elements, the
plant has geometrically exact beams, MuJoCo moves the exported hand's springs. The kernel's hinges are the same
mechanics as the MJCF with hinges; no strip is one.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from softgrip_description import shipped_hand
from softgrip_description.mjcf import mjcf_of
from softgrip_emulator.plant.fingers import FingerBank
from softgrip_emulator.plant.truth import FingerTruth
from softgrip_model.finger import FRICTIONLESS, Finger, JointModel, Kernel, MomentLaw, Strip
from softgrip_model.profile import Material, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.ideal_finger import ideal_finger

Array = NDArray[np.float64]

SLOT = "index"
#: As far as no groove of a shipped index finger closes on its stop.
PULLED_MM = np.array([2.0, 4.0, 6.0, 8.0, 10.0, 12.0])
#: The plant goes from one length to the next in so many steps of 1 ms, and rests for so many.
MOVING, RESTING = 300, 200
#: MuJoCo's hand has come to rest when no joint is faster [rad/s]; at the latest after so many steps.
REST_RAD_S, MAX_STEPS = 1e-6, 20_000
#: A tension is tried until the pulled length is right to this share, at most so often.
SAME_LENGTH, MAX_TRIES = 1e-4, 8


def linear_finger(name: str) -> tuple[Finger, Material]:
    """Return the index finger of a set with strips of a constant modulus, and that material."""
    profile = load_directory(shipped_directory())[name]
    material = replace(profile.material, modulus_quadratic_pa=0.0, modulus_linear_pa=0.0)
    strip = Strip((0.0, 0.0, 1e-6 * material.modulus_constant_pa), MomentLaw.LINEAR)
    return replace(Finger.from_profile(profile, SLOT), strip=strip), material


def by_kernel(finger: Finger, model: JointModel) -> tuple[Array, Array]:
    """Return tips (K, 2) [mm] and tensions (K,) [N]."""
    solution = Kernel([finger.with_joint_model(model)], FRICTIONLESS).solve(PULLED_MM, threads=1)
    return solution.tip_mm[0], solution.tension_n[0, :, 0]


def by_mujoco(name: str, material: Material, joint_model: JointModel, finger: Finger) -> tuple[Array, Array]:
    """Return tips (K, 2) [mm] and tensions (K,) [N] of the exported hand at rest at the pulled lengths."""
    profile = load_directory(shipped_directory())[name]
    fingers = {SLOT: (profile.id, profile.finger(SLOT))}
    model = mujoco.MjModel.from_xml_string(mjcf_of(shipped_hand(), fingers, material, joint_model=joint_model))
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    cable = data.tendon(f"{SLOT}_tendon")
    slack_m, tip_m = float(cable.length[0]), data.site(f"{SLOT}_tip").xpos.copy()
    base = data.body(f"{SLOT}_base").xmat.reshape(3, 3).copy()
    tips, tensions = [], []
    tension_n = 1.0
    for pulled_mm in PULLED_MM:
        for _ in range(MAX_TRIES):
            data.ctrl[0] = tension_n
            settle(model, data)
            taken_mm = 1e3 * (slack_m - float(cable.length[0]))
            if abs(taken_mm / pulled_mm - 1.0) < SAME_LENGTH:
                break
            tension_n *= pulled_mm / taken_mm
        straight_mm = np.array([sum(finger.link_mm), 0.0])
        tips.append(straight_mm + 1e3 * (base.T @ (data.site(f"{SLOT}_tip").xpos - tip_m))[:2])
        tensions.append(tension_n)
    return np.array(tips), np.array(tensions)


def settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Step until nothing moves."""
    for _ in range(MAX_STEPS):
        mujoco.mj_step(model, data)
        if np.abs(data.qvel).max() < REST_RAD_S and np.abs(data.qacc).max() < 1e-3:
            break
    mujoco.mj_forward(model, data)


def by_plant(finger: Finger) -> tuple[Array, Array]:
    """Return tips (K, 2) [mm] and tensions (K,) [N] of the emulated cell's own mechanics at rest."""
    bank, at_m, tips, tensions = FingerBank([_without_effects(finger)]), 0.0, [], []
    for end_m in 1e-3 * PULLED_MM:
        for step in range(1, MOVING + 1):
            bank.step(np.array([at_m + (end_m - at_m) * step / MOVING]), 1e-3)
        for _ in range(RESTING):
            bank.step(np.array([end_m]), 1e-3)
        at_m = end_m
        tips.append(1e3 * bank.chain()[0][0, -1])
        tensions.append(float(bank.tension_n[0]))
    return np.array(tips), np.array(tensions)


def _without_effects(finger: Finger) -> FingerTruth:
    modulus_pa = np.array([1e6 * finger.strip.modulus_mpa[2], 0.0, 0.0])
    routing_m = 1e-3 * np.array(finger.routing_mm)
    return replace(
        ideal_finger(finger.joints),
        link_lengths_m=1e-3 * np.array(finger.link_mm),
        body_height_m=1e-3 * finger.body_mm,
        opening_rad=np.array(finger.opening_rad),
        entry_radius_m=routing_m[0::2],
        exit_radius_m=routing_m[1::2],
        width_m=1e-3 * finger.width_mm,
        strip_lengths_m=1e-3 * np.array(finger.length_mm),
        thickness_m=1e-3 * np.array(finger.thickness_mm),
        stress_tension_pa=modulus_pa,
        stress_compression_pa=modulus_pa,
        poisson=finger.strip.poisson,
        cable_stiffness_n=1e6,
    )


def apart(tips_mm: Array, others_mm: Array, finger: Finger) -> Array:
    """Return how far tips are apart [% of the finger's length]."""
    return np.asarray(100.0 * np.linalg.norm(tips_mm - others_mm, axis=1) / sum(finger.link_mm))


def main() -> None:
    """Compare and print the claims."""
    no_options(__doc__)
    tips: dict[str, list[Array]] = {}
    tensions: dict[str, list[Array]] = {}
    for name in sorted(load_directory(shipped_directory())):
        finger, material = linear_finger(name)
        kernel, hinges = by_kernel(finger, JointModel.FLEXURE), by_kernel(finger, JointModel.HINGE)
        plant = by_plant(finger)
        springs = by_mujoco(name, material, JointModel.FLEXURE, finger)
        pivots = by_mujoco(name, material, JointModel.HINGE, finger)
        pairs = {
            "plant, kernel": (plant, kernel),
            "MuJoCo, kernel": (springs, kernel),
            "MuJoCo, plant": (springs, plant),
            "both with hinges": (pivots, hinges),
            "hinges, plant": (pivots, plant),
        }
        for pair, (ours, theirs) in pairs.items():
            tips.setdefault(pair, []).append(apart(ours[0], theirs[0], finger))
            tensions.setdefault(pair, []).append(100.0 * np.abs(ours[1] / theirs[1] - 1.0))
    sets = len(tips["plant, kernel"])
    count = sets * len(PULLED_MM)
    tested = f"index fingers of {sets} sets at {len(PULLED_MM)} pulled lengths up to {PULLED_MM[-1]:.0f} mm"
    for pair in ("plant, kernel", "MuJoCo, kernel", "MuJoCo, plant", "both with hinges"):
        claim(
            pair, float(np.max(tips[pair])), "%", better="lower", goal=1.0, runs=count,
            peer="MuJoCo's hinges, plant", peer_value=float(np.max(tips["hinges, plant"])),
            note=f"largest distance of tips, of the finger's length, {np.mean(tips[pair]):.2g} in the mean; {tested}; "
            f"tension {np.mean(tensions[pair]):.2g} % in the mean, {np.max(tensions[pair]):.2g} at most",
        )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
