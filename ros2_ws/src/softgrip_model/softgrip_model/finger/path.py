# SPDX-License-Identifier: Apache-2.0
"""A finger along a path: closing, opening with friction reversed, objects in the way.

Each routing point of the cable is pulled through, stuck or let back, as the path has it; the state after a step
therefore depends on the steps before it. Lengths in mm, forces in N, angles in rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.finger import _core
from softgrip_model.finger.design import Finger, core_design, core_friction
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.kernel import Array, Control, Status
from softgrip_model.friction.laws import FrictionLaw

_JOINT_LIMIT, _PLANE, _CIRCLE = range(3)
_CONTROL_INDEX = {Control.PULLED_LENGTH: 0, Control.TENSION: 1}


@dataclass(frozen=True)
class JointLimit:
    """An object that keeps a joint from closing further than `angle_rad`; its force is a moment [N mm]."""

    joint: int
    angle_rad: float


@dataclass(frozen=True)
class Plane:
    """A plane that a point of the finger stays in front of: in the base frame, normal dot point >= offset.

    Attributes:
        normal: unit, towards the free side.
        offset_mm: of the plane along its normal.
        link: that carries the point; None = the last.
        along_mm: from the link's joint to the point; None = the link's end (the fingertip for the last).
    """

    normal: tuple[float, float]
    offset_mm: float
    link: int | None = None
    along_mm: float | None = None


@dataclass(frozen=True)
class Cylinder:
    """A cylinder across the finger's plane that a point of the finger stays outside of.

    Attributes:
        centre_mm: in the base frame.
        radius_mm: add the finger's own radius at the point.
        link, along_mm: as for `Plane`.
    """

    centre_mm: tuple[float, float]
    radius_mm: float
    link: int | None = None
    along_mm: float | None = None


def sphere(
    centre_mm: tuple[float, float, float], radius_mm: float, link: int | None = None, along_mm: float | None = None
) -> Cylinder:
    """Return a sphere as the finger's plane cuts it: a cylinder.

    Args:
        centre_mm: x, y in the finger's plane, and the distance from that plane.
        radius_mm: of the sphere.
        link: as in `Cylinder`.
        along_mm: as in `Cylinder`.

    Raises:
        FingerError: the sphere does not reach the plane.
    """
    if abs(centre_mm[2]) >= radius_mm:
        raise FingerError(f"expected a sphere that reaches the finger's plane, found its centre {centre_mm[2]} mm off")
    return Cylinder((centre_mm[0], centre_mm[1]), math.sqrt(radius_mm**2 - centre_mm[2] ** 2), link, along_mm)


Contact = JointLimit | Plane | Cylinder


@dataclass(frozen=True)
class PathSettings:
    """Steps of the path.

    Attributes:
        largest_pull_step_mm, largest_tension_step_n: longer ways are taken in pieces.
        min_compliance_per_n: 1/EA given to an inextensible cable: it decides how the tension divides between two
            bends that are both stuck.
    """

    largest_pull_step_mm: float = 0.25
    largest_tension_step_n: float = 0.5
    min_compliance_per_n: float = 1e-6


@dataclass(frozen=True, eq=False)
class Path:
    """States along a path; K targets, n joints, C contacts. A failed step is NaN and leaves the path where it was.

    Attributes:
        angle_rad: (K, n).
        tension_n: (K, 2 n + 1), span by span from the actuator.
        tip_mm: (K, 2).
        pulled_mm: (K,).
        slip_mm: (K, 2 n), cable that has passed each routing point towards the actuator.
        slide: (K, 2 n), 1 pulled through, 0 stuck, -1 let back.
        contact_force: (K, C) [N], [N mm] for a joint limit; never negative.
        gap: (K, C) [mm], [rad] for a joint limit.
        status: (K,), bits of `Status`.
        iterations: (K,).
    """

    angle_rad: Array
    tension_n: Array
    tip_mm: Array
    pulled_mm: Array
    slip_mm: Array
    slide: NDArray[np.int8]
    contact_force: Array
    gap: Array
    status: NDArray[np.uint32]
    iterations: NDArray[np.int32]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Where there are no numbers, (K,)."""
        return np.asarray((self.status & Status.FAILURE) != 0)


def follow(
    finger: Finger,
    law: FrictionLaw,
    targets: ArrayLike,
    control: Control = Control.PULLED_LENGTH,
    *,
    contacts: Sequence[Contact] = (),
    settings: PathSettings = PathSettings(),
) -> Path:
    """Follow targets from the slack finger.

    Args:
        finger: the design.
        law: friction, the same in both directions.
        targets: (K,) pulled lengths [mm] or actuator tensions [N], in the order they are gone through; 0 slackens the
            cable and forgets the path.
        control: PULLED_LENGTH or TENSION.
        contacts: what is in the way, at most 8.
        settings: steps.

    Raises:
        FingerError: another control, targets of another shape, a contact that it does not have.
    """
    requested = np.asarray(targets, dtype=np.float64)
    if requested.ndim != 1 or control not in _CONTROL_INDEX:
        raise FingerError(f"expected targets (K,) of pulled length or tension, found {requested.shape} of {control}")
    if not (settings.largest_pull_step_mm > 0 and settings.largest_tension_step_n > 0):
        raise FingerError(f"expected steps > 0, found {settings}")
    try:
        result = _core.follow(
            core_design(finger),
            core_friction(law),
            requested.tolist(),
            _CONTROL_INDEX[control],
            [_core_contact(finger, contact) for contact in contacts],
            _core.PathSettings(
                settings.largest_pull_step_mm, settings.largest_tension_step_n, settings.min_compliance_per_n
            ),
        )
    except ValueError as error:
        raise FingerError(str(error)) from error
    return Path(**result)


def _core_contact(finger: Finger, contact: Contact) -> _core.Contact:
    if isinstance(contact, JointLimit):
        if not 0 <= contact.joint < finger.joints:
            raise FingerError(f"expected a joint 0..{finger.joints - 1}, found {contact.joint}")
        return _core.Contact(
            kind=_JOINT_LIMIT,
            index=contact.joint,
            along_mm=0.0,
            limit_rad=contact.angle_rad,
            x_mm=0.0,
            y_mm=0.0,
            size_mm=0.0,
        )
    link = finger.joints - 1 if contact.link is None else contact.link
    if not 0 <= link < finger.joints:
        raise FingerError(f"expected a link 0..{finger.joints - 1}, found {link}")
    along = finger.link_mm[link] if contact.along_mm is None else contact.along_mm
    x, y = contact.normal if isinstance(contact, Plane) else contact.centre_mm
    if isinstance(contact, Plane) and abs(math.hypot(x, y) - 1.0) > 1e-9:
        raise FingerError(f"expected a normal of length 1, found {contact.normal}")
    return _core.Contact(
        kind=_PLANE if isinstance(contact, Plane) else _CIRCLE,
        index=link,
        along_mm=along,
        limit_rad=0.0,
        x_mm=x,
        y_mm=y,
        size_mm=contact.offset_mm if isinstance(contact, Plane) else contact.radius_mm,
    )
