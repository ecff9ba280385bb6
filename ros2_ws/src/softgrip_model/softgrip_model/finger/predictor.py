# SPDX-License-Identifier: Apache-2.0
"""What the mounted fingers should be doing: joint angles, tip and tensions with standard deviations, in SI units."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.digest import text_digest
from softgrip_model.finger.design import Finger, JointModel
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.flexure import FLEXURE_STUDY
from softgrip_model.finger.kernel import Kernel, Solution, Status, reason
from softgrip_model.finger.learning import Knowledge
from softgrip_model.finger.uncertainty import Causes, Uncertainty
from softgrip_model.friction.acceptance import model_digest
from softgrip_model.friction.errors import ModelFileError
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.friction.published import published
from softgrip_model.profile import Profile, digest

Array = NDArray[np.float64]

#: [m/s] A cable that is let out faster than this is not being pulled: the prediction says so.
PAYING_OUT = 5e-4

#: [m] Radius of the cable's holes as `parts` draws them at the narrowest (docs/parts.md), where a profile does not say.
DRAWN_HOLE_M = 0.6e-3

#: Plain numbers: bit operations on an enum's members are slow, and every reading needs some.
_FAILURE, _SLACK = int(Status.FAILURE), int(Status.SLACK)
_DOUBTFUL = int(Status.EXTRAPOLATED | Status.REVERSING)


class Validity(IntEnum):
    """How far to trust a prediction."""

    OK = 0
    EXTRAPOLATED = 1
    FAILED = 2


@dataclass(frozen=True, eq=False)
class ActiveFriction:
    """A friction law with its name and what is known about its coefficients (p of them)."""

    id: str
    law: FrictionLaw
    covariance: Array | None = None
    """(p, p); None when unknown."""
    digest: str = ""
    """Of all its numbers (`acceptance.model_digest`); two models with the same one predict the same."""


@dataclass(frozen=True)
class TendonReading:
    """One tendon at one instant."""

    finger: str
    pulled_length_m: float
    """[m]"""
    velocity: float = 0.0
    """[m/s], + closes; NaN when unknown."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One finger, n joints; lengths in m unless named otherwise. Numbers are NaN when it failed."""

    finger: str
    profile: str
    pulled_length_m: float
    joint_angles: Array
    """(n,) [rad]"""
    joint_angles_stddev: Array | None
    """(n,) [rad]; None when the friction's covariance is unknown."""
    tip_mm: tuple[float, float]
    """[mm] in the finger's base frame, as the kernel has it."""
    tip_stddev: tuple[float, float]
    """[m]; NaN when unknown."""
    tensions: Array
    """(2 n + 1,) [N], span by span from the actuator to the tip."""
    validity: Validity
    reason: str

    @property
    def tip(self) -> tuple[float, float]:
        """[m] in the finger's base frame."""
        return 1e-3 * self.tip_mm[0], 1e-3 * self.tip_mm[1]

    @property
    def tension(self) -> float:
        """[N] at the actuator."""
        return float(self.tensions[0])


def assumed_friction(profile: Profile) -> ActiveFriction:
    """Return the friction that a profile is computed with until a calibrated model is active.

    Raises:
        FingerError: the profile names a model that was not published.
    """
    try:
        model = published(profile.friction_id)
    except ModelFileError as error:
        raise FingerError(f"profile {profile.id!r}: friction_id: {error}") from error
    digest = model_digest(model.law, model.covariance, model.cable_radius_m, model.surface_radius_m)
    return ActiveFriction(model.id, model.law, model.covariance, digest)


def room_mm(profile: Profile, slot: str) -> tuple[float, ...]:
    """Return how far the holes of a profile's finger let its cable go along the flanks [mm], (2 n).

    A round hole across the cable is cut by a flank at half its groove's opening (thesis 3.2.2, "Cable contact").

    Raises:
        ProfileError: the profile has none for that slot.
    """
    design, cable = profile.finger(slot), profile.cable
    hole_m = DRAWN_HOLE_M if cable.hole_radius_m is None else cable.hole_radius_m
    rooms = [1e3 * max(0.0, hole_m / math.cos(0.5 * opening) - cable.radius_m) for opening in design.openings_rad]
    return tuple(room for room in rooms for _ in range(2))


