# SPDX-License-Identifier: Apache-2.0
"""A finger set as printed: frozen values in SI units, and what must hold between them (profile schema 1)."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from dataclasses import dataclass

from softgrip_model.digest import text_digest

SCHEMA = 1
MAX_JOINTS = 6
MOMENT_LAWS = ("linear", "signed_tangent", "absolute_tangent", "neutral_axis", "signed_secant")


class ProfileError(ValueError):
    """A profile that cannot be used: says which key, what was expected, what was found, what to do."""


@dataclass(frozen=True)
class Material:
    """Tangent modulus E(e) = a e^2 + b e + c of the joint material, e = strain (thesis section 4.2.2)."""

    name: str
    modulus_quadratic_pa: float
    modulus_linear_pa: float
    modulus_constant_pa: float
    moment_law: str
    """One of MOMENT_LAWS; docs/finger.md compares them."""
    max_strain: float
    """Largest ``|strain|`` that the modulus was measured at."""


@dataclass(frozen=True)
class Cable:
    """The tendon."""

    name: str
    radius_m: float
    axial_stiffness_n: float | None
    """EA; None = treated as inextensible."""
    lead_length_m: float
    """Cable between the actuator and the finger's first routing point (matters only when it stretches)."""
    hole_radius_m: float | None = None
    """Of the passages that it runs through; None = not stated."""


@dataclass(frozen=True)
class PathPoint:
    """One point of a measured empty closing of this very design."""

    pulled_length_m: float
    joint_angles_rad: tuple[float, ...]
    tension_n: float


