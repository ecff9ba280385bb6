# SPDX-License-Identifier: Apache-2.0
"""Predicts the mounted fingers from the pulled tendon lengths, and compares with what the camera sees.

Subscribes tendon/state, friction/active, cell/state, finger/measured, and a thermometer's cell/temperature where there
is one; publishes finger/predicted and finger/residual; serves finger/predict. Results leave from subscription callbacks
only and depend on the messages and their stamps alone (softgrip_nodekit/event_time.py); each names the friction model
and the configuration it was computed with, so that a bag replays to the same numbers.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from typing import Any

from sensor_msgs.msg import JointState, Temperature

from softgrip_interfaces.msg import CellState, FingerStates, FrictionModel, PredictionResidual
from softgrip_interfaces.srv import PredictFinger
from softgrip_model.finger import FingerError, JointModel
from softgrip_model.finger.diagnosis import WATCH, WatchSettings
from softgrip_model.finger.matching import MAX_GAP_NS, SPAN_NS
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.finger.room_temperature import RoomTemperature
from softgrip_model.finger.session import Residual, Session
from softgrip_model.finger.uncertainty import PRIOR, Uncertainty
from softgrip_model.finger.wear import WearSettings, WearVerdict
from softgrip_model.friction.errors import FrictionError
from softgrip_model.nodes import convert
from softgrip_model.profile import ProfileError, load_profiles, mounting_of
from softgrip_nodekit import (
    LATCHED,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    Rank,
    StampedInputs,
    lateness_parameter,
    nanoseconds,
    realtime_parameter,
    run,
    startup_errors,
)

_WEAR, _PRIOR = WearSettings(), PRIOR

PARAMETERS = ParameterTable(
    Parameter("profiles_directory", "", "folder of finger profiles; empty = those of softgrip_bringup"),
    Parameter("fingers", ["index", "middle", "thumb"], "slots that hold a finger until cell/state says otherwise"),
    Parameter("profiles", ["power", "power", "power"], "profile in each of these slots, or one for all"),
    Parameter("frame_prefix", "", "before every frame: that of hand_description"),
    Parameter(
        "joint_model",
        str(JointModel.FLEXURE),
        "how fingers are computed: flexure (mode F) or hinge (mode P), docs/finger.md",
        choices=tuple(map(str, JointModel)),
    ),
    Parameter(
        "intervals",
        "all",
        "what standard deviations hold: all that may differ, learnt from closings, or the friction's covariance alone",
        choices=("all", "friction"),
    ),
    Parameter(
        "zero_stddev_m", 1e-3 * _PRIOR.zero_mm, "of the pulled length's zero before it was learnt", "m", 0.0, 0.01
    ),
    Parameter(
        "stretch_stddev_m_per_n",
        1e-3 * _PRIOR.stretch_mm_per_n,
        "of the cable's stretch beside the profile's, per tension",
        "m/N",
        1e-7,
        0.001,
    ),
    Parameter("room_stddev_m", 1e-3 * _PRIOR.room_mm, "of where a pulled cable lies in its holes", "m", 0.0, 0.002),
    Parameter("print_stddev_m", 1e-3 * _PRIOR.thickness_mm, "of printed strips and routing", "m", 0.0, 0.002),
    Parameter("camera_stddev_m", 1e-3 * _PRIOR.camera_mm, "of the camera's plane", "m", 0.0, 0.01),
    Parameter("model_stddev", _PRIOR.model, "error of the kernel at full closing, share of the length", "", 0.0, 0.2),
    Parameter("stiffness_stddev", _PRIOR.stiffness, "of the material's modulus, relative", "", 0.0, 0.25),
    Parameter("friction_stddev", _PRIOR.friction, "of ln Rf beside the rig's, relative", "", 0.0, 0.25),
    Parameter(
        "watch",
        "causes",
        "what changes are put down to: causes (docs/finger.md), or shifts of friction and stiffness alone",
        choices=("causes", "shifts"),
    ),
    Parameter("watch_limit", WATCH.limit, "log-likelihood ratio from which a cause is named", "", 1.0, 100.0),
    Parameter("worn_limit", WATCH.worn_limit, "the same for calling a finger worn", "", 1.0, 1000.0),
    Parameter("tip_stddev_m", 1e-3 * _WEAR.tip_stddev_mm, "noise of the measured tip", "m", 1e-5, 0.02),
    Parameter("tension_stddev", _WEAR.tension_stddev, "noise of the measured tension, relative", "", 0.001, 1.0),
    Parameter("baseline_closings", _WEAR.baseline, "empty closings that set the baseline", "", 2, 100),
    Parameter(
        "cusum_allowance", _WEAR.allowance, "shift per closing that is let pass (standard deviations)", "", 0.0, 5.0
    ),
    Parameter("cusum_limit", _WEAR.limit, "decision limit (standard deviations)", "", 1.0, 50.0),
    lateness_parameter(0.2),
    realtime_parameter(Rank.PREDICTION),
)

_HEALTH = {
    WearVerdict.OK: Health.OK,
    WearVerdict.WATCH: Health.OK,
    WearVerdict.RECALIBRATE: Health.WARN,
    WearVerdict.WORN: Health.WARN,
}


def _uncertainty(values: dict[str, Any]) -> Uncertainty | None:
    if values["intervals"] == "friction":
        return None
    return dataclasses.replace(
        _PRIOR,
        friction=values["friction_stddev"],
        stiffness=values["stiffness_stddev"],
        thickness_mm=1e3 * values["print_stddev_m"],
        routing_mm=1e3 * values["print_stddev_m"],
        zero_mm=1e3 * values["zero_stddev_m"],
        stretch_mm_per_n=1e3 * values["stretch_stddev_m_per_n"],
        room_mm=1e3 * values["room_stddev_m"],
        camera_mm=1e3 * values["camera_stddev_m"],
        model=values["model_stddev"],
    )


def _watch(values: dict[str, Any]) -> WatchSettings | None:
    if values["watch"] == "shifts":
        return None
    return WatchSettings(
        baseline=values["baseline_closings"], limit=values["watch_limit"], worn_limit=values["worn_limit"]
    )


class KinematicsPredictor(CellNode):
    """Translates between topics and a `Session`."""

    def __init__(self) -> None:
        super().__init__("kinematics_predictor")
        values = PARAMETERS.declare(self)
        self._session = self._start(values)
        self._diagnostics = Diagnostics(self)
        self._inputs = StampedInputs(self, "tendon/state", values["allowed_lateness_s"], self._diagnostics)
        self._predicted = self.create_publisher(FingerStates, "finger/predicted", SENSOR)
        self._frame_prefix: str = values["frame_prefix"]
        self._residual = self.create_publisher(PredictionResidual, "finger/residual", SENSOR)
        self.create_subscription(FrictionModel, "friction/active", self._on_friction, LATCHED)
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.create_subscription(JointState, "tendon/state", self._on_tendons, SENSOR)
        self.create_subscription(FingerStates, "finger/measured", self._on_measured, SENSOR)
        self.create_subscription(Temperature, "cell/temperature", self._on_temperature, SENSOR)
        self.create_service(PredictFinger, "finger/predict", self._on_predict)
        self._report("profile", Health.OK, "as given by parameters", self._mounted())
        self._report("friction", Health.OK, f"the profiles' own: {self._session.configuration.friction_id}")
        self.get_logger().info(f"predicting {self._mounted()} with {self._session.configuration.friction_id}")

    @staticmethod
    def _start(values: dict[str, Any]) -> Session:
        wear = WearSettings(
            tip_stddev_mm=1e3 * values["tip_stddev_m"],
            tension_stddev=values["tension_stddev"],
            baseline=values["baseline_closings"],
            allowance=values["cusum_allowance"],
            limit=values["cusum_limit"],
        )
        with startup_errors(FingerError, ProfileError):
            mounted = mounting_of(values["fingers"], values["profiles"])
            profiles, model = load_profiles(values["profiles_directory"]), JointModel(values["joint_model"])
            return Session(profiles, mounted, wear, model, _uncertainty(values), _watch(values))

    def _on_tendons(self, message: JointState) -> None:
        self._inputs.drive(message)
        try:
            names, samples = convert.tendon_samples(message)
        except FingerError as error:
            self._report("tendons", Health.WARN, str(error))
            return
        predictions = self._session.predict(samples, names)
        if predictions:
            self._predicted.publish(convert.predicted_message(message.header, predictions, self._session.in_use))
        self._report("tendons", Health.OK, f"{len(predictions)} of {len(names)} tendons predicted")
        self._publish_residuals(self._session.on_tendons(samples, names))

    def _on_measured(self, message: FingerStates) -> None:
        self._inputs.pair("finger/measured", message, SPAN_NS - MAX_GAP_NS)
        stamp = nanoseconds(message.header.stamp)
        self._publish_residuals(self._session.on_measured(stamp, convert.measured_fingers(message)))

    def _publish_residuals(self, residuals: Sequence[Residual]) -> None:
        for slot, known in self._session.take_learnt():
            self._report(f"finger {slot} as learnt", Health.OK, known.summary())
            self.get_logger().info(f"{slot}: {known.summary()}")
        for residual in residuals:
            self._residual.publish(convert.residual_message(residual, self._frame_prefix))
            self._report(f"finger {residual.finger}", _HEALTH[residual.verdict], residual.reason or "as predicted")

    def _on_friction(self, message: FrictionModel) -> None:
        try:
            friction = convert.active_friction(message)
        except (FingerError, FrictionError) as error:
            kept = self._session.configuration.friction_id
            self._report("friction", Health.WARN, f"{error}; still using {kept}")
            return
        self._session.learn(friction)
        self._inputs.latch("friction/active", message, lambda: self._use_friction(friction))

    def _use_friction(self, friction: ActiveFriction) -> None:
        self._session.set_friction(friction)
        self._report("friction", Health.OK, f"using {friction.id}", {"digest": friction.digest})
        self.get_logger().info(f"friction model {friction.id}")

    def _on_cell(self, message: CellState) -> None:
        self._inputs.latch("cell/state", message, lambda: self._use_cell(message))

    def _use_cell(self, message: CellState) -> None:
        self._session.set_free(convert.is_free(message))
        mounted = convert.mounted_profiles(message)
        try:
            self._session.set_mounted(mounted)
        except (FingerError, ProfileError) as error:
            self._report("profile", Health.WARN, f"{error}; still predicting {self._mounted()}")
            return
        self._report("profile", Health.OK, "as mounted by cell/state", self._mounted())

    def _on_temperature(self, message: Temperature) -> None:
        try:
            room = convert.room_temperature(message)
        except FingerError as error:
            self._report("room", Health.WARN, str(error))
            return
        self._inputs.latch("cell/temperature", message, lambda: self._use_room(room))

    def _use_room(self, room: RoomTemperature) -> None:
        self._session.set_room(room)
        now = self._session.in_use.room
        self._report("room", Health.OK, f"{now.celsius:.1f} degC" if now else "no thermometer")

    def _on_predict(self, request: PredictFinger.Request, response: PredictFinger.Response) -> PredictFinger.Response:
        try:
            predictions = self._session.closing(
                request.profile, request.finger, request.friction_model, request.pulled_lengths
            )
        except (FingerError, ProfileError) as error:
            response.success = False
            response.message = str(error)
            return response
        response.success = True
        response.states = [convert.finger_state(prediction) for prediction in predictions]
        return response

    def _mounted(self) -> dict[str, str]:
        return self._session.configuration.mounted

    def _report(self, component: str, health: Health, text: str, values: dict[str, str] | None = None) -> None:
        self._diagnostics.set(component, health, text, values)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run(KinematicsPredictor, args))


if __name__ == "__main__":
    main()
