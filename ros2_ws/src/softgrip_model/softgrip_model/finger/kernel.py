# SPDX-License-Identifier: Apache-2.0
"""Equilibria of fingers whose cable is being pulled (modes F and P): the compiled kernel behind numpy arrays."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag, StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.finger import _core
from softgrip_model.finger.design import Finger, core_design, core_friction
from softgrip_model.finger.errors import FingerError
from softgrip_model.friction.laws import COEFFICIENT_NAMES, FrictionLaw

Array = NDArray[np.float64]


class Control(StrEnum):
    """What is prescribed: pulled length [mm], actuator tension [N] or sum of the joint angles [rad]."""

    PULLED_LENGTH = "pulled_length"
    TENSION = "tension"
    DEFLECTION = "deflection"


_CONTROL_INDEX = {control: index for index, control in enumerate(Control)}


class Status(IntFlag):
    """What to know about one element; the bits of FAILURE come with NaN, the others with numbers."""

    OK = 0
    BAD_DESIGN = 1 << 0
    BAD_FRICTION = 1 << 1
    BAD_TARGET = 1 << 2
    FRICTION_BLOW_UP = 1 << 3
    NOT_CONVERGED = 1 << 4
    OUT_OF_REACH = 1 << 5
    FAILURE = (1 << 8) - 1
    REVERSING = 1 << 8
    STOP_ENGAGED = 1 << 9
    STRAIN_OUTSIDE = 1 << 10
    TENSION_OUTSIDE = 1 << 11
    ANGLE_OUTSIDE = 1 << 12
    SLACK = 1 << 13
    FLEXURE_OUTSIDE = 1 << 14
    SNAPPED = 1 << 15
    EXTRAPOLATED = STRAIN_OUTSIDE | TENSION_OUTSIDE | ANGLE_OUTSIDE | FLEXURE_OUTSIDE


_REASONS: dict[int, str] = {
    int(Status.BAD_DESIGN): "impossible geometry or material",
    int(Status.BAD_FRICTION): "friction coefficients outside the law's domain",
    int(Status.BAD_TARGET): "the prescribed quantity is not a number that can be reached",
    int(Status.FRICTION_BLOW_UP): "the friction law has no value at these angles and tensions",
    int(Status.NOT_CONVERGED): "no equilibrium found",
    int(Status.OUT_OF_REACH): "pulled further than the closed grooves leave",
    int(Status.REVERSING): "the cable runs backwards at a joint while pulling",
    int(Status.STOP_ENGAGED): "a groove is closing on its stop",
    int(Status.STRAIN_OUTSIDE): "strain beyond the measured modulus",
    int(Status.TENSION_OUTSIDE): "tension outside the friction calibration",
    int(Status.ANGLE_OUTSIDE): "wrap angle above the friction calibration",
    int(Status.SLACK): "cable slack",
    int(Status.FLEXURE_OUTSIDE): "thickness, routing, length, width, depth, opening or Poisson's ratio outside what "
    "mode F was compared with CalculiX on",
    int(Status.SNAPPED): "no equilibrium nearby was left: the finger jumped off or along an object",
}


def reason(status: int) -> str:
    """Return a status in words; empty for OK."""
    plain = int(status)
    return "; ".join(text for bit, text in _REASONS.items() if plain & bit)


@dataclass(frozen=True, eq=False)
class Gradient:
    """Exact derivatives of a solution; M designs, K targets, n joints.

    Rows: n joint angles [rad], tip x, tip y [mm], actuator tension, tip tension [N], pulled length [mm].
    """

    values: Array
    """(M, K, n + 5, columns)."""
    joints: int
    coefficients: tuple[str, ...]

    @property
    def target(self) -> Array:
        """To the prescribed quantity, (M, K, n + 5)."""
        return self.values[..., 0]

    @property
    def thickness(self) -> Array:
        """To h [per mm], (M, K, n + 5, n)."""
        return self.values[..., 1 : 1 + self.joints]

    @property
    def routing(self) -> Array:
        """To r [per mm], (M, K, n + 5, 2 n)."""
        return self.values[..., 1 + self.joints : 1 + 3 * self.joints]

    @property
    def friction(self) -> Array:
        """To the law's coefficients in their order, (M, K, n + 5, number of coefficients)."""
        return self.values[..., 1 + 3 * self.joints : -1]

    @property
    def stiffness(self) -> Array:
        """To a factor on all moduli, (M, K, n + 5)."""
        return self.values[..., -1]


