# SPDX-License-Identifier: Apache-2.0
"""One finger without friction, closed by all that can close it: plant, kernel (hinges and flexures) and MuJoCo.

The index finger of every shipped set, its strips of one constant modulus (the material's at rest), no gravity. The
kernel's hinges are the same mechanics as the exported MJCF, so these have to agree; the plant's strips are beams, which
no hinge is: they are beside the kernel's flexures, which were fitted to finite elements, not to the plant.
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
REST_RAD_S, MAX_STEPS = 1e-7, 200_000


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


def by_mujoco(name: str, material: Material, tensions_n: Array) -> tuple[Array, Array]:
    """Return joint angles (K, n) [rad] and tendon shortenings (K,) [mm] of the exported hand at rest under tensions."""
    profile = load_directory(shipped_directory())[name]
    model = mujoco.MjModel.from_xml_string(
        mjcf_of(shipped_hand(), {SLOT: (profile.id, profile.finger(SLOT))}, material)
    )
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    slack_m = float(data.ten_length[0])
    angles, shortenings = [], []
    for tension_n in tensions_n:
        data.ctrl[0] = tension_n
        for _ in range(MAX_STEPS):
            mujoco.mj_step(model, data)
            if np.abs(data.qvel).max() < REST_RAD_S and np.abs(data.qacc).max() < 1e-3:
                break
        mujoco.mj_forward(model, data)
        angles.append(data.qpos.copy())
        shortenings.append(1e3 * (slack_m - float(data.ten_length[0])))
    return np.array(angles), np.array(shortenings)


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


def tips_of(finger: Finger, angles_rad: Array) -> Array:
    """Return the tips (K, 2) [mm] of straight links at joint angles (K, n)."""
    headings = -np.cumsum(angles_rad, axis=1)
    links = np.array(finger.link_mm)
    return np.stack([(links * np.cos(headings)).sum(axis=1), (links * np.sin(headings)).sum(axis=1)], axis=1)


def apart(tips_mm: Array, others_mm: Array, finger: Finger) -> Array:
    """Return how far tips are apart [% of the finger's length]."""
    return np.asarray(100.0 * np.linalg.norm(tips_mm - others_mm, axis=1) / sum(finger.link_mm))


def main() -> None:
    """Compare and print the claims."""
    no_options(__doc__)
    mujoco_tip, mujoco_length, plant_tip, plant_hinge, plant_tension = [], [], [], [], []
    for name in sorted(load_directory(shipped_directory())):
        finger, material = linear_finger(name)
        hinge_tips, hinge_n = by_kernel(finger, JointModel.HINGE)
        flexure_tips, flexure_n = by_kernel(finger, JointModel.FLEXURE)
        angles, shortenings_mm = by_mujoco(name, material, hinge_n)
        plant_tips, plant_n = by_plant(finger)
        mujoco_tip.append(apart(tips_of(finger, angles), hinge_tips, finger))
        mujoco_length.append(100.0 * np.abs(shortenings_mm / PULLED_MM - 1.0))
        plant_tip.append(apart(plant_tips, flexure_tips, finger))
        plant_hinge.append(apart(plant_tips, hinge_tips, finger))
        plant_tension.append(100.0 * np.abs(plant_n / flexure_n - 1.0))
    count = sum(map(len, mujoco_tip))
    tested = f"index fingers of {len(mujoco_tip)} sets at {len(PULLED_MM)} pulled lengths up to {PULLED_MM[-1]:.0f} mm"
    claim(
        "MuJoCo from the kernel's hinges", float(np.max(mujoco_tip)), "%", better="lower", goal=1.0, runs=count,
        note=f"largest distance of tips, of the finger's length; {tested}; shortenings {np.max(mujoco_length):.2g} %",
    )  # fmt: skip
    claim(
        "plant from the kernel's flexures", float(np.max(plant_tip)), "%", better="lower", goal=1.0, runs=count,
        peer="plant from the kernel's hinges", peer_value=float(np.max(plant_hinge)),
        note=f"largest distance of tips, of the finger's length, {np.mean(plant_tip):.2f} in the mean; {tested}; "
        f"tension {np.mean(plant_tension):.1f} % in the mean, {np.max(plant_tension):.1f} at most",
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
