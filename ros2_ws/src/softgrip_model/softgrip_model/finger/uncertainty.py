# SPDX-License-Identifier: Apache-2.0
"""What a prediction of a finger does not know, as standard deviations before anything was seen of it.

docs/finger.md, "How far to trust a prediction", names the source of each number.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.design import Finger
from softgrip_model.friction.laws import FrictionLaw, Law

Array = NDArray[np.float64]

#: [mm] pulled lengths at which the model's error is a number of its own; in between it is interpolated.
MODEL_KNOTS_MM = (5.0, 10.0, 15.0, 20.0)

#: [mm] pulled lengths at which the tension's common error is a number of its own; in between it is interpolated.
TENSION_KNOTS_MM = (0.0, 5.0, 10.0, 15.0, 20.0)

#: Coefficients that a factor on ln Rf multiplies.
SCALED_COEFFICIENTS = {Law.CAPSTAN: (1.0,), Law.HEAP: (1.0, 0.0), Law.MATTE: (1.0, 0.0, 1.0, 1.0)}

#: A deviation of a cause is looked for up to so many standard deviations.
MAX_DEVIATION = 3.0

#: [1/N] 1/EA of an inextensible cable whose stretch is put into what leads to the finger: 3e-6 mm in it by 30 N.
_HARDLY_GIVES_PER_N = 1e-9


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations; by default those that sources state.

    Attributes:
        friction: factor on ln Rf, of a finger's channel beside the rig's strip; the fit's covariance comes on top.
        stiffness: factor on all moduli.
        thickness_mm, routing_mm: of each strip and routing point, as printed.
        zero_mm: of the pulled length's zero.
        spool: factor on pulled lengths.
        tension_gain: factor on measured tensions.
        camera_mm, camera_scale, camera_turn_rad: of the plane that tips are measured in.
        stretch_mm_per_n: pulled length that the cable's own stretch takes beside the profile's, per tension at the
            actuator; in all it is never less than nothing.
        room_mm: of how far a pulled cable lies outside its routing points, beside what is expected.
        room_share: of the room that its holes leave a cable, which a pulled one is expected to take.
        model: error of the tip at full closing, as a share of the finger's length, along x and y.
        scatter_mm: pulled length by which one closing differs from the next.
        tip_noise_mm: of one measured tip.
        tension_error_n: of measured beside predicted tensions, which all closings share: how warm a motor's winding is
            moves slowly, and what the kernel does not know of a finger stays.
        tension_noise, tension_floor_n: of one measured tension: relative, and what is added.
        memory: share of what was learnt that the next closing still believes.
    """

    friction: float = 0.10
    stiffness: float = 0.10
    thickness_mm: float = 0.10
    routing_mm: float = 0.10
    zero_mm: float = 0.20
    spool: float = 0.005
    tension_gain: float = 0.10
    camera_mm: float = 0.20
    camera_scale: float = 0.002
    camera_turn_rad: float = 0.003
    stretch_mm_per_n: float = 0.06
    room_mm: float = 0.15
    room_share: float = 1.0
    model: float = 0.010
    scatter_mm: float = 0.03
    tip_noise_mm: float = 0.5
    tension_error_n: float = 0.4
    tension_noise: float = 0.05
    tension_floor_n: float = 0.05
    memory: float = 0.99


#: What sources say (docs/finger.md).
STATED = Uncertainty()

#: The same as the first closings of 31 fingers of the emulated cell corrected it (benchmarks/finger/tip_tolerances.py).
PRIOR = Uncertainty(
    friction=0.07,
    stiffness=0.085,
    thickness_mm=0.06,
    routing_mm=0.06,
    zero_mm=0.15,
    stretch_mm_per_n=0.025,
    room_mm=0.07,
    room_share=0.93,
    model=0.0055,
)


