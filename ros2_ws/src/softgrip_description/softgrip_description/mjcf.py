# SPDX-License-Identifier: Apache-2.0
"""The hand with its mounted fingers as MJCF, the model format of MuJoCo.

What MuJoCo can not express, so that nobody takes its closing for this project's prediction:

* friction along the cable: the tension of a MuJoCo tendon is one number. Here it falls at every routing point by a law
  that depends on angle and tension (docs/friction.md). The model is the frictionless hand.
* the strips' stiffness beyond small angles: a spring has one number, by the modulus at rest. That of the printed
  material falls with strain (thesis section 4.2.2).
* hysteresis, creep and the stop of a closing groove as a stiff, not a hard limit.

Two forms: flexures (mode F, `mjcf_flexures`), which close as the kernel and the plant do, and one hinge a joint
(mode P), which a simulator steps faster.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from softgrip_description.geometry import finger_joint_names, quaternion_of, rotation_of, slot_pose
from softgrip_description.hand import Hand
from softgrip_description.mjcf_flexures import FlexureChain
from softgrip_description.mjcf_text import number, text
from softgrip_description.solids import base_outline, link_outline, prism_inertia
from softgrip_description.urdf import finger_set_of
from softgrip_model.finger import JointModel
from softgrip_model.profile import FingerDesign, Material

Array = NDArray[np.float64]

#: [N] what a tendon's motor may pull
_MAX_TENSION_N = 35.0
#: [N m s/rad] keeps an explicit simulation of links of a few grams calm; no measured property
_DAMPING_NMS = 2e-4
#: A closing groove of flexures: how far before its flanks meet they press [rad], as in the kernel, and how stiffly
#: [N m/rad]: a little less than in the emulated cell. The softest strips then want a step [s] of 1 ms.
_STOP_MARGIN_RAD, _STOP_NM_RAD = math.radians(5.0), 2.0
_FLEXURE_STEP_S, _HINGE_STEP_S = 1e-3, 2e-3


def joint_stiffness_nm(design: FingerDesign, material: Material, joint: int) -> float:
    """Return the bending stiffness of a joint's strip at rest [N m/rad]: E(0) b h^3 / (12 l), Eq 4.3 at zero."""
    inertia_m4 = design.width_m * design.thicknesses_m[joint] ** 3 / 12.0
    return material.modulus_constant_pa * inertia_m4 / design.joint_lengths_m[joint]


def routing_points_m(design: FingerDesign) -> list[tuple[int, Array]]:
    """Return the routing points, base to tip.

    Point 2 j lies on the flank before joint j, point 2 j + 1 on the flank behind it, each at its routing radius from
    the joint.

    Returns:
        2 n pairs: link that carries the point (-1 = base), position (2,) in that link's frame [m].
    """
    points = []
    for j in range(design.joints):
        half = 0.5 * design.openings_rad[j]
        before, behind = design.routing_radii_m[2 * j : 2 * j + 2]
        reach_m = design.link_lengths_m[j - 1] if j else 0.0
        points.append((j - 1, np.array([reach_m - before * math.sin(half), -before * math.cos(half)])))
        points.append((j, np.array([behind * math.sin(half), -behind * math.cos(half)])))
    return points


