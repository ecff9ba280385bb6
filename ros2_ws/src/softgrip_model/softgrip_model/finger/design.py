# SPDX-License-Identifier: Apache-2.0
"""A finger as the kernel computes it: lengths in mm, forces in N, moduli in MPa, angles in rad."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from softgrip_model.finger import _core
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.flexure import FLEXURE_STUDY, FlexureStudy
from softgrip_model.friction.laws import FrictionLaw, Law, k_index, law_index
from softgrip_model.profile import FingerDesign, Material, Profile

MAX_JOINTS: int = _core.MAX_JOINTS


class MomentLaw(StrEnum):
    """How the bending moment follows from the tangent modulus E(e) = a e^2 + b e + c; docs/finger.md compares them.

    LINEAR: c alone (Eq 3.4). SIGNED_TANGENT: Eq 4.3 as a tangent, its odd term cancels. ABSOLUTE_TANGENT: E(|e|), both
    faces soften. NEUTRAL_AXIS: signed strain about the axis where the axial force vanishes. SIGNED_SECANT: Eq 4.3 as
    its text says, M = K q.
    """

    LINEAR = "linear"
    SIGNED_TANGENT = "signed_tangent"
    ABSOLUTE_TANGENT = "absolute_tangent"
    NEUTRAL_AXIS = "neutral_axis"
    SIGNED_SECANT = "signed_secant"


class JointModel(StrEnum):
    """How links and strips move against each other; docs/finger.md compares them.

    FLEXURE: strips bend along an arc, shorten and shear, and links give near them (mode F, the default). HINGE: rigid
    links turn about the grooves' apexes (mode P, the thesis' picture). Its recipe (mode R) is
    `softgrip_model.finger.replication.replicate`.
    """

    HINGE = "hinge"
    FLEXURE = "flexure"


_MOMENT_INDEX = {law: index for index, law in enumerate(MomentLaw)}
_JOINT_INDEX = {model: index for index, model in enumerate(JointModel)}


@dataclass(frozen=True)
class Strip:
    """Material of the bending strips.

    Attributes:
        modulus_mpa: a, b, c of the tangent modulus [MPa].
        moment_law: how the moment follows.
        max_strain: largest strain measured.
        poisson: Poisson's ratio; mode F alone needs it.
    """

    modulus_mpa: tuple[float, float, float]
    moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT
    max_strain: float = 0.45
    poisson: float = 0.3


@dataclass(frozen=True)
class Finger:
    """One finger with n joints; sequences run from the base to the tip.

    Attributes:
        link_mm: n lengths, joint to joint, the last to the tip.
        thickness_mm: n, h.
        length_mm: n, l of the bending strips.
        routing_mm: 2 n, r: entry and exit of joint 0, of joint 1, ...
        width_mm: w.
        strip_width_mm: n, where the strips' widths differ; empty = all are w.
        strip: material.
        opening_rad: n, of the grooves.
        base_mm: rigid part before joint 0.
        compliance_per_n: 1/EA of the cable, 0 = inextensible.
        lead_mm: cable between actuator and base.
        stop_margin_rad: a groove's stop starts this far before its flanks meet.
        stop_moment_nmm: its strength, z^3/(1-z) times this; 0 = no stop.
        smoothing_rad: |phi| is taken as sqrt(phi^2 + this^2).
        joint_model: mode F or mode P.
        body_mm: depth of the links below the joints' apexes; mode F alone needs it.
        study: constants of mode F.
    """

    link_mm: tuple[float, ...]
    thickness_mm: tuple[float, ...]
    length_mm: tuple[float, ...]
    routing_mm: tuple[float, ...]
    width_mm: float
    strip: Strip
    strip_width_mm: tuple[float, ...] = ()
    opening_rad: tuple[float, ...] = ()
    base_mm: float = 0.0
    compliance_per_n: float = 0.0
    lead_mm: float = 0.0
    stop_margin_rad: float = math.radians(5.0)
    stop_moment_nmm: float = 1000.0
    smoothing_rad: float = 1e-3
    joint_model: JointModel = JointModel.FLEXURE
    body_mm: float = 12.0
    study: FlexureStudy = FLEXURE_STUDY

    def __post_init__(self) -> None:
        if not self.opening_rad:
            object.__setattr__(self, "opening_rad", (math.pi / 2,) * self.joints)
        found = list(self._problems())
        if found:
            raise FingerError("this finger cannot be computed: " + "; ".join(found))

    @property
    def joints(self) -> int:
        """Number of joints, n."""
        return len(self.thickness_mm)

    @property
    def widths_mm(self) -> tuple[float, ...]:
        """Width of each strip, n."""
        return self.strip_width_mm or (self.width_mm,) * self.joints

    @property
    def length_from_joint_mm(self) -> float:
        """First joint to tip, straight."""
        return sum(self.link_mm)

    def with_design(self, thickness_mm: ArrayLike, routing_mm: ArrayLike) -> Finger:
        """Return the same finger with other thicknesses (n) and routing (2 n) [mm]."""
        return dataclasses.replace(
            self,
            thickness_mm=tuple(np.asarray(thickness_mm, dtype=np.float64).tolist()),
            routing_mm=tuple(np.asarray(routing_mm, dtype=np.float64).tolist()),
        )

    def with_joint_model(self, joint_model: JointModel) -> Finger:
        """Return the same finger, computed by another mode."""
        return dataclasses.replace(self, joint_model=joint_model)

    @classmethod
    def from_profile(cls, profile: Profile, slot: str, joint_model: JointModel = JointModel.FLEXURE) -> Finger:
        """Return the finger that a profile has for a slot.

        Raises:
            ProfileError: the profile has none for that slot.
        """
        cable = profile.cable
        stiffness = cable.axial_stiffness_n
        return dataclasses.replace(
            cls.from_design(profile.finger(slot), profile.material, joint_model),
            compliance_per_n=0.0 if stiffness is None else 1.0 / stiffness,
            lead_mm=1e3 * cable.lead_length_m,
        )

    @classmethod
    def from_design(
        cls, design: FingerDesign, material: Material, joint_model: JointModel = JointModel.FLEXURE
    ) -> Finger:
        """Return a finger as it was designed, printed of a material, with a cable that does not stretch."""
        return cls(
            link_mm=_mm(design.link_lengths_m),
            thickness_mm=_mm(design.thicknesses_m),
            length_mm=_mm(design.joint_lengths_m),
            routing_mm=_mm(design.routing_radii_m),
            width_mm=1e3 * design.width_m,
            strip=Strip(
                (
                    1e-6 * material.modulus_quadratic_pa,
                    1e-6 * material.modulus_linear_pa,
                    1e-6 * material.modulus_constant_pa,
                ),
                MomentLaw(material.moment_law),
                material.max_strain,
            ),
            opening_rad=design.openings_rad,
            base_mm=1e3 * design.base_length_m,
            joint_model=joint_model,
            body_mm=1e3 * design.body_height_m,
        )

    def _problems(self) -> list[str]:
        n = self.joints
        if not 1 <= n <= MAX_JOINTS:
            return [f"expected 1 to {MAX_JOINTS} joints, found {n}"]
        counts = {
            "link_mm": n,
            "thickness_mm": n,
            "length_mm": n,
            "opening_rad": n,
            "widths_mm": n,
            "routing_mm": 2 * n,
        }
        found = []
        for name, count in counts.items():
            values = getattr(self, name)
            if len(values) != count:
                found.append(f"{name}: expected {count} values, found {len(values)}")
            found += [f"{name}[{i}]: expected > 0, found {v!r}" for i, v in enumerate(values) if not 0 < v < math.inf]
        if not 0.0 < self.body_mm < math.inf:
            found.append(f"body_mm: expected > 0, found {self.body_mm!r}")
        if not 0.0 <= self.strip.poisson < 0.5:
            found.append(f"poisson: expected 0 or more and less than 0.5, found {self.strip.poisson!r}")
        if not 0.0 < self.strip.modulus_mpa[2] < math.inf:
            found.append(f"modulus_mpa: expected c > 0, found {self.strip.modulus_mpa[2]!r}")
        for name in ("base_mm", "compliance_per_n", "lead_mm", "stop_moment_nmm", "smoothing_rad"):
            if not 0.0 <= getattr(self, name) < math.inf:
                found.append(f"{name}: expected 0 or more, found {getattr(self, name)!r}")
        return found or self._groove_problems()

    def _groove_problems(self) -> list[str]:
        found = [
            f"opening_rad[{j}]: expected between the stop's margin and pi, found {opening!r}"
            for j, opening in enumerate(self.opening_rad)
            if not self.stop_margin_rad < opening < math.pi
        ]
        for j in range(self.joints):
            taken = self.routing_mm[2 * j + 1] * math.sin(self.opening_rad[j] / 2)
            if j + 1 < self.joints:
                taken += self.routing_mm[2 * j + 2] * math.sin(self.opening_rad[j + 1] / 2)
            if taken >= self.link_mm[j]:
                found.append(
                    f"link_mm[{j}]: {self.link_mm[j]!r} is shorter than the {taken:.3f} its routing points take"
                )
        return found

    def _core(self) -> _core.Design:
        return _core.Design(
            base_mm=self.base_mm,
            width_mm=self.widths_mm,
            link_mm=self.link_mm,
            thickness_mm=self.thickness_mm,
            length_mm=self.length_mm,
            opening_rad=self.opening_rad,
            routing_mm=self.routing_mm,
            modulus_mpa=self.strip.modulus_mpa,
            moment_law=_MOMENT_INDEX[self.strip.moment_law],
            max_strain=self.strip.max_strain,
            stop_margin_rad=self.stop_margin_rad,
            stop_moment_nmm=self.stop_moment_nmm,
            compliance_per_n=self.compliance_per_n,
            lead_mm=self.lead_mm,
            smoothing_rad=self.smoothing_rad,
            joint_model=_JOINT_INDEX[self.joint_model],
            body_mm=self.body_mm,
            poisson=self.strip.poisson,
            study=self.study.constants,
        )


def _mm(lengths_m: Sequence[float]) -> tuple[float, ...]:
    return tuple(1e3 * length for length in lengths_m)


#: A cable that slides freely.
FRICTIONLESS = FrictionLaw(Law.CAPSTAN, (0.0,), 1.0)


def core_design(finger: Finger) -> _core.Design:
    """Return the finger as the core takes it."""
    return finger._core()  # noqa: SLF001  same module


def core_friction(law: FrictionLaw) -> _core.Friction:
    """Return the law as the core takes it."""
    return _core.Friction(
        law_index(law.law), k_index(law.k_reading), law.coefficients, law.radius_mm, law.angle_range, law.tension_range
    )
