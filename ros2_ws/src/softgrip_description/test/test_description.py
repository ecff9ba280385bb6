# SPDX-License-Identifier: Apache-2.0
"""URDF and MJCF of every shipped finger set, read back by MuJoCo, against the finger kernel and closed forms."""

from __future__ import annotations

import math
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from softgrip_description import finger_joint_names, link_poses, shipped_hand, slot_pose, urdf_of
from softgrip_description.geometry import quaternion_of, rotation_of, rpy_of
from softgrip_description.mjcf import mjcf_of
from softgrip_description.pose_feed import HandPose
from softgrip_description.solids import base_outline, link_outline, prism_inertia, prism_triangles, stl_of
from softgrip_model.finger import Finger, JointModel, Kernel
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.profile import Profile, load, shipped_directory

pytest.importorskip("mujoco")
import mujoco

SETS = ("power", "pinch", "hook")


@pytest.fixture(params=SETS)
def profile(request: pytest.FixtureRequest) -> Profile:
    return load(shipped_directory() / f"{request.param}.yaml")


def mounted(profile: Profile) -> dict:
    return {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}


def hinged(profile: Profile) -> mujoco.MjModel:
    """The exported hand with one hinge a joint."""
    return mujoco.MjModel.from_xml_string(
        mjcf_of(shipped_hand(), mounted(profile), profile.material, joint_model=JointModel.HINGE)
    )


def closings(profile: Profile, slot: str, joint_model: JointModel = JointModel.HINGE):
    """Pulled lengths with the kernel's equilibria: every tenth of a millimetre up to 15 mm."""
    kernel = Kernel([Finger.from_profile(profile, slot, joint_model)], FrictionLaw(Law.CAPSTAN, (0.1,), 2.0))
    return kernel.solve(np.linspace(0.0, 15.0, 151))


@pytest.mark.parametrize("joint_model", list(JointModel))
def test_the_tip_of_the_urdf_is_the_kernels(profile: Profile, joint_model: JointModel) -> None:
    hand = shipped_hand()
    pose = HandPose(hand, {profile.id: profile})
    pose.set_mounted(dict.fromkeys(profile.slots, profile.id))
    model = mujoco.MjModel.from_xml_string(urdf_of(hand, pose.fingers))
    data = mujoco.MjData(model)
    for slot in profile.slots:
        design, solution = profile.finger(slot), closings(profile, slot, joint_model)
        for k in range(0, 151, 10):
            tip_m = 1e-3 * solution.tip_mm[0, k]
            assert pose.set_finger(slot, solution.angle_rad[0, k, : design.joints].tolist(), tip_m.tolist())
            for name, position in zip(*pose.joint_state(), strict=True):
                data.joint(name).qpos = position
            mujoco.mj_kinematics(model, data)
            # MuJoCo merges links without joints into their parents: the tip is the last link's end.
            last = data.body(f"{slot}_link_{design.joints - 1}")
            tip = last.xpos + last.xmat.reshape(3, 3) @ [design.link_lengths_m[-1], 0.0, 0.0]
            expected = slot_pose(hand.slots[slot]) @ [*tip_m, 0.0, 1.0]
            flange = np.array(hand.flange_position_m)
            assert tip == pytest.approx(expected[:3] + flange, abs=1e-9)


def test_mujocos_tendons_shorten_by_the_pulled_length(profile: Profile) -> None:
    model = hinged(profile)
    data = mujoco.MjData(model)

    def length_m(slot: str) -> float:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        return float(data.tendon(f"{slot}_tendon").length[0])

    for slot in profile.slots:
        design, solution = profile.finger(slot), closings(profile, slot)
        straight_m = length_m(slot)
        for k in range(0, 151, 10):
            for name, angle in zip(finger_joint_names(slot, design.joints), solution.angle_rad[0, k], strict=False):
                data.joint(name).qpos = angle
            assert straight_m - length_m(slot) == pytest.approx(1e-3 * solution.pulled_mm[0, k], abs=1e-9)


def test_mujocos_frictionless_rest_stiffness_is_the_kernels_for_small_closings(profile: Profile) -> None:
    """A small tension, no friction: angles within 5 %, since the kernel's modulus falls with strain."""
    model = hinged(profile)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    tension_n = 0.05
    for slot in profile.slots:
        data.ctrl[model.actuator(f"{slot}_tension").id] = tension_n
    for _ in range(20000):
        mujoco.mj_step(model, data)
    for slot in profile.slots:
        design = profile.finger(slot)
        kernel = Kernel([Finger.from_profile(profile, slot, JointModel.HINGE)], FrictionLaw(Law.CAPSTAN, (1e-9,), 2.0))
        expected = kernel.solve([tension_n], "tension").angle_rad[0, 0, : design.joints]
        found = [float(data.joint(name).qpos[0]) for name in finger_joint_names(slot, design.joints)]
        assert found == pytest.approx(expected, rel=0.05)


def test_fingers_close_towards_each_other(profile: Profile) -> None:
    """In the palm's frame the fingers' tips go towards the thumb's side and the thumb's towards theirs."""
    hand = shipped_hand()
    for slot in profile.slots:
        design = profile.finger(slot)
        pose = slot_pose(hand.slots[slot])
        straight = (pose @ link_poses(design, [0.0] * design.joints)[-1])[0, 3]
        closed = (pose @ link_poses(design, [0.4] * design.joints)[-1])[0, 3]
        assert math.copysign(1.0, closed - straight) == hand.slots[slot].closes_towards_x


