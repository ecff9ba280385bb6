# SPDX-License-Identifier: Apache-2.0
"""Flexures as springs: their compliance is the kernel's, and MuJoCo's hand of them closes as the kernel does."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from softgrip_description import shipped_hand, slot_pose
from softgrip_description.mjcf import mjcf_of
from softgrip_description.mjcf_flexures import Side, springs_of
from softgrip_model.finger import FRICTIONLESS, Finger, Kernel, MomentLaw, Strip, compliances
from softgrip_model.profile import Profile, load, shipped_directory

pytest.importorskip("mujoco")
import mujoco

SETS = ("power", "pinch", "hook")
#: As far as no groove closes on its stop, which is a spring in the one and a curve in the other.
PULLED_MM = np.array([3.0, 6.0, 9.0])


@pytest.fixture(params=SETS)
def profile(request: pytest.FixtureRequest) -> Profile:
    """A shipped set, its material as stiff at any strain as at rest."""
    shipped = load(shipped_directory() / f"{request.param}.yaml")
    material = dataclasses.replace(shipped.material, modulus_quadratic_pa=0.0, modulus_linear_pa=0.0)
    return dataclasses.replace(shipped, material=material)


def fingers_of(profile: Profile) -> list[Finger]:
    modulus = (0.0, 0.0, 1e-6 * profile.material.modulus_constant_pa)
    strip = Strip(modulus, MomentLaw.LINEAR)
    return [dataclasses.replace(Finger.from_profile(profile, slot), strip=strip) for slot in profile.slots]


@pytest.mark.parametrize("side", list(Side))
def test_three_springs_have_the_compliance_that_they_are_made_of(profile: Profile, side: Side) -> None:
    """Loads at the point, moved to the springs by statics; what these give, moved back by a small turn."""
    for finger in fingers_of(profile):
        joints, _ = compliances(finger)
        for compliance in [joint.root_beyond for joint in joints] + [joint.link_beyond for joint in joints[:-1]]:
            springs = springs_of(compliance, side)
            assert springs is not None
            # directions in the plane of what compression and shear push, and of the closing turn (about -z)
            push = np.array([[float(side.value), 0.0], [0.0, -1.0]])
            found = np.zeros((3, 3))
            for column, (moment, force) in enumerate([(1.0, np.zeros(2)), (0.0, push[0]), (0.0, push[1])]):
                # a link beyond turns the other way when it gives: it stays behind
                turning = -1.0 if side is Side.BEFORE else 1.0
                arm = -springs.centre_mm
                about = turning * moment + arm[0] * force[1] - arm[1] * force[0]
                turn = about / springs.hinge_nmm
                shift = springs.axes.T @ ((springs.axes @ force) / springs.slide_n_mm)
                shift = shift + turn * np.array([-arm[1], arm[0]])
                found[:, column] = [turning * turn, push[0] @ shift, push[1] @ shift]
            assert found == pytest.approx(compliance, rel=1e-9, abs=1e-12)


def test_a_strip_gives_as_a_beam_in_closed_form(profile: Profile) -> None:
    """A strip that is free to contract across: E h^3 w / 12, E h w, 5/6 G h w, but for the study's 1.032."""
    for finger in fingers_of(profile):
        free = dataclasses.replace(
            finger, strip=dataclasses.replace(finger.strip, poisson=0.0), width_mm=13.0, strip_width_mm=()
        )
        modulus = free.strip.modulus_mpa[2]
        for joint, h in zip(compliances(free)[0], free.thickness_mm, strict=True):
            assert joint.bending_nmm2 == pytest.approx(free.study.strip * modulus * h**3 * 13.0 / 12.0)
            assert joint.axial_n == pytest.approx(modulus * h * 13.0)
            assert joint.shear_n == pytest.approx(5.0 / 6.0 * 0.5 * modulus * h * 13.0)


def test_what_cannot_be_springs_is_none() -> None:
    assert springs_of(-np.eye(3), Side.BEFORE) is None
    assert springs_of(np.diag([1.0, 1.0, -1.0]), Side.BEFORE) is None


def test_mujoco_closes_the_exported_hand_as_the_kernel_does(profile: Profile) -> None:
    """Without gravity, at the same pulled lengths: tips within 1 % of the length, tensions within 3 %."""
    hand = shipped_hand()
    mounted = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    model = mujoco.MjModel.from_xml_string(mjcf_of(hand, mounted, profile.material))
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    straight_m = {slot: float(data.tendon(f"{slot}_tendon").length[0]) for slot in profile.slots}
    kernels = {
        slot: Kernel([finger], FRICTIONLESS) for slot, finger in zip(profile.slots, fingers_of(profile), strict=True)
    }
    for pulled_mm in PULLED_MM:
        for slot, kernel in kernels.items():
            tension_n = kernel.solve([pulled_mm], threads=1).actuator_tension_n[0, 0]
            data.ctrl[model.actuator(f"{slot}_tension").id] = tension_n
        mujoco.mj_step(model, data, nstep=2000)
        mujoco.mj_forward(model, data)
        assert np.abs(data.qvel).max() < 1e-3
        for slot, kernel in kernels.items():
            design = profile.finger(slot)
            taken_mm = 1e3 * (straight_m[slot] - float(data.tendon(f"{slot}_tendon").length[0]))
            solution = kernel.solve([taken_mm], threads=1)
            tension_n = data.ctrl[model.actuator(f"{slot}_tension").id]
            assert solution.actuator_tension_n[0, 0] == pytest.approx(tension_n, rel=0.03)
            expected = slot_pose(hand.slots[slot]) @ [*(1e-3 * solution.tip_mm[0, 0]), 0.0, 1.0]
            tip = data.site(f"{slot}_tip").xpos - np.array(hand.flange_position_m)
            assert np.linalg.norm(tip - expected[:3]) < 0.01 * sum(design.link_lengths_m)
            angles = [float(data.tendon(f"{slot}_joint_{j}").length[0]) for j in range(design.joints)]
            assert angles == pytest.approx(solution.angle_rad[0, 0, : design.joints], abs=math.radians(1.0))


def test_the_hand_stays_calm_under_a_large_tension_and_lets_go(profile: Profile) -> None:
    """30 N; at 36 N a strip of 2.5 mm buckles (Euler: pi^2 E I / l^2), and pinch fingers flutter from 35 N on."""
    mounted = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    model = mujoco.MjModel.from_xml_string(mjcf_of(shipped_hand(), mounted, profile.material))
    data = mujoco.MjData(model)
    for tension_n in (30.0, 0.0):
        data.ctrl[:] = tension_n
        mujoco.mj_step(model, data, nstep=2000)
        assert not data.warning.number.any()
        assert np.abs(data.qvel).max() < 0.05
        for slot in profile.slots:
            for j, opening in enumerate(profile.finger(slot).openings_rad):
                assert float(data.tendon(f"{slot}_joint_{j}").length[0]) < opening + math.radians(3.0)
    assert np.abs(data.qpos).max() < 0.1  # a finger hangs in its weight