@dataclass(frozen=True, eq=False)
class Causes:
    """Everything that may differ from what is believed of a finger, in standard deviations of `Uncertainty`.

    The vector runs over the friction's coefficients (along the axes of their covariance), the friction factor, the
    moduli, thicknesses, routing points, zero, spool, tension gain, camera (x, y, scale, turn), the cable's stretch, its
    room in the holes, the model's error at its knots (x, then y), and the tension's error at its knots.
    """

    finger: Finger
    law: FrictionLaw
    covariance: Array | None
    prior: Uncertainty
    room_mm: tuple[float, ...] = ()
    """(2 n): how far from each routing point its hole lets the cable go; empty: nowhere."""
    coefficients: Array = field(init=False)
    """(p, p): coefficients per standard deviation, column by column."""

    def __post_init__(self) -> None:
        count = len(self.law.coefficients)
        axes = np.zeros((count, count))
        if self.covariance is not None:
            values, vectors = np.linalg.eigh(self.covariance)
            axes = vectors * np.sqrt(np.maximum(values, 0.0))
        object.__setattr__(self, "coefficients", axes)

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each component."""
        n, knots = self.finger.joints, [f"{knot:g} mm" for knot in MODEL_KNOTS_MM]
        return (
            *(f"friction coefficient {i}" for i in range(len(self.law.coefficients))),
            "friction",
            "stiffness",
            *(f"thickness {j}" for j in range(n)),
            *(f"routing {i}" for i in range(2 * n)),
            "zero",
            "spool",
            "tension gain",
            "camera x",
            "camera y",
            "camera scale",
            "camera turn",
            "cable's stretch",
            "cable's room",
            *(f"model x at {knot}" for knot in knots),
            *(f"model y at {knot}" for knot in knots),
            *(f"tension at {knot:g} mm" for knot in TENSION_KNOTS_MM),
        )

    @property
    def zero(self) -> int:
        """Where the zero stands; spool, tension gain and camera follow."""
        return self.factor + 2 + 3 * self.finger.joints

    @property
    def tension(self) -> slice:
        """Where the tension's errors stand."""
        return slice(self.room + 1 + 2 * len(MODEL_KNOTS_MM), len(self.names))

    @property
    def stretch(self) -> int:
        """Where the cable's stretch stands; its room follows."""
        return self.zero + 7

    @property
    def room(self) -> int:
        """Where the cable's room stands; the model's errors follow."""
        return self.stretch + 1

    def changed_finger(self, z: Array) -> Finger:
        """Return the finger with the deviations z."""
        finger, prior, n, start = self.finger, self.prior, self.finger.joints, len(self.law.coefficients) + 1
        factor = 1.0 + prior.stiffness * z[start]
        a, b, c = (factor * modulus for modulus in finger.strip.modulus_mpa)
        thickness = np.array(finger.thickness_mm) + prior.thickness_mm * z[start + 1 : start + 1 + n]
        routing = np.array(finger.routing_mm) + prior.routing_mm * z[start + 1 + n : start + 1 + 3 * n]
        # a pulled cable takes the shortest way: it lies on the side of its holes that a closing finger bends towards
        routing += prior.room_share * np.array(self.room_mm or 0.0) + prior.room_mm * z[self.room]
        changed = dataclasses.replace(finger, strip=dataclasses.replace(finger.strip, modulus_mpa=(a, b, c)))
        stretch = prior.stretch_mm_per_n * max(z[self.stretch], self._min_stretch)
        if stretch:
            give = finger.compliance_per_n or _HARDLY_GIVES_PER_N
            changed = dataclasses.replace(changed, compliance_per_n=give, lead_mm=finger.lead_mm + stretch / give)
        return changed.with_design(thickness, routing)

    @property
    def _min_stretch(self) -> float:
        """Deviation of a cable that leads to the finger without any stretch: none gets shorter when it is pulled."""
        stretch_mm_per_n = self.finger.compliance_per_n * self.finger.lead_mm
        return -stretch_mm_per_n / self.prior.stretch_mm_per_n if stretch_mm_per_n else 0.0

    @functools.cached_property
    def expected(self) -> tuple[Array, Array]:
        """Mean (N,) and covariance (N, N) of the deviations before anything was seen.

        N(0, 1) each; the cable's stretch has the moments of what of N(0, 1) lies above its least.
        """
        mean, covariance = np.zeros(len(self.names)), np.eye(len(self.names))
        lowest = self._min_stretch
        above = math.exp(-0.5 * lowest**2) / math.sqrt(0.5 * math.pi) / math.erfc(lowest / math.sqrt(2.0))
        mean[self.stretch] = above
        covariance[self.stretch, self.stretch] = 1.0 - above * (above - lowest)
        return mean, covariance

    def bounded(self, z: Array, covariance: Array) -> Array:
        """Return the likeliest deviations in their bounds, where z (N,) with a covariance (N, N) is the likeliest."""
        place, short = self.stretch, self._min_stretch - z[self.stretch]
        if short > 0.0:
            z = z + covariance[:, place] / covariance[place, place] * short
        return np.clip(z, -MAX_DEVIATION, MAX_DEVIATION)

    def changed_law(self, z: Array) -> FrictionLaw:
        """Return the friction with the deviations z.

        Raises:
            LawError: coefficients outside the law's domain.
        """
        return self.law.with_coefficients(self._moved(z) * (1.0 + self.prior.friction * z[self.factor] * self._scaled))

    def law_slopes(self, z: Array) -> Array:
        """Return the changed law's coefficients per standard deviation of the first components, (p, p + 1)."""
        axes = self.coefficients * (1.0 + self.prior.friction * z[self.factor] * self._scaled)[:, None]
        return np.column_stack([axes, self.prior.friction * self._scaled * self._moved(z)])

    @property
    def factor(self) -> int:
        """Where the friction factor stands; stiffness, thicknesses and routing points follow."""
        return len(self.law.coefficients)

    @property
    def _scaled(self) -> Array:
        return np.array(SCALED_COEFFICIENTS[self.law.law])

    def _moved(self, z: Array) -> Array:
        return np.array(self.law.coefficients) + self.coefficients @ z[: self.factor]

    def changed_pull_mm(self, z: Array, pulled_mm: Array) -> Array:
        """Return what is truly pulled where `pulled_mm` is read."""
        zero = self.zero
        return np.asarray(pulled_mm * (1.0 + self.prior.spool * z[zero + 1]) + self.prior.zero_mm * z[zero])

    def model_weights(self, pulled_mm: Array) -> Array:
        """Return what the model's errors at its knots [standard deviations] add to a tip coordinate [mm], (K, knots).

        The error grows with the pulled length up to the last knot.
        """
        knots = np.array((0.0, *MODEL_KNOTS_MM))
        hats = np.array([np.interp(pulled_mm, knots, row) for row in np.eye(len(knots))[1:]]).T
        full = self.prior.model * self.finger.length_from_joint_mm
        return np.asarray(full * hats * (knots[1:] / knots[-1]))

    def tension_weights(self, pulled_mm: Array) -> Array:
        """Return what the tension's errors at its knots [standard deviations] add to a tension [N], (K, knots)."""
        hats = [np.interp(pulled_mm, TENSION_KNOTS_MM, row) for row in np.eye(len(TENSION_KNOTS_MM))]
        return np.asarray(self.prior.tension_error_n * np.array(hats).T)
