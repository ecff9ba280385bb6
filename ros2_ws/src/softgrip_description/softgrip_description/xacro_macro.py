# SPDX-License-Identifier: Apache-2.0
"""The hand with a finger set as a xacro macro, for URDFs that others write: an arm's, a cell's.

The macro `softgrip_<set>` is the URDF of `urdf_of` with the prefix left open. Its parameters, all optional: `prefix`
before every name; `parent`, the link that holds the flange, and `xyz`, `rpy` of the flange in it. Without a parent the
flange is a root. Source of the syntax: github.com/ros/xacro/wiki.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

from softgrip_description.hand import Hand
from softgrip_description.urdf import MeshUri, urdf_of
from softgrip_model.profile import Profile

_PARAMETERS = "prefix:='' parent:='' xyz:='0 0 0' rpy:='0 0 0'"


def macro_name(finger_set: str) -> str:
    """Return the name of a finger set's macro."""
    return f"softgrip_{finger_set}"


def macro_of(hand: Hand, profile: Profile, *, mesh_uri: MeshUri | None = None) -> str:
    """Return the text of a ``.urdf.xacro`` file with the macro of a hand with one finger set.

    Args:
        hand: palm and slots.
        profile: of all fingers.
        mesh_uri: gives the URI of a link's visual mesh; None = boxes.

    Raises:
        HandError: a finger without a slot, or one that is too long for its slot.
    """
    fingers = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    described = ET.fromstring(urdf_of(hand, fingers, prefix="${prefix}", mesh_uri=mesh_uri))  # noqa: S314  our own text
    file = ET.Element("robot", {"xmlns:xacro": "http://www.ros.org/wiki/xacro"})
    macro = _xacro(file, "macro", name=macro_name(profile.id), params=_PARAMETERS)
    macro.extend(described)
    mount = ET.SubElement(
        _xacro(macro, "if", value="${parent != ''}"), "joint", name="${prefix}flange_mount", type="fixed"
    )
    ET.SubElement(mount, "parent", link="${parent}")
    ET.SubElement(mount, "child", link="${prefix}flange")
    ET.SubElement(mount, "origin", xyz="${xyz}", rpy="${rpy}")
    ET.indent(file)
    return f'<?xml version="1.0"?>\n{_comment(hand, profile)}\n{ET.tostring(file, encoding="unicode")}\n'


def _xacro(parent: ET.Element, element: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"xacro:{element}", attributes)


def _comment(hand: Hand, profile: Profile) -> str:
    return f"<!-- Hand {hand.name} with finger set {profile.id}; softgrip_description's command describe wrote it. -->"
