# SPDX-License-Identifier: Apache-2.0
"""Displacements of flexures: tips as they were said, links where the finger kernel has them, none of a hinge."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest

from softgrip_description import link_poses
from softgrip_description.flexures import FingerFlexures
from softgrip_description.geometry import max_displacement_m
from softgrip_model.finger import Finger, JointModel, Plane, follow
from softgrip_model.finger.learning import Knowledge
from softgrip_model.finger.predictor import Configuration, assumed_friction
from softgrip_model.finger.replication import replicate
from softgrip_model.finger.uncertainty import PRIOR
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.profile import Profile, load_directory, shipped_directory

FINGERS = [(profile, slot) for profile in load_directory(shipped_directory()).values() for slot in profile.slots]
each_finger = pytest.mark.parametrize(("profile", "slot"), FINGERS, ids=[f"{p.id} {s}" for p, s in FINGERS])


@functools.cache
def flexures(profile: Profile, slot: str) -> FingerFlexures:
    return FingerFlexures(profile, slot)


def posed(profile: Profile, slot: str, angles: np.ndarray, tip_m: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return displacements and poses of the links and the tip."""
    displacements = flexures(profile, slot).displacements_m(angles.tolist(), tip_m.tolist())
    return displacements, link_poses(profile.finger(slot), angles.tolist(), displacements)


def rigid_tip(profile: Profile, slot: str, angles: np.ndarray) -> np.ndarray:
    """Return the tip of hinges, in closed form."""
    tip = np.exp(-1j * np.cumsum(angles)) @ profile.finger(slot).link_lengths_m
    return np.array([tip.real, tip.imag])


@each_finger
@pytest.mark.parametrize("source", ["flexure", "hinge", "learnt"])
def test_the_chain_ends_where_the_prediction_does(profile: Profile, slot: str, source: str) -> None:
    joint_model = JointModel.HINGE if source == "hinge" else JointModel.FLEXURE
    configuration = Configuration({profile.id: profile}, {slot: profile.id}, None, joint_model)
    known, draw = None, np.random.default_rng(11)
    if source == "learnt":
        prior = Knowledge.prior(configuration.causes(slot, PRIOR))
        known = dataclasses.replace(prior, mean=draw.standard_normal(len(prior.mean)))
    largest_m = 0.0
    for prediction in configuration.closing(slot, draw.uniform(0.0, 0.015, 25).tolist(), known):
        if not math.isfinite(prediction.tip[0]):
            continue
        displacements, poses = posed(profile, slot, prediction.joint_angles, np.array(prediction.tip))
        assert poses[-1][:2, 3] == pytest.approx(prediction.tip, abs=1e-9)
        assert math.atan2(-poses[-1][1, 0], poses[-1][0, 0]) == pytest.approx(
            math.remainder(prediction.joint_angles.sum(), math.tau), abs=1e-12
        )
        largest_m = max(largest_m, np.abs(displacements).max())
    # a finger pulled by less than 0.1 mm stands between two states, so the tip of hinges is some micrometres off
    assert largest_m < 5e-6 if source == "hinge" else 2e-4 < largest_m < max_displacement_m(profile.finger(slot), 0)


@each_finger
@pytest.mark.parametrize(
    ("friction", "inner_m", "last_m"), [(None, 1e-5, 2.5e-4), (0.1, 1e-4, 3e-4), (0.6, 2e-4, 3e-4)]
)
def test_links_are_where_the_kernel_has_them(
    profile: Profile, slot: str, friction: float | None, inner_m: float, last_m: float
) -> None:
    """The middles of the links; the last link, which bends, is drawn straight to its tip."""
    finger = Finger.from_profile(profile, slot)
    law = assumed_friction(profile).law if friction is None else FrictionLaw(Law.CAPSTAN, (friction,), 2.0)
    axes = np.array([(0.6, 0.8), (-0.8, 0.6)])
    paths = [
        follow(
            finger,
            law,
            np.arange(0.33, 15.0, 1.7),
            contacts=[Plane(tuple(axis), -1e4, j, 0.5 * length) for j, length in enumerate(finger.link_mm)],
        )
        for axis in axes
    ]
    found, hinged = [], []
    for k in np.flatnonzero(~paths[0].failed):
        angles, tip_m = paths[0].angle_rad[k], 1e-3 * paths[0].tip_mm[k]
        middles_m = 1e-3 * np.stack([path.gap[k] - 1e4 for path in paths], axis=1) @ axes
        _, poses = posed(profile, slot, angles, tip_m)
        for errors, links in ((found, poses), (hinged, link_poses(profile.finger(slot), angles.tolist()))):
            at = [pose @ [0.5e-3 * length, 0.0, 0.0, 1.0] for pose, length in zip(links, finger.link_mm, strict=False)]
            errors.append(np.linalg.norm(np.array(at)[:, :2] - middles_m, axis=1))
    largest = np.max(found, axis=0)
    assert largest[:-1].max() < inner_m
    assert largest[-1] < last_m
    assert np.max(hinged) > 9e-4


@each_finger
def test_rigid_links_leave_no_displacement(profile: Profile, slot: str) -> None:
    """Mode R, and finger/measured, which is a chain of rigid links."""
    finger = Finger.from_profile(profile, slot, JointModel.HINGE)
    replica = replicate(finger, assumed_friction(profile).law, 15.0, 20)
    for angles in replica.angle_rad[np.isfinite(replica.angle_rad).all(axis=1)]:
        displacements, _ = posed(profile, slot, angles, rigid_tip(profile, slot, angles))
        assert np.abs(displacements).max() < 1e-12


@pytest.mark.parametrize("tip_m", [(math.nan, 0.0), (0.0, 0.0), (0.095, 0.04)])
def test_a_tip_that_is_unknown_or_out_of_reach_leaves_the_links_as_hinges(tip_m: tuple[float, float]) -> None:
    profile, slot = FINGERS[-1]
    angles = np.full(profile.finger(slot).joints, 0.4)
    displacements, _ = posed(profile, slot, angles, np.array(tip_m))
    assert not displacements.any()


def test_a_finger_without_a_known_friction_still_ends_at_its_tip() -> None:
    profile, slot = FINGERS[0]
    unknown = dataclasses.replace(profile, friction_id="measured-elsewhere")
    angles = np.full(profile.finger(slot).joints, 0.4)
    tip_m = rigid_tip(profile, slot, angles) + np.array([0.9e-3, -0.3e-3])
    displacements, poses = posed(unknown, slot, angles, tip_m)
    assert poses[-1][:2, 3] == pytest.approx(tip_m, abs=1e-12)
    # in equal parts
    assert np.linalg.norm(displacements, axis=1) == pytest.approx([math.hypot(0.3e-3, 0.1e-3)] * 3)
