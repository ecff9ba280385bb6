# SPDX-License-Identifier: Apache-2.0
"""A finger of mode F as a chain of bodies and springs, for MJCF (docs/finger.md, and docs/description.md for how near).

From a link's middle to the next one's: the link up to its end, the strip's root in it, the strip, its root in the link
beyond, that link up to its middle. A link's ends carry the routing points. Every part but the strip is a linear
compliance, which three springs are exactly: it has a point where turning and shifting do not ask for each other, and
two directions there in which the shifts do not either. The strip is four hinges and, in its middle, two slides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from softgrip_description.mjcf_text import number, text
from softgrip_model.finger import Finger, compliances
from softgrip_model.profile import FingerDesign, Material

Array = NDArray[np.float64]

#: Where a strip's hinges sit and what share of its length bends at each: the bending of a strip under any moment that
#: is a polynomial up to degree 7 along it, as Gauss and Legendre integrate it.
_PLACES, _SHARES = np.polynomial.legendre.leggauss(4)
_PLACES, _SHARES = 0.5 * (1.0 + _PLACES), 0.5 * _SHARES
#: [s] damping over stiffness, as of the emulated cell's fingers; more than half a step, so that light parts stay calm
_DAMPING_S = 0.035
#: [kg], [kg m2] of a part that has no shape of its own
_LIGHT_KG, _LIGHT_KGM2 = 2e-5, 2e-10


class Side(Enum):
    """Whether a link gives before its joint or beyond it: there "into the link" is backwards or forwards."""

    BEFORE = -1
    BEYOND = 1


@dataclass(frozen=True, eq=False)
class Springs:
    """A compliance (3, 3) of `softgrip_model.finger.compliance` as three springs.

    Attributes:
        centre_mm: where all three act, from the compliance's point, (2,), x along the straight finger.
        axes: (2, 2), a row is the direction of a slide in the finger's plane.
        slide_n_mm: (2,) stiffness of the slides.
        hinge_nmm: stiffness of the hinge.
    """

    centre_mm: Array
    axes: Array
    slide_n_mm: Array
    hinge_nmm: float


def springs_of(compliance: Array, side: Side) -> Springs | None:
    """Return the springs; None for a compliance that is not positive: no springs have one."""
    turning, coupling = compliance[0, 0], compliance[0, 1:]
    if turning <= 0.0:
        return None
    shifts, directions = np.linalg.eigh(compliance[1:, 1:] - np.outer(coupling, coupling) / turning)
    if shifts[0] <= 0.0:
        return None
    into_link = float(side.value)
    return Springs(
        centre_mm=np.array([into_link * coupling[1], coupling[0]]) / turning,
        axes=directions.T * [into_link, -1.0],
        slide_n_mm=1.0 / shifts,
        hinge_nmm=1.0 / turning,
    )


class FlexureChain:
    """Adds a finger to the body of its base; sites of the cable and names of the hinges are known afterwards.

    Attributes:
        sites: routing points, base to tip, then the cable's end.
        hinges: (n) of each joint, what turns from the middle of one link to that of the next.
        links: (n) bodies of the links' middles; their frames begin at the joints.
    """

    def __init__(
        self,
        base: ET.Element,
        name: str,
        design: FingerDesign,
        material: Material,
        points_m: Sequence[tuple[int, Array]],
    ) -> None:
        self.sites: list[str] = []
        self.hinges: list[list[str]] = [[] for _ in range(design.joints)]
        self.links: list[ET.Element] = []
        self._name, self._points_m = name, points_m
        joints, tip = compliances(Finger.from_design(design, material))
        body, apex_mm = base, 0.0
        for j, (one, length_mm) in enumerate(zip(joints, 1e3 * np.array(design.joint_lengths_m), strict=True)):
            half_mm = 0.5 * length_mm
            if one.link_before is not None and one.root_before is not None:
                far = f"{name}_link_{j - 1}_far"
                body = self._give(body, far, j, one.link_before, Side.BEFORE, apex_mm, apex_mm)
                self._site(body, 2 * j, apex_mm)
                body = self._give(body, f"{name}_root_{j}", j, one.root_before, Side.BEFORE, -half_mm, -half_mm)
                begin_mm = 0.0
            else:
                self._site(body, 0, 0.0)
                begin_mm = -half_mm
            stiffness = (one.bending_nmm2, one.axial_n, one.shear_n)
            body, end_mm = self._strip(body, j, begin_mm, length_mm, stiffness)
            near = f"{name}_link_{j}_near"
            body = self._give(body, near, j, one.root_beyond, Side.BEYOND, end_mm, end_mm - half_mm)
            self._site(body, 2 * j + 1, 0.0)
            body = self._give(body, f"{name}_link_{j}", j, one.link_beyond, Side.BEYOND, 0.0, 0.0, light=False)
            self.links.append(body)
            apex_mm = 1e3 * design.link_lengths_m[j]
        last = design.joints - 1
        body = self._give(body, f"{name}_link_{last}_far", None, tip, Side.BEFORE, apex_mm, apex_mm)
        ET.SubElement(body, "site", name=f"{name}_tip", pos="0 0 0", size="0.001")
        self._add_site(body, f"{name}_cable_end", np.array([0.0, points_m[-1][1][1]]))

    def _give(
        self,
        parent: ET.Element,
        name: str,
        joint: int | None,
        compliance: Array,
        side: Side,
        point_mm: float,
        origin_mm: float,
        *,
        light: bool = True,
    ) -> ET.Element:
        """Return a body behind a compliance; its point and the body's origin are given in the parent, along x."""
        body = _body(parent, name, origin_mm, light=light)
        springs = springs_of(compliance, side)
        if springs is None:
            return body
        at_mm = springs.centre_mm + np.array([point_mm - origin_mm, 0.0])
        for axis, way, stiffness in zip(springs.axes, "ab", springs.slide_n_mm, strict=True):
            _spring(body, f"{name}_slide_{way}", "slide", (*axis, 0.0), 1e3 * stiffness, at_mm)
        _spring(body, f"{name}_hinge", "hinge", (0.0, 0.0, -1.0), 1e-3 * springs.hinge_nmm, at_mm)
        if joint is not None:
            self.hinges[joint].append(f"{name}_hinge")
        return body

    def _strip(
        self, parent: ET.Element, joint: int, begin_mm: float, length_mm: float, stiffness: tuple[float, float, float]
    ) -> tuple[ET.Element, float]:
        """Return the strip's last body and where in it the strip ends [mm]; it begins in the parent."""
        bending_nmm2, axial_n, shear_n = stiffness
        body, before_mm = parent, -begin_mm
        for i, (place, share) in enumerate(zip(_PLACES, _SHARES, strict=True)):
            name, here_mm = f"{self._name}_strip_{joint}_{i}", place * length_mm
            body = _body(body, name, here_mm - before_mm)
            if i == len(_PLACES) // 2:
                middle_mm = np.array([0.5 * length_mm - here_mm, 0.0])
                for way, axis, force_n in (("along", (1.0, 0.0, 0.0), axial_n), ("across", (0.0, -1.0, 0.0), shear_n)):
                    _spring(body, f"{name}_{way}", "slide", axis, 1e3 * force_n / length_mm, middle_mm)
            turning = 1e-3 * bending_nmm2 / (share * length_mm)
            _spring(body, f"{name}_hinge", "hinge", (0.0, 0.0, -1.0), turning, np.zeros(2))
            self.hinges[joint].append(f"{name}_hinge")
            before_mm = here_mm
        return body, length_mm - before_mm

    def _site(self, body: ET.Element, i: int, origin_mm: float) -> None:
        """Add a routing point to the end of its link, whose frame begins at the joint next to it."""
        self._add_site(body, f"{self._name}_routing_{i}", self._points_m[i][1] - [1e-3 * origin_mm, 0.0])

    def _add_site(self, body: ET.Element, name: str, place_m: Array) -> None:
        ET.SubElement(body, "site", name=name, pos=text((*place_m, 0.0)), size="0.0005")
        self.sites.append(name)


def _body(parent: ET.Element, name: str, x_mm: float, *, light: bool = True) -> ET.Element:
    body = ET.SubElement(parent, "body", name=name, pos=text((1e-3 * x_mm, 0.0, 0.0)))
    if light:
        ET.SubElement(body, "inertial", pos="0 0 0", mass=number(_LIGHT_KG), diaginertia=text((_LIGHT_KGM2,) * 3))
    return body


def _spring(body: ET.Element, name: str, kind: str, axis: Sequence[float], stiffness: float, at_mm: Array) -> None:
    ET.SubElement(
        body, "joint", name=name, type=kind, axis=text(axis), pos=text((*(1e-3 * at_mm), 0.0)),
        stiffness=number(stiffness), damping=number(_DAMPING_S * stiffness),
    )  # fmt: skip