def mjcf_of(
    hand: Hand,
    fingers: Mapping[str, tuple[str, FingerDesign]],
    material: Material,
    *,
    prefix: str = "",
    joint_model: JointModel = JointModel.FLEXURE,
) -> str:
    """Return the MJCF text of a hand; one tendon and one motor a finger, the motor's control is its tension [N].

    The angle of joint j is the joint `<finger>_joint_<j>` of hinges, the length of the tendon of that name of flexures.

    Args:
        hand: palm and slots.
        fingers: slot -> (profile id, design) of what is mounted.
        material: of the strips.
        prefix: before every name.
        joint_model: how links and strips move against each other.

    Raises:
        HandError: a finger without a slot, or one that is too long for its slot.
    """
    hand.check_mounting({slot: design for slot, (_, design) in fingers.items()})
    root = ET.Element("mujoco", model=f"{prefix}{hand.name}")
    root.append(ET.Comment(" frictionless cables, linear strips: see softgrip_description/mjcf.py "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    is_flexure = joint_model is JointModel.FLEXURE
    step_s = _FLEXURE_STEP_S if is_flexure else _HINGE_STEP_S
    ET.SubElement(root, "option", gravity="0 0 -9.81", integrator="implicitfast", timestep=number(step_s))
    world = ET.SubElement(root, "worldbody")
    flange = ET.SubElement(world, "body", name=f"{prefix}flange")
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(hand.flange_rpy_rad)
    x, y, z, w = quaternion_of(pose)
    palm = ET.SubElement(
        flange, "body", name=f"{prefix}palm", pos=text(hand.flange_position_m), quat=text((w, x, y, z))
    )
    half = 0.5 * np.array(hand.palm_size_m)
    ET.SubElement(
        palm, "geom", name=f"{prefix}palm", type="box", size=text(half), pos=text(np.array([0.0, 0.0, -half[2]])),
        mass=number(hand.palm_mass_kg), contype="0", conaffinity="0",
    )  # fmt: skip
    point = hand.tool_centre_point_m(finger_set_of(fingers))
    ET.SubElement(palm, "site", name=f"{prefix}tcp", pos=text(np.array(point)), size="0.002")
    tendons, motors = ET.Element("tendon"), ET.Element("actuator")
    for slot, (_, design) in fingers.items():
        base = _add_base(palm, hand, slot, design, prefix)
        if is_flexure:
            sites = _add_flexures(base, tendons, hand, slot, design, material, prefix)
        else:
            sites = _add_hinges(base, hand, slot, design, material, prefix)
        spatial = ET.SubElement(tendons, "spatial", name=f"{prefix}{slot}_tendon", width="0.0005")
        for site in sites:
            ET.SubElement(spatial, "site", site=site)
        ET.SubElement(
            motors, "motor", name=f"{prefix}{slot}_tension", tendon=f"{prefix}{slot}_tendon", gear="-1",
            ctrlrange=f"0 {number(_MAX_TENSION_N)}",
        )  # fmt: skip
    root.append(tendons)
    root.append(motors)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_base(palm: ET.Element, hand: Hand, slot: str, design: FingerDesign, prefix: str) -> ET.Element:
    pose = slot_pose(hand.slots[slot])
    x, y, z, w = quaternion_of(pose)
    body = ET.SubElement(palm, "body", name=f"{prefix}{slot}_base", pos=text(pose[:3, 3]), quat=text((w, x, y, z)))
    if len(base_outline(design)):
        _add_inertial(body, base_outline(design), design, hand.finger_density_kg_m3)
    return body


def _add_flexures(
    base: ET.Element,
    tendons: ET.Element,
    hand: Hand,
    slot: str,
    design: FingerDesign,
    material: Material,
    prefix: str,
) -> list[str]:
    """Return the sites of the cable; a fixed tendon for each joint knows its angle and the groove's stop."""
    chain = FlexureChain(base, f"{prefix}{slot}", design, material, routing_points_m(design))
    for j, (body, hinges) in enumerate(zip(chain.links, chain.hinges, strict=True)):
        _add_inertial(body, link_outline(design, j), design, hand.finger_density_kg_m3)
        # a spring, since MuJoCo's limits reckon with the masses of the parts alone, and these are next to none
        ends = text((-math.pi, design.openings_rad[j] - _STOP_MARGIN_RAD))
        angle = ET.SubElement(
            tendons, "fixed", name=f"{prefix}{slot}_joint_{j}", springlength=ends, stiffness=number(_STOP_NM_RAD)
        )
        for hinge in hinges:
            ET.SubElement(angle, "joint", joint=hinge, coef="1")
    return chain.sites


def _add_hinges(
    base: ET.Element, hand: Hand, slot: str, design: FingerDesign, material: Material, prefix: str
) -> list[str]:
    """Return the sites of the cable."""
    body, bodies = base, {-1: base}
    offset_m = 0.0
    for j, name in enumerate(finger_joint_names(slot, design.joints, prefix)):
        body = ET.SubElement(body, "body", name=f"{prefix}{slot}_link_{j}", pos=f"{number(offset_m)} 0 0")
        bodies[j] = body
        ET.SubElement(
            body, "joint", name=name, type="hinge", axis="0 0 -1", range=f"0 {number(design.openings_rad[j])}",
            stiffness=number(joint_stiffness_nm(design, material, j)), damping=number(_DAMPING_NMS),
        )  # fmt: skip
        _add_inertial(body, link_outline(design, j), design, hand.finger_density_kg_m3)
        offset_m = design.link_lengths_m[j]
    ET.SubElement(body, "site", name=f"{prefix}{slot}_tip", pos=f"{number(offset_m)} 0 0", size="0.001")
    sites = []
    for i, (link, point) in enumerate(routing_points_m(design)):
        sites.append(f"{prefix}{slot}_routing_{i}")
        ET.SubElement(bodies[link], "site", name=sites[-1], pos=text((*point, 0.0)), size="0.0005")
    return sites


def _add_inertial(body: ET.Element, outline: Array, design: FingerDesign, density_kg_m3: float) -> None:
    mass, centre, inertia = prism_inertia(outline, design.width_m, density_kg_m3)
    order = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    inertial = ET.Element("inertial", pos=text(centre), mass=number(mass), fullinertia=text(np.array(order)))
    body.insert(0, inertial)
    low, high = outline.min(axis=0), outline.max(axis=0)
    ET.SubElement(
        body, "geom", type="box", pos=text(np.array([*(0.5 * (low + high)), 0.0])),
        size=text(np.array([*(0.5 * (high - low)), 0.5 * design.width_m])), contype="1", conaffinity="0",
    )  # fmt: skip