@dataclass(frozen=True, eq=False)
class Solution:
    """Equilibria; M designs, K targets, n joints (of the widest design; what a narrower one lacks is NaN).

    Attributes:
        angle_rad: (M, K, n).
        tension_n: (M, K, 2 n + 1), span by span: actuator to point 0, ..., across groove j at 2 j + 1, ..., tip span.
        tip_mm: (M, K, 2), x along the straight finger, closing towards -y.
        pulled_mm: (M, K).
        phi_rad: (M, K, 2 n), signed bend of the cable at each routing point.
        pull_rate: (M, K, n), cable taken in at joint j and beyond per cable pulled; negative where it runs backwards.
        status: (M, K), bits of `Status`.
        iterations: (M, K), Newton steps.
        gradient: None unless asked for.
    """

    angle_rad: Array
    tension_n: Array
    tip_mm: Array
    pulled_mm: Array
    phi_rad: Array
    pull_rate: Array
    status: NDArray[np.uint32]
    iterations: NDArray[np.int32]
    gradient: Gradient | None

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Where there are no numbers, (M, K)."""
        return np.asarray((self.status & Status.FAILURE) != 0)

    @property
    def actuator_tension_n(self) -> Array:
        """(M, K)."""
        return self.tension_n[..., 0]


class Kernel:
    """Fingers with their friction laws, prepared once and solved together. Immutable; safe to share between threads."""

    def __init__(self, fingers: Sequence[Finger], laws: FrictionLaw | Sequence[FrictionLaw]) -> None:
        """Prepare M fingers.

        Args:
            fingers: at least one; joint counts may differ.
            laws: one for all, or one each.

        Raises:
            FingerError: no finger, or as many laws as there are no fingers.
        """
        law_list = [laws] * len(fingers) if isinstance(laws, FrictionLaw) else list(laws)
        if not fingers or len(law_list) != len(fingers):
            raise FingerError(f"expected one friction law per finger, found {len(law_list)} for {len(fingers)}")
        self._laws = law_list
        self._core = _core.Fingers([core_design(f) for f in fingers], [core_friction(law) for law in law_list])

    def __len__(self) -> int:
        return len(self._core)

    @property
    def joints(self) -> int:
        """Joints of the widest finger."""
        return self._core.joints

    def varied(self, thickness_mm: ArrayLike, routing_mm: ArrayLike) -> Kernel:
        """Return a kernel with the first finger in other designs.

        Args:
            thickness_mm: (M, n).
            routing_mm: (M, 2 n).

        Raises:
            FingerError: other shapes. Impossible values are reported per element when solving.
        """
        thickness = np.atleast_2d(np.asarray(thickness_mm, dtype=np.float64))
        routing = np.atleast_2d(np.asarray(routing_mm, dtype=np.float64))
        other = object.__new__(Kernel)
        other._laws = self._laws[:1]
        try:
            other._core = self._core.varied(thickness, routing)
        except ValueError as error:
            raise FingerError(f"{error}; found {thickness.shape} and {routing.shape}") from error
        return other

    def solve(
        self,
        targets: ArrayLike,
        control: Control = Control.PULLED_LENGTH,
        *,
        march: bool = True,
        gradient: bool = False,
        threads: int | None = None,
    ) -> Solution:
        """Find the equilibrium of every finger at every target.

        Args:
            targets: (K,) for all fingers or (M, K) [mm, N or rad by `control`]; 0 or less is a slack cable.
            control: what the targets prescribe.
            march: start each target where the ones before lead (fast for a closing); False solves each from nothing, so
                that a result depends on its own target alone.
            gradient: also the exact derivatives; all laws must then be of one kind.
            threads: None = one per core.

        Raises:
            FingerError: targets of another shape.
        """
        requested = np.asarray(targets, dtype=np.float64)
        if requested.ndim < 2:
            requested = requested.reshape(1, -1)
            if len(self) > 1:
                requested = np.broadcast_to(requested, (len(self), requested.size))
        if gradient and len({law.law for law in self._laws}) > 1:
            raise FingerError("gradients need friction laws of one kind; solve each kind in its own kernel")
        try:
            result = self._core.solve(
                np.ascontiguousarray(requested),
                _CONTROL_INDEX[control],
                march,
                gradient,
                threads or os.cpu_count() or 1,
            )
        except ValueError as error:
            raise FingerError(f"{error}; found {requested.shape} for {len(self)} fingers") from error
        values = result.pop("gradient", None)
        names = COEFFICIENT_NAMES[self._laws[0].law]
        return Solution(**result, gradient=None if values is None else Gradient(values, self.joints, names))


def close(
    finger: Finger, law: FrictionLaw, pulled_mm: ArrayLike, *, gradient: bool = False, march: bool = True
) -> Solution:
    """Close one finger: find its equilibrium at each pulled length of its tendon.

    Args:
        finger: the finger; `Finger.from_profile` makes it of a profile.
        law: how the cable rubs: a fitted model's ``law``, a published one, or `FRICTIONLESS`.
        pulled_mm: (K,) pulled lengths [mm]; 0 or less is a slack cable.
        gradient: also the exact derivatives to thickness, routing, friction and modulus.
        march: start each length where the ones before lead; False solves each from nothing.

    Returns:
        Joint angles, tensions and tips; its first axis counts designs and has one entry, its second the K lengths.
        Where there is no equilibrium, `Solution.failed` is set and `reason` has the words.

    Raises:
        FingerError: pulled lengths of another shape.
    """
    return Kernel([finger], law).solve(pulled_mm, gradient=gradient, march=march, threads=1)