class Configuration:
    """Which finger of which profile sits in which slot, under which friction; immutable once made."""

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        mounted: Mapping[str, str],
        friction: ActiveFriction | None,
        joint_model: JointModel = JointModel.FLEXURE,
    ) -> None:
        """Prepare the mounted fingers.

        Args:
            profiles: by id.
            mounted: slot -> profile id.
            friction: None = each profile's own.
            joint_model: how the fingers are computed.

        Raises:
            FingerError: an unknown profile id or friction id.
            ProfileError: a profile without a finger for the slot.
        """
        self.mounted = dict(mounted)
        self.friction = friction
        self.joint_model = joint_model
        self.fingers: dict[str, Finger] = {}
        self._own: dict[str, ActiveFriction] = {}
        self._room_mm: dict[str, tuple[float, ...]] = {}
        # what was recorded before there was a choice names hinges by saying nothing
        parts = [] if joint_model is JointModel.HINGE else [f"joint_model={joint_model}:{FLEXURE_STUDY}"]
        for slot, profile_id in sorted(mounted.items()):
            profile = profiles.get(profile_id)
            if profile is None:
                known = ", ".join(sorted(profiles)) or "none"
                raise FingerError(f"slot {slot!r}: unknown profile {profile_id!r}; loaded: {known}")
            self.fingers[slot] = Finger.from_profile(profile, slot, joint_model)
            self._own[slot] = assumed_friction(profile)
            self._room_mm[slot] = room_mm(profile, slot)
            parts.append(f"{slot}={profile_id}:{digest(profile)}")
        self.digest = text_digest(";".join(parts))
        """Changes when anything but the friction does."""
        self._kernels: dict[tuple[str, ...], Kernel] = {}
        # what was asked for last and the answer, by slots: fingers stand still most of the time
        self._newest: dict[tuple[str, ...], tuple[object, list[Prediction]]] = {}

    @property
    def friction_id(self) -> str:
        """Name of the friction in use; several, when profiles bring their own."""
        if self.friction is not None:
            return self.friction.id
        return ",".join(sorted({own.id for own in self._own.values()}))

    @property
    def friction_digest(self) -> str:
        """Digest of the friction in use; several, when profiles bring their own."""
        if self.friction is not None:
            return self.friction.digest
        return ",".join(sorted({own.digest for own in self._own.values()}))

    def friction_of(self, slot: str) -> ActiveFriction:
        """Return what is assumed for a slot."""
        return self.friction or self._own[slot]

    def predict(self, readings: Sequence[TendonReading], known: Mapping[str, Knowledge] = {}) -> list[Prediction]:
        """Predict every mounted finger that has a reading: a pure function of configuration, readings and knowledge.

        Readings of slots where nothing is mounted are left out.

        Args:
            readings: of the tendons.
            known: of fingers, slot -> what joint angles and tip are predicted with; of others the friction's
                covariance alone is known.
        """
        mounted = [reading for reading in readings if reading.finger in self.fingers]
        if not mounted:
            return []
        slots = tuple(reading.finger for reading in mounted)
        question = [
            (reading.pulled_length_m, _is_paying_out(reading), known.get(reading.finger)) for reading in mounted
        ]
        newest = self._newest.get(slots)
        if newest is None or newest[0] != question:
            newest = self._newest[slots] = question, self._predict(mounted, known)
        return newest[1].copy()

    def _predict(self, mounted: Sequence[TendonReading], known: Mapping[str, Knowledge]) -> list[Prediction]:
        kernel = self._kernel(tuple(reading.finger for reading in mounted))
        targets = np.array([[1e3 * reading.pulled_length_m] for reading in mounted])
        solution = kernel.solve(targets, march=False, gradient=True, threads=1)
        predicted = [self._prediction(reading, solution, i, 0) for i, reading in enumerate(mounted)]
        return [_as_known(one, known.get(one.finger)) for one in predicted]

    def closing(self, slot: str, pulled_lengths: Sequence[float], known: Knowledge | None = None) -> list[Prediction]:
        """Predict one finger at several pulled lengths [m], with what is known of it.

        Raises:
            FingerError: nothing is mounted in that slot.
        """
        if slot not in self.fingers:
            raise FingerError(f"no finger in slot {slot!r}; mounted: {', '.join(self.fingers) or 'none'}")
        lengths = [float(length) for length in pulled_lengths]
        solution = self._kernel((slot,)).solve(1e3 * np.array([lengths]), march=False, gradient=True, threads=1)
        predicted = [self._prediction(TendonReading(slot, length), solution, 0, k) for k, length in enumerate(lengths)]
        return [_as_known(one, known) for one in predicted]

    def causes(self, slot: str, prior: Uncertainty) -> Causes:
        """Return what a mounted finger may differ in."""
        friction = self.friction_of(slot)
        return Causes(self.fingers[slot], friction.law, friction.covariance, prior, self._room_mm[slot])

    def solve(self, slot: str, pulled_length_m: float) -> Solution:
        """Return the kernel's own answer (mm) for one finger at one pulled length [m]."""
        return self._kernel((slot,)).solve([1e3 * pulled_length_m], march=False, threads=1)

    def _kernel(self, slots: tuple[str, ...]) -> Kernel:
        if slots not in self._kernels:
            laws = [self.friction_of(slot).law for slot in slots]
            self._kernels[slots] = Kernel([self.fingers[slot] for slot in slots], laws)
        return self._kernels[slots]

    def _prediction(self, reading: TendonReading, solution: Solution, i: int, k: int) -> Prediction:
        finger = self.fingers[reading.finger]
        n = finger.joints
        status = int(solution.status[i, k])
        stddev = self._stddev(reading.finger, solution, i, k)
        validity, why = _trust(status, reading)
        x_mm, y_mm = solution.tip_mm[i, k].tolist()
        sx_mm, sy_mm = (math.nan, math.nan) if stddev is None else stddev[-5:-3].tolist()
        return Prediction(
            finger=reading.finger,
            profile=self.mounted[reading.finger],
            pulled_length_m=reading.pulled_length_m,
            joint_angles=solution.angle_rad[i, k, :n],
            joint_angles_stddev=None if stddev is None else stddev[:n],
            tip_mm=(x_mm, y_mm),
            tip_stddev=(1e-3 * sx_mm, 1e-3 * sy_mm),
            tensions=solution.tension_n[i, k, : 2 * n + 1],
            validity=validity,
            reason=why,
        )

    def _stddev(self, slot: str, solution: Solution, i: int, k: int) -> Array | None:
        """Standard deviation of every row of the gradient that the friction's covariance causes."""
        covariance = self.friction_of(slot).covariance
        if covariance is None or solution.gradient is None:
            return None
        if int(solution.status[i, k]) & _SLACK:
            return np.zeros(solution.gradient.values.shape[2])
        slopes = solution.gradient.friction[i, k]
        variance = ((slopes @ covariance) * slopes).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _as_known(prediction: Prediction, known: Knowledge | None) -> Prediction:
    """Return joint angles and tip as a finger is known; tensions stay those of the profile's finger.

    The cell keeps tables of tensions beside the profile's (docs/cell.md), which must not move under it.
    """
    if known is None or prediction.validity is Validity.FAILED:
        return prediction
    found = known.predict(np.array([1e3 * prediction.pulled_length_m]))
    if found is None:
        why = "; ".join(filter(None, (prediction.reason, "no equilibrium of the finger as it is known")))
        return dataclasses.replace(prediction, validity=Validity.EXTRAPOLATED, reason=why)
    x_mm, y_mm = found.tip_mm[0].tolist()
    sx_mm, sy_mm = found.tip_stddev_mm[0].tolist()
    return dataclasses.replace(
        prediction,
        joint_angles=found.angle_rad[0],
        joint_angles_stddev=found.angle_stddev_rad[0],
        tip_mm=(x_mm, y_mm),
        tip_stddev=(1e-3 * sx_mm, 1e-3 * sy_mm),
    )


def _is_paying_out(reading: TendonReading) -> bool:
    return reading.velocity < -PAYING_OUT


def _trust(status: int, reading: TendonReading) -> tuple[Validity, str]:
    why = reason(status & ~_SLACK)
    if status & _FAILURE:
        return Validity.FAILED, why
    if _is_paying_out(reading):
        paid_out = "cable is being let out; predicted as if pulled"
        return Validity.EXTRAPOLATED, f"{why}; {paid_out}" if why else paid_out
    return (Validity.EXTRAPOLATED if status & _DOUBTFUL else Validity.OK), why
