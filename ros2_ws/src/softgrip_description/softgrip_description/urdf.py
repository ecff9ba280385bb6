# SPDX-License-Identifier: Apache-2.0
"""The hand with its mounted fingers as URDF.

Links: ``flange`` (root), ``palm``, ``tcp``; of a finger ``<finger>_base``, ``<finger>_link_0``, ..., ``<finger>_tip``.
A flexure is three joints. ``<finger>_joint_<j>`` is revolute about -z, from 0 (straight) to the opening of its groove:
positive angles close the finger, as in finger/predicted. Before it ``<finger>_joint_<j>_along`` and ``_across`` are
prismatic and passive: where the strip puts the link beyond, along x and -y of the link before; 0 of a hinge. The links
that they move, named alike, have no shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from softgrip_description.geometry import flexure_names, max_displacement_m, rotation_of, rpy_of, slot_pose
from softgrip_description.hand import Hand
from softgrip_description.solids import base_outline, link_outline, prism_inertia
from softgrip_model.profile import FingerDesign

Array = NDArray[np.float64]
#: finger or link name -> URI of its mesh
MeshUri = Callable[[str], str]

#: What URDF asks for and a flexure has no single number for: generous bounds [N m], [rad/s]; [N], [m/s].
_EFFORT_NM, _VELOCITY_RAD_S = 1.0, 10.0
_EFFORT_N, _VELOCITY_M_S = 100.0, 0.1
_COLOURS = {"palm": (0.25, 0.27, 0.30), "finger": (0.16, 0.50, 0.73)}


def urdf_of(
    hand: Hand,
    fingers: Mapping[str, tuple[str, FingerDesign]],
    *,
    prefix: str = "",
    mesh_uri: MeshUri | None = None,
) -> str:
    """Return the URDF text of a hand.

    Args:
        hand: palm and slots.
        fingers: slot -> (profile id, design) of what is mounted; an empty slot is left out.
        prefix: before every link and joint name, so that several hands fit one tree.
        mesh_uri: gives the URI of a link's visual mesh; None = boxes.

    Raises:
        HandError: a finger without a slot, or one that is too long for its slot.
    """
    hand.check_mounting({slot: design for slot, (_, design) in fingers.items()})
    robot = ET.Element("robot", name=f"{prefix}{hand.name}")
    for name, colour in _COLOURS.items():
        material = ET.SubElement(robot, "material", name=f"{prefix}{name}")
        ET.SubElement(material, "color", rgba=_text((*colour, 1.0)))
    _add_palm(robot, hand, fingers, prefix)
    for slot, (_, design) in fingers.items():
        _add_finger(robot, hand, slot, design, prefix, mesh_uri)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def finger_set_of(fingers: Mapping[str, tuple[str, FingerDesign]]) -> str:
    """Return the one profile id of all mounted fingers, empty when they are mixed or none is mounted."""
    sets = {profile for profile, _ in fingers.values()}
    return sets.pop() if len(sets) == 1 else ""


def fixed_transforms(
    hand: Hand, fingers: Mapping[str, tuple[str, FingerDesign]], prefix: str = ""
) -> list[tuple[str, str, Array]]:
    """Return (parent frame, child frame, pose (4, 4)) of palm and tool centre point."""
    palm, tcp = np.eye(4), np.eye(4)
    palm[:3, :3] = rotation_of(hand.flange_rpy_rad)
    palm[:3, 3] = hand.flange_position_m
    tcp[:3, 3] = hand.tool_centre_point_m(finger_set_of(fingers))
    return [(f"{prefix}flange", f"{prefix}palm", palm), (f"{prefix}palm", f"{prefix}tcp", tcp)]


def _add_palm(robot: ET.Element, hand: Hand, fingers: Mapping[str, tuple[str, FingerDesign]], prefix: str) -> None:
    ET.SubElement(robot, "link", name=f"{prefix}flange")
    palm = ET.SubElement(robot, "link", name=f"{prefix}palm")
    size = np.array(hand.palm_size_m)
    centre = (0.0, 0.0, -0.5 * hand.palm_size_m[2])
    squares = size**2
    inertia = hand.palm_mass_kg / 12.0 * np.diag(squares.sum() - squares)  # of a solid box
    _add_inertial(palm, hand.palm_mass_kg, np.array(centre), inertia)
    for kind in ("visual", "collision"):
        shape = ET.SubElement(palm, kind)
        ET.SubElement(shape, "origin", xyz=_text(centre), rpy="0 0 0")
        ET.SubElement(ET.SubElement(shape, "geometry"), "box", size=_text(hand.palm_size_m))
        if kind == "visual":
            ET.SubElement(shape, "material", name=f"{prefix}palm")
    _add_fixed(robot, f"{prefix}flange", f"{prefix}palm", hand.flange_position_m, hand.flange_rpy_rad)
    ET.SubElement(robot, "link", name=f"{prefix}tcp")
    point = hand.tool_centre_point_m(finger_set_of(fingers))
    _add_fixed(robot, f"{prefix}palm", f"{prefix}tcp", point, (0.0, 0.0, 0.0))


def _add_finger(
    robot: ET.Element, hand: Hand, slot: str, design: FingerDesign, prefix: str, mesh_uri: MeshUri | None
) -> None:
    pose = slot_pose(hand.slots[slot])
    base = f"{prefix}{slot}_base"
    link = ET.SubElement(robot, "link", name=base)
    outline = base_outline(design)
    if len(outline):
        _add_body(link, outline, design, hand.finger_density_kg_m3, prefix, mesh_uri and mesh_uri(f"{slot}_base"))
    _add_fixed(robot, f"{prefix}palm", base, pose[:3, 3], rpy_of(pose))
    parent, offset_m = base, 0.0
    for j in range(design.joints):
        parent = _add_flexure(robot, slot, j, design, prefix, parent, offset_m)
        _add_body(
            ET.SubElement(robot, "link", name=parent), link_outline(design, j), design, hand.finger_density_kg_m3,
            prefix, mesh_uri and mesh_uri(f"{slot}_link_{j}"),
        )  # fmt: skip
        offset_m = design.link_lengths_m[j]
    ET.SubElement(robot, "link", name=f"{prefix}{slot}_tip")
    _add_fixed(robot, parent, f"{prefix}{slot}_tip", (offset_m, 0.0, 0.0), (0.0, 0.0, 0.0))


def _add_flexure(
    robot: ET.Element, slot: str, j: int, design: FingerDesign, prefix: str, parent: str, offset_m: float
) -> str:
    """Add the joints of flexure j, `offset_m` along the link before, and the links between; return the link beyond."""
    names = flexure_names("joint", slot, j, prefix)
    links = flexure_names("link", slot, j, prefix)
    for link in links[:-1]:
        add_small_mass(ET.SubElement(robot, "link", name=link))
    reach_m = max_displacement_m(design, j)
    displaced = ("prismatic", (-reach_m, reach_m), (_EFFORT_N, _VELOCITY_M_S))
    turned = ("revolute", (0.0, design.openings_rad[j]), (_EFFORT_NM, _VELOCITY_RAD_S))
    kinds = (("1 0 0", *displaced), ("0 -1 0", *displaced), ("0 0 -1", *turned))
    for name, link, (axis, kind, (low, high), (effort, velocity)) in zip(names, links, kinds, strict=True):
        joint = ET.SubElement(robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=link)
        ET.SubElement(joint, "origin", xyz=_text((offset_m, 0.0, 0.0)), rpy="0 0 0")
        ET.SubElement(joint, "axis", xyz=axis)
        ET.SubElement(
            joint, "limit", lower=_number(low), upper=_number(high), effort=_number(effort), velocity=_number(velocity)
        )
        parent, offset_m = link, 0.0
    return parent


def add_small_mass(link: ET.Element) -> None:
    """Give a link that stands for no body the milligram that simulators ask of what moves."""
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value="1e-06")
    ET.SubElement(inertial, "inertia", ixx="1e-12", ixy="0", ixz="0", iyy="1e-12", iyz="0", izz="1e-12")


def _add_body(
    link: ET.Element, outline: Array, design: FingerDesign, density_kg_m3: float, prefix: str, mesh: str | None
) -> None:
    _add_inertial(link, *prism_inertia(outline, design.width_m, density_kg_m3))
    low, high = outline.min(axis=0), outline.max(axis=0)
    centre, size = 0.5 * (low + high), high - low
    for kind in ("visual", "collision"):
        shape = ET.SubElement(link, kind)
        geometry = ET.SubElement(shape, "geometry")
        if mesh:
            ET.SubElement(geometry, "mesh", filename=mesh)
        else:
            shape.insert(0, ET.Element("origin", xyz=_text((*centre, 0.0)), rpy="0 0 0"))
            ET.SubElement(geometry, "box", size=_text((*size, design.width_m)))
        if kind == "visual":
            ET.SubElement(shape, "material", name=f"{prefix}finger")


def _add_inertial(link: ET.Element, mass_kg: float, centre_m: Array, inertia: Array) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(centre_m), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_number(mass_kg))
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {name: _number(inertia[at]) for name, at in names.items()})


def _add_fixed(
    robot: ET.Element, parent: str, child: str, position_m: Array | tuple[float, ...], rpy_rad: tuple[float, ...]
) -> None:
    joint = ET.SubElement(robot, "joint", name=f"{child}_mount", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(position_m), rpy=_text(rpy_rad))


def _text(values: Array | tuple[float, ...]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return f"{float(value) + 0.0:.12g}"
