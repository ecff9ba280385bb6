# SPDX-License-Identifier: Apache-2.0
"""The predictor without ROS: what it knows from the messages received so far, and what follows from the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softgrip_model.finger.active_configuration import ActiveConfiguration, Timeline
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.design import JointModel
from softgrip_model.finger.diagnosis import WATCH, WATCHED, CauseWatch, WatchSettings
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.learning import FingerLearner, Knowledge
from softgrip_model.finger.matching import Matcher, TendonInput
from softgrip_model.finger.predictor import (
    PAYING_OUT,
    ActiveFriction,
    Configuration,
    Prediction,
    TendonReading,
    Validity,
)
from softgrip_model.finger.room_temperature import RoomTemperature
from softgrip_model.finger.uncertainty import PRIOR, Uncertainty
from softgrip_model.finger.wear import WearMonitor, WearSettings, WearVerdict
from softgrip_model.profile import Profile

#: [m] A finger is open that is pulled by less.
OPEN_M = 1e-3


@dataclass(frozen=True)
class MeasuredFinger:
    """What the camera saw of one finger; SI units, NaN where it could not."""

    finger: str
    joint_angles: tuple[float, ...]
    tip: tuple[float, float]
    profile: str = ""
    """That the camera took it for; empty: not known"""


@dataclass(frozen=True)
class Residual:
    """Measured minus predicted for one finger at one stamp; SI units."""

    stamp: int
    """[ns] of the measurement"""
    finger: str
    pulled_length_m: float
    tip_error: float
    tip_error_percent: float
    joint_angle_errors: tuple[float, ...]
    tension_error: float
    cusum_friction: float
    cusum_stiffness: float
    verdict: WearVerdict
    reason: str


class Session:
    """Holds the good configuration in use; every method is a plain function of it and of its arguments."""

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        mounted: Mapping[str, str],
        wear: WearSettings,
        joint_model: JointModel = JointModel.FLEXURE,
        uncertainty: Uncertainty | None = PRIOR,
        watch: WatchSettings | None = WATCH,
    ) -> None:
        """Start with the given fingers (slot -> profile id) and each profile's own friction, computed by a mode.

        Args:
            profiles: by id.
            mounted: slot -> profile id.
            wear: how wear is judged without a watch.
            joint_model: how fingers are computed.
            uncertainty: what predictions do not know, and learn; None: the friction's covariance is all, nothing is
                learnt.
            watch: how the causes of changes are named; None: friction or stiffness, by `wear`.

        Raises:
            FingerError: an unknown profile.
            ProfileError: a profile without a finger for the slot.
        """
        self._profiles = dict(profiles)
        self._wear, self._watch = wear, watch
        self._frictions: dict[str, ActiveFriction] = {}
        self._learned: ActiveFriction | None = None
        self._matchers: dict[str, Matcher[MeasuredFinger]] = {}
        self._free = True
        self._room: RoomTemperature | None = None
        self._timeline = Timeline()
        self._joint_model = joint_model
        self._uncertainty = uncertainty
        self._learnt: list[tuple[str, Knowledge]] = []
        self._adopt(mounted, None)

    def learn(self, friction: ActiveFriction) -> None:
        """Note a friction model: what is asked for without naming one is computed with the last."""
        self._frictions[friction.id] = friction
        self._learned = friction

    def set_friction(self, friction: ActiveFriction) -> None:
        """Use another friction model from now on."""
        self._frictions[friction.id] = friction
        self._adopt(self.configuration.mounted, friction)

    def set_mounted(self, mounted: Mapping[str, str]) -> None:
        """Use other fingers from now on (slot -> profile id); what was mounted stays in use when this raises.

        Raises:
            FingerError: an unknown profile.
            ProfileError: a profile without a finger for the slot.
        """
        if dict(mounted) != self.configuration.mounted:
            self._adopt(mounted, self.configuration.friction)

    def set_free(self, free: bool) -> None:
        """Record that from now on the fingers move free of objects, or not."""
        self._free = free

    def set_room(self, room: RoomTemperature) -> None:
        """Take note of the temperature: closings from now on are made in it."""
        self._room = room

    @property
    def in_use(self) -> ActiveConfiguration:
        """What a tendon sample that comes now is predicted and judged with."""
        return ActiveConfiguration(self.configuration, self._monitors, self._free, self._learners, self._room)

    def take_learnt(self) -> list[tuple[str, Knowledge]]:
        """Return slot and knowledge of every closing that was learnt from since the last call."""
        taken, self._learnt = self._learnt, []
        return taken

    def on_tendons(self, tendons: Sequence[TendonInput], names: Sequence[str]) -> list[Residual]:
        """Take the tendons' state at one stamp; return the residuals that became known by it."""
        for sample in tendons[:1]:
            self._timeline.record(sample.stamp, self.in_use)
        for name, sample in zip(names, tendons, strict=True):
            if name in self._learners and sample.pulled_length_m < OPEN_M:
                self._learners[name].note_open(sample.stamp)
        pairs = [
            pair
            for name, sample in zip(names, tendons, strict=True)
            if name in self.configuration.fingers and math.isfinite(sample.pulled_length_m)
            for pair in self._matcher(name).add_tendon(sample)
        ]
        return self._residuals(pairs)

    def predict(self, tendons: Sequence[TendonInput], names: Sequence[str]) -> list[Prediction]:
        """Predict the mounted fingers among these tendons."""
        readings = [
            TendonReading(name, sample.pulled_length_m, sample.velocity)
            for name, sample in zip(names, tendons, strict=True)
        ]
        return self.configuration.predict(readings, self.in_use.known(tendons[0].stamp) if tendons else {})

    def on_measured(self, stamp: int, fingers: Sequence[MeasuredFinger]) -> list[Residual]:
        """Take what the camera saw at a stamp [ns]; return the residuals that became known by it."""
        pairs = [pair for finger in fingers for pair in self._matcher(finger.finger).add_measured(stamp, finger)]
        return self._residuals(pairs)

    def closing(self, profile: str, slot: str, friction: str, pulled_lengths: Sequence[float]) -> list[Prediction]:
        """Predict a profile's finger at pulled lengths [m].

        Args:
            profile: id.
            slot: empty = every finger of the profile.
            friction: id; empty = the last one noted, or else the one in use.
            pulled_lengths: [m].

        Raises:
            FingerError, ProfileError: an unknown profile, slot or friction model.
        """
        if profile not in self._profiles:
            raise FingerError(f"unknown profile {profile!r}; loaded: {', '.join(sorted(self._profiles))}")
        slots = (slot,) if slot else self._profiles[profile].slots
        law = self._learned or self.configuration.friction
        if friction:
            law = self._known_friction(profile, friction)
        requested = Configuration(self._profiles, dict.fromkeys(slots, profile), law, self._joint_model)
        return [
            prediction
            for name in slots
            for prediction in requested.closing(name, pulled_lengths, self._known(requested, name))
        ]

    def verdicts(self) -> dict[str, tuple[WearVerdict, str]]:
        """Return the verdict on every mounted finger."""
        return {slot: monitor.judge() for slot, monitor in self._monitors.items()}

    def _known(self, requested: Configuration, slot: str) -> Knowledge | None:
        """Return what is known of a finger that was asked for: of the one that is mounted, what it has taught."""
        if self._uncertainty is None:
            return None
        now = self.configuration
        same = requested.mounted[slot] == now.mounted.get(slot)
        if same and requested.friction_of(slot).digest == now.friction_of(slot).digest:
            return self._learners[slot].newest
        return Knowledge.prior(requested.causes(slot, self._uncertainty))

    def _known_friction(self, profile: str, friction: str) -> ActiveFriction | None:
        if friction in self._frictions:
            return self._frictions[friction]
        own = self._profiles[profile].friction_id
        if friction == own:
            return None  # each profile's own
        known = ", ".join([*self._frictions, own])
        raise FingerError(f"unknown friction model {friction!r}; known: {known}; activate it first")

    def _adopt(self, mounted: Mapping[str, str], friction: ActiveFriction | None) -> None:
        self.configuration = configuration = Configuration(self._profiles, mounted, friction, self._joint_model)
        self._monitors = {slot: self._monitor(slot) for slot in configuration.fingers}
        watches = [monitor for monitor in self._monitors.values() if isinstance(monitor, CauseWatch)]
        for watch in watches:
            watch.join([other for other in watches if other is not watch])
        self._learners = {}
        if self._uncertainty is not None:
            prior = self._uncertainty
            self._learners = {slot: FingerLearner(configuration.causes(slot, prior)) for slot in configuration.fingers}

    def _monitor(self, slot: str) -> WearMonitor | CauseWatch:
        if self._watch is None:
            return WearMonitor(self.configuration.fingers[slot], self.configuration.friction_of(slot).law, self._wear)
        return CauseWatch(self.configuration.causes(slot, WATCHED), self._watch)

    def _matcher(self, slot: str) -> Matcher[MeasuredFinger]:
        return self._matchers.setdefault(slot, Matcher())

    def _residuals(self, pairs: Sequence[tuple[TendonInput, MeasuredFinger]]) -> list[Residual]:
        residuals = []
        # one by one in the order of their stamps, whichever stream completed them
        for tendon, measured in sorted(pairs, key=lambda pair: (pair[0].stamp, pair[1].finger)):
            in_use = self._timeline.at(tendon.stamp)
            if in_use is not None and in_use.holds(measured.finger, measured.profile):
                residuals.append(self._residual(in_use, tendon, measured))
        return residuals

    def _residual(self, in_use: ActiveConfiguration, tendon: TendonInput, measured: MeasuredFinger) -> Residual:
        slot = measured.finger
        known = in_use.known(tendon.stamp)
        reading = TendonReading(slot, tendon.pulled_length_m, tendon.velocity)
        (predicted,) = in_use.configuration.predict([reading], known)
        finger, monitor = in_use.configuration.fingers[slot], in_use.monitors[slot]
        if predicted.validity is not Validity.FAILED and predicted.tension > 0.0:
            self._observe(in_use, tendon, measured, predicted.tension)
        verdict, why = monitor.judge()
        error_mm = float(np.linalg.norm(1e3 * np.array(measured.tip) - np.array(predicted.tip_mm)))
        angles = measured.joint_angles if len(measured.joint_angles) == finger.joints else (math.nan,) * finger.joints
        return Residual(
            stamp=tendon.stamp,
            finger=slot,
            pulled_length_m=tendon.pulled_length_m,
            tip_error=1e-3 * error_mm,
            tip_error_percent=100.0 * error_mm / finger.length_from_joint_mm,
            joint_angle_errors=tuple(float(a - p) for a, p in zip(angles, predicted.joint_angles, strict=True)),
            tension_error=tendon.tension - predicted.tension,
            cusum_friction=monitor.cusum_friction,
            cusum_stiffness=monitor.cusum_stiffness,
            verdict=verdict,
            reason=why,
        )

    def _observe(
        self, in_use: ActiveConfiguration, tendon: TendonInput, measured: MeasuredFinger, predicted_n: float
    ) -> None:
        """Pass one instant to a finger's monitor and learner."""
        slot, pulling = measured.finger, tendon.velocity > PAYING_OUT
        sample = ClosingInstant(
            tendon.stamp, 1e3 * tendon.pulled_length_m, 1e3 * np.array(measured.tip), tendon.tension, predicted_n
        )
        temperature_c = in_use.room.at(tendon.stamp) if in_use.room else math.nan
        in_use.monitors[slot].add(sample, pulling=pulling, free=in_use.free, temperature_c=temperature_c)
        if slot in in_use.learners:
            learnt = in_use.learners[slot].add(sample, pulling=pulling, free=in_use.free)
            if learnt is not None:
                self._learnt.append((slot, learnt))