def test_every_joint_turns_about_minus_z_from_straight_to_its_closed_groove(profile: Profile) -> None:
    robot = ET.fromstring(urdf_of(shipped_hand(), mounted(profile), prefix="a_"))
    joints = {joint.get("name"): joint for joint in robot.iter("joint") if joint.get("type") == "revolute"}
    names = [n for slot in profile.slots for n in finger_joint_names(slot, profile.finger(slot).joints, "a_")]
    assert list(joints) == names
    for slot in profile.slots:
        for name, opening in zip(
            finger_joint_names(slot, profile.finger(slot).joints, "a_"), profile.finger(slot).openings_rad, strict=True
        ):
            assert joints[name].find("axis").get("xyz") == "0 0 -1"
            assert float(joints[name].find("limit").get("lower")) == 0.0
            assert float(joints[name].find("limit").get("upper")) == pytest.approx(opening)


def test_a_flexure_displaces_its_link_before_it_turns_it(profile: Profile) -> None:
    robot = ET.fromstring(urdf_of(shipped_hand(), mounted(profile), prefix="a_"))
    joints = {joint.get("name"): joint for joint in robot.iter("joint")}
    prismatic = [name for name, joint in joints.items() if joint.get("type") == "prismatic"]
    assert len(prismatic) == 2 * sum(profile.finger(slot).joints for slot in profile.slots)
    for slot in profile.slots:
        for j, length_m in enumerate(profile.finger(slot).joint_lengths_m):
            chain = [joints[f"a_{slot}_joint_{j}{suffix}"] for suffix in ("_along", "_across", "")]
            moved = [joint.find("child").get("link") for joint in chain]
            assert moved == [f"a_{slot}_link_{j}{suffix}" for suffix in ("_along", "_across", "")]
            assert [joint.find("parent").get("link") for joint in chain][1:] == moved[:-1]
            assert [joint.find("axis").get("xyz") for joint in chain] == ["1 0 0", "0 -1 0", "0 0 -1"]
            limits = [joint.find("limit") for joint in chain[:-1]]
            assert [float(limit.get("upper")) for limit in limits] == pytest.approx([0.5 * length_m] * 2)
            assert [float(limit.get("lower")) for limit in limits] == pytest.approx([-0.5 * length_m] * 2)


def test_links_of_a_prefixed_hand_all_carry_the_prefix(profile: Profile) -> None:
    robot = ET.fromstring(urdf_of(shipped_hand(), mounted(profile), prefix="left_"))
    assert all(link.get("name").startswith("left_") for link in robot.iter("link"))


def test_the_tool_centre_point_is_the_sets_and_another_one_for_a_mixed_hand() -> None:
    hand = shipped_hand()
    power, hook = (load(shipped_directory() / f"{name}.yaml") for name in ("power", "hook"))
    mixed = {"index": ("power", power.finger("index")), "thumb": ("hook", hook.finger("thumb"))}

    def tcp(text: str) -> list[float]:
        joint = next(j for j in ET.fromstring(text).iter("joint") if j.get("name") == "tcp_mount")
        return [float(value) for value in joint.find("origin").get("xyz").split()]

    assert tcp(urdf_of(hand, mounted(hook))) == pytest.approx(hand.tool_centre_points_m["hook"])
    assert tcp(urdf_of(hand, mixed)) == pytest.approx(hand.default_tool_centre_point_m)


def test_a_prism_of_a_rectangle_has_the_inertia_of_a_box() -> None:
    a, b, c, density = 0.04, 0.012, 0.015, 1190.0
    outline = np.array([(1.0, 2.0), (1.0 + a, 2.0), (1.0 + a, 2.0 + b), (1.0, 2.0 + b)])
    mass, centre, inertia = prism_inertia(outline, c, density)
    assert mass == pytest.approx(density * a * b * c)
    assert centre == pytest.approx([1.0 + a / 2, 2.0 + b / 2, 0.0])
    assert np.diag(inertia) == pytest.approx(mass / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b]))
    assert inertia[0, 1] == pytest.approx(0.0, abs=1e-12 * mass)


def test_link_bodies_are_closed_surfaces_with_their_prisms_volume(profile: Profile) -> None:
    """Divergence theorem: the triangles enclose area times width; two triangles share each edge."""
    for slot in profile.slots:
        design = profile.finger(slot)
        outlines = [link_outline(design, j) for j in range(design.joints)]
        outlines += [base_outline(design)] if design.base_length_m else []
        for outline in outlines:
            triangles = prism_triangles(outline, design.width_m)
            volume = np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0
            mass, _, _ = prism_inertia(outline, design.width_m, 1.0)
            assert volume == pytest.approx(mass)
            corners = [tuple(np.round(corner, 9)) for corner in triangles.reshape(-1, 3)]
            edges = [
                (corners[3 * k + i], corners[3 * k + (i + 1) % 3]) for k in range(len(triangles)) for i in range(3)
            ]
            assert len(set(edges)) == len(edges)
            assert {(b, a) for a, b in edges} == set(edges)
            assert len(stl_of(triangles)) == 84 + 50 * len(triangles)


def test_rotations_agree_with_each_other_also_at_gimbal_lock() -> None:
    rng = np.random.default_rng(3)
    cases = [rng.uniform(-math.pi, math.pi, 3) for _ in range(50)] + [np.array([0.3, math.pi / 2, 0.0])]
    for rpy in cases:
        pose = np.eye(4)
        pose[:3, :3] = rotation_of(rpy)
        x, y, z, w = quaternion_of(pose)
        expected = np.zeros(9)
        mujoco.mju_quat2Mat(expected, np.array([w, x, y, z]))
        assert pose[:3, :3] == pytest.approx(expected.reshape(3, 3), abs=1e-12)
        assert rotation_of(rpy_of(pose)) == pytest.approx(pose[:3, :3], abs=1e-9)
