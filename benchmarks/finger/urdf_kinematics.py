# SPDX-License-Identifier: Apache-2.0
"""Tips of the URDF, read by MuJoCo, beside finger/predicted for 1,000 random states of every shipped finger."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from softgrip_description import finger_joint_names, shipped_hand, slot_pose, urdf_of
from softgrip_model.finger import JointModel
from softgrip_model.finger.session import Session
from softgrip_model.finger.wear import WearSettings
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options

STATES = 1000
MAX_PULLED_M = 0.015


def differences(profile: Profile, session: Session, slot: str, pulled_m: np.ndarray) -> tuple[float, float]:
    """Return the largest differences of tip position [m] and direction [rad] over pulled lengths."""
    hand = shipped_hand()
    fingers = {name: (profile.id, profile.finger(name)) for name in profile.slots}
    model = mujoco.MjModel.from_xml_string(urdf_of(hand, fingers))
    data = mujoco.MjData(model)
    design, base = profile.finger(slot), slot_pose(hand.slots[slot])
    position_m = direction_rad = 0.0
    for prediction in session.closing(profile.id, slot, "", pulled_m.tolist()):
        if not math.isfinite(prediction.tip[0]):
            continue
        for name, angle in zip(finger_joint_names(slot, design.joints), prediction.joint_angles, strict=True):
            data.joint(name).qpos = angle
        mujoco.mj_kinematics(model, data)
        last = data.body(f"{slot}_link_{design.joints - 1}")
        rotation = last.xmat.reshape(3, 3)
        tip = last.xpos + rotation @ [design.link_lengths_m[-1], 0.0, 0.0] - np.array(hand.flange_position_m)
        expected = base @ [*prediction.tip, 0.0, 1.0]
        total = float(np.sum(prediction.joint_angles))
        along = base[:3, :3] @ [math.cos(total), -math.sin(total), 0.0]
        position_m = max(position_m, float(np.linalg.norm(tip - expected[:3])))
        direction_rad = max(direction_rad, float(np.linalg.norm(np.cross(rotation[:, 0], along))))
    return position_m, direction_rad


def main() -> None:
    """Compare and print the claims."""
    no_options(__doc__)
    profiles = load_directory(shipped_directory())
    position_m, direction_rad = largest(profiles, JointModel.FLEXURE)
    hinge_m, _ = largest(profiles, JointModel.HINGE)
    runs = STATES * sum(len(profile.slots) for profile in profiles.values())
    note = f"largest of {STATES} random pulled lengths up to 15 mm of each finger, mode F"
    peer = {"peer": "the same in mode P, whose joints are the URDF's hinges", "peer_value": hinge_m}
    common: dict[str, Any] = {"better": "lower", "runs": runs}
    claim("tip difference", position_m, "m", goal=1e-5, note=f"{note}; MuJoCo reads the URDF", **common, **peer)
    claim("tip direction difference", direction_rad, "rad", goal=1e-6, note=note, **common)


def largest(profiles: dict[str, Profile], joint_model: JointModel) -> tuple[float, float]:
    """Return the largest differences over all fingers."""
    draw = np.random.default_rng(20261123)
    found = []
    for profile in profiles.values():
        session = Session(profiles, dict.fromkeys(profile.slots, profile.id), WearSettings(), joint_model)
        found += [
            differences(profile, session, slot, np.sort(draw.uniform(0.0, MAX_PULLED_M, STATES)))
            for slot in profile.slots
        ]
    positions, directions = zip(*found, strict=True)
    return max(positions), max(directions)


if __name__ == "__main__":
    main()