@dataclass(frozen=True)
class FingerDesign:
    """One finger: n joints, n links after them, 2 n routing points, all listed from the base to the tip."""

    base_length_m: float
    """Rigid part before the first joint (the thumb's metacarpal); 0 when the joint sits on the palm."""
    link_lengths_m: tuple[float, ...]
    """Joint to joint; the last one from the last joint to the tip."""
    width_m: float
    body_height_m: float
    """Depth of the body below the joints' apexes: the groove flanks end there."""
    joint_lengths_m: tuple[float, ...]
    """Length of the bending strip of each joint (l of Eq 3.4)."""
    thicknesses_m: tuple[float, ...]
    """Thickness of the bending strip of each joint (h of Eq 4.3)."""
    openings_rad: tuple[float, ...]
    """Opening of each V groove."""
    routing_radii_m: tuple[float, ...]
    """Distance of each routing point from its joint along the groove flank: entry, exit of joint 0, of joint 1, ..."""
    calibrated_path: tuple[PathPoint, ...]
    """Measured empty closing; empty when nobody measured one."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.thicknesses_m)

    @property
    def length_m(self) -> float:
        """First joint to tip, straight."""
        return sum(self.link_lengths_m)


@dataclass(frozen=True)
class Profile:
    """A finger set: one design for each slot of the gripper."""

    schema: int
    id: str
    title: str
    source: str
    material: Material
    cable: Cable
    friction_id: str
    """Friction model assumed until a calibrated one is active (softgrip_model.friction.published)."""
    fingers: tuple[tuple[str, FingerDesign], ...]
    """(slot, design)."""

    @property
    def slots(self) -> tuple[str, ...]:
        """Names of the slots that this set has a finger for."""
        return tuple(name for name, _ in self.fingers)

    def finger(self, slot: str) -> FingerDesign:
        """The design for one slot.

        Raises:
            ProfileError: this set has no finger for that slot.
        """
        for name, design in self.fingers:
            if name == slot:
                return design
        raise ProfileError(f"profile {self.id!r} has no finger {slot!r}; it has {', '.join(self.slots)}")


def digest(profile: Profile) -> str:
    """Sixteen hex digits that change when anything in the profile does."""
    values = dataclasses.asdict(profile)
    if profile.cable.hole_radius_m is None:  # not stated: the digest of profiles from before the key existed
        del values["cable"]["hole_radius_m"]
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return text_digest(text)


def problems(profile: Profile) -> list[str]:
    """Everything that keeps the profile from being used, in words; empty when it is sound."""
    found = []
    if profile.schema != SCHEMA:
        found.append(f"schema: expected {SCHEMA}, found {profile.schema}; write the profile again in schema {SCHEMA}")
    if not profile.id or not all(c.isalnum() or c in "-_" for c in profile.id):
        found.append(f"id: expected letters, digits, - and _, found {profile.id!r}")
    found += _material_problems(profile.material)
    found += _cable_problems(profile.cable)
    if not profile.friction_id:
        found.append("friction_id: expected the id of a friction model, found none")
    if not profile.fingers:
        found.append("fingers: expected at least one finger, found none")
    for name, design in profile.fingers:
        found += [f"fingers.{name}.{text}" for text in _design_problems(design, profile.cable.radius_m)]
    return found


def _positive(where: str, value: float) -> list[str]:
    if math.isfinite(value) and value > 0.0:
        return []
    return [f"{where}: expected a positive number, found {value!r}"]


def _material_problems(material: Material) -> list[str]:
    found = _positive("material.modulus_constant_pa", material.modulus_constant_pa)
    found += _positive("material.max_strain", material.max_strain)
    if material.moment_law not in MOMENT_LAWS:
        found.append(f"material.moment_law: expected one of {', '.join(MOMENT_LAWS)}, found {material.moment_law!r}")
    curvature = (material.modulus_quadratic_pa, material.modulus_linear_pa)
    if not all(math.isfinite(value) for value in curvature):
        found.append(f"material.modulus_*_pa: expected finite numbers, found {curvature}")
    elif not found and material.moment_law == "absolute_tangent":
        # a joint whose modulus falls to zero would collapse: no unique equilibrium
        steps = [material.max_strain * i / 100.0 for i in range(101)]
        minimum = min((curvature[0] * e + curvature[1]) * e + material.modulus_constant_pa for e in steps)
        found += _positive("material: least tangent modulus within max_strain", minimum)
    return found


def _cable_problems(cable: Cable) -> list[str]:
    found = _positive("cable.radius_m", cable.radius_m)
    if cable.axial_stiffness_n is not None:
        found += _positive("cable.axial_stiffness_n", cable.axial_stiffness_n)
    if cable.hole_radius_m is not None and not cable.radius_m <= cable.hole_radius_m < math.inf:
        found.append(
            f"cable.hole_radius_m: expected at least the cable's radius, {cable.radius_m!r}, "
            f"found {cable.hole_radius_m!r}"
        )
    if not 0.0 <= cable.lead_length_m < math.inf:
        found.append(f"cable.lead_length_m: expected 0 or more, found {cable.lead_length_m!r}")
    return found


def _design_problems(design: FingerDesign, cable_radius_m: float) -> list[str]:
    n = design.joints
    if not 1 <= n <= MAX_JOINTS:
        return [f"thicknesses_m: expected 1 to {MAX_JOINTS} joints, found {n}"]
    expected = {
        "link_lengths_m": n,
        "joint_lengths_m": n,
        "thicknesses_m": n,
        "openings_rad": n,
        "routing_radii_m": 2 * n,
    }
    found = []
    for key, count in expected.items():
        values = getattr(design, key)
        if len(values) != count:
            found.append(f"{key}: expected {count} values for {n} joints, found {len(values)}")
        found += [text for i, value in enumerate(values) for text in _positive(f"{key}[{i}]", value)]
    found += _positive("width_m", design.width_m) + _positive("body_height_m", design.body_height_m)
    if not 0.0 <= design.base_length_m < math.inf:
        found.append(f"base_length_m: expected 0 or more, found {design.base_length_m!r}")
    if found:
        return found
    found += _groove_problems(design, cable_radius_m)
    for i, point in enumerate(design.calibrated_path):
        if len(point.joint_angles_rad) != n:
            found.append(f"calibrated_path[{i}]: expected {n} joint angles, found {len(point.joint_angles_rad)}")
    lengths = [point.pulled_length_m for point in design.calibrated_path]
    if any(b <= a for a, b in itertools.pairwise(lengths)):
        found.append("calibrated_path: expected growing pulled lengths")
    return found


def _groove_problems(design: FingerDesign, cable_radius_m: float) -> list[str]:
    found = []
    radii = design.routing_radii_m
    for j, opening in enumerate(design.openings_rad):
        if opening >= math.pi:
            found.append(f"openings_rad[{j}]: expected less than pi, found {opening!r}")
            continue
        flank_m = design.body_height_m / math.cos(opening / 2.0)
        mouth_m = 2.0 * design.body_height_m * math.tan(opening / 2.0)
        found += [
            f"routing_radii_m[{i}]: {radii[i]!r} lies outside the groove, whose flank is {flank_m:.5f} m long; "
            "make it smaller or the body higher"
            for i in (2 * j, 2 * j + 1)
            if radii[i] + cable_radius_m > flank_m
        ]
        if design.thicknesses_m[j] > mouth_m:
            found.append(
                f"thicknesses_m[{j}]: {design.thicknesses_m[j]!r} exceeds the opening of the groove, {mouth_m:.5f} m"
            )
    if found:
        return found
    sines = [math.sin(opening / 2.0) for opening in design.openings_rad]
    for k in range(1, design.joints):
        needed_m = radii[2 * k - 1] * sines[k - 1] + radii[2 * k] * sines[k]
        if needed_m >= design.link_lengths_m[k - 1]:
            found.append(
                f"link_lengths_m[{k - 1}]: {design.link_lengths_m[k - 1]!r} is shorter than the {needed_m:.5f} m that "
                f"routing points {2 * k - 1} and {2 * k} take; lengthen the link or move them inwards"
            )
    needed_m = radii[-1] * sines[-1]
    if needed_m >= design.link_lengths_m[-1]:
        found.append(
            f"link_lengths_m[-1]: {design.link_lengths_m[-1]!r} is shorter than routing point {needed_m:.5f} m"
        )
    return found
