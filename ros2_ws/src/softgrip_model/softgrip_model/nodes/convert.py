# SPDX-License-Identifier: Apache-2.0
"""Between this package's values and messages; its one home."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from softgrip_interfaces.msg import (
    CellState,
    FingerState,
    FingerStates,
    FrictionModel,
    MountedFinger,
    PredictedShape,
    PredictionResidual,
)
from softgrip_model.finger import FingerError
from softgrip_model.finger.active_configuration import ActiveConfiguration
from softgrip_model.finger.matching import TendonInput
from softgrip_model.finger.predictor import ActiveFriction, Prediction
from softgrip_model.finger.room_temperature import RoomTemperature
from softgrip_model.finger.session import MeasuredFinger, Residual
from softgrip_model.friction.acceptance import accept
from softgrip_model.gdfe.session import Shown
from softgrip_nodekit import nanoseconds, to_time_message

#: Modes of the cell in which a finger may be holding something, or stand where nobody knows.
_NOT_FREE = (CellState.GRASPING, CellState.HOLDING, CellState.FAULT, CellState.ESTOP)


def tendon_samples(message: JointState) -> tuple[list[str], list[TendonInput]]:
    """Return names and samples; velocity and tension are NaN where the message has none.

    Raises:
        FingerError: not one position per name.
    """
    names = list(message.name)
    if len(message.position) != len(names):
        raise FingerError(f"tendon/state: expected {len(names)} positions for {names}, found {len(message.position)}")
    unknown = [math.nan] * len(names)
    velocity = message.velocity if len(message.velocity) == len(names) else unknown
    tension = message.effort if len(message.effort) == len(names) else unknown
    stamp = nanoseconds(message.header.stamp)
    samples = [
        TendonInput(stamp, float(p), float(v), float(t))
        for p, v, t in zip(message.position, velocity, tension, strict=True)
    ]
    return names, samples


def measured_fingers(message: FingerStates) -> list[MeasuredFinger]:
    """Return the fingers that the camera could measure."""
    return [
        MeasuredFinger(
            state.finger,
            tuple(float(a) for a in state.joint_angles),
            (float(state.tip.x), float(state.tip.y)),
            state.profile,
        )
        for state in message.fingers
        if state.validity != FingerState.FAILED
    ]


#: Verdicts of models that may be computed with.
_USABLE = {FrictionModel.USABLE, FrictionModel.REPEAT_POINTS}


def active_friction(message: FrictionModel) -> ActiveFriction:
    """Return a friction model.

    Raises:
        FingerError: its verdict does not say that it may be used.
        LawError: an unknown law, numbers that it cannot have, or a digest of other numbers.
    """
    if message.verdict == FrictionModel.UNSET:
        raise FingerError(f"friction model {message.id!r}: expected a verdict, found none; calibrate (rig/calibrate)")
    if message.verdict not in _USABLE:
        raise FingerError(f"friction model {message.id!r} is marked do-not-use: {message.reason}")
    accepted = accept(message)
    return ActiveFriction(message.id, accepted.law, accepted.covariance, accepted.digest)


def mounted_profiles(message: CellState) -> dict[str, str]:
    """Return slot -> profile id of the slots that hold a finger."""
    return {
        mounted.finger: mounted.profile
        for mounted in message.mounted
        if mounted.profile and mounted.state != MountedFinger.EMPTY
    }


def is_free(message: CellState) -> bool:
    """Return whether closings in this mode meet no object."""
    return message.mode not in _NOT_FREE


def room_temperature(message: Temperature) -> RoomTemperature:
    """Return what a thermometer says [degC, as REP 103's exception for sensor_msgs/Temperature].

    Raises:
        FingerError: no temperature that a room can have.
    """
    return RoomTemperature(nanoseconds(message.header.stamp), float(message.temperature))


def predicted_message(header: Header, predictions: Sequence[Prediction], in_use: ActiveConfiguration) -> FingerStates:
    """Return predictions as a message with the header of what they were computed from."""
    return FingerStates(
        header=header,
        fingers=[finger_state(prediction) for prediction in predictions],
        friction_model=in_use.configuration.friction_id,
        friction_digest=in_use.configuration.friction_digest,
        configuration=in_use.digest_at(nanoseconds(header.stamp)),
    )


def finger_state(prediction: Prediction) -> FingerState:
    """Return one prediction."""
    stddev = prediction.joint_angles_stddev
    return FingerState(
        finger=prediction.finger,
        profile=prediction.profile,
        pulled_length=float(prediction.pulled_length_m),
        tension=prediction.tension,
        joint_angles=prediction.joint_angles.tolist(),
        joint_angles_stddev=[] if stddev is None else stddev.tolist(),
        tip=Point(x=prediction.tip[0], y=prediction.tip[1], z=0.0),
        tip_stddev=list(prediction.tip_stddev),
        contact_tensions=prediction.tensions.tolist(),
        validity=int(prediction.validity),
        reason=prediction.reason,
    )


def _finger_frame(stamp: Time, finger: str, prefix: str) -> Header:
    """Return the header of what is said in a finger's frame; the prefix is hand_description's."""
    return Header(stamp=stamp, frame_id=f"{prefix}{finger}_base")


def residual_message(residual: Residual, frame_prefix: str) -> PredictionResidual:
    """Return one residual, in the frame of its finger."""
    return PredictionResidual(
        header=_finger_frame(to_time_message(residual.stamp), residual.finger, frame_prefix),
        finger=residual.finger,
        pulled_length=residual.pulled_length_m,
        tip_error=residual.tip_error,
        tip_error_percent=residual.tip_error_percent,
        joint_angle_errors=list(residual.joint_angle_errors),
        tension_error=residual.tension_error,
        cusum_friction=residual.cusum_friction,
        cusum_stiffness=residual.cusum_stiffness,
        verdict=int(residual.verdict),
        reason=residual.reason,
    )


def _floats(values: np.ndarray) -> array[float]:
    """Return numbers as float32[] messages take them at once."""
    out = array("f")
    out.frombytes(np.ascontiguousarray(values, dtype=np.float32).tobytes())
    return out


def shape_message(stamp: Time, shown: Shown, frame_prefix: str) -> PredictedShape:
    """Return one shape with the stamp of the tendon state it belongs to."""
    faces = array("I")
    faces.frombytes(np.ascontiguousarray(shown.faces, dtype=np.uint32).tobytes())
    shape = shown.shape
    return PredictedShape(
        header=_finger_frame(stamp, shown.finger, frame_prefix),
        finger=shown.finger,
        mesh=shown.mesh,
        pulled_length=float(shape.pulled_length_m),
        vertices=_floats(shape.vertices),
        faces=faces,
        strain=_floats(shape.strain),
        hexahedra=int(shown.hexahedra),
        law="calibrated",
        converged=bool(shape.converged),
        residual=float(shape.residual),
        iterations=int(shape.iterations),
        solve_time=float(shape.solve_time),
        rate=float(shown.rate_hz),
        reason=shown.reason,
        configuration=shown.configuration,
    )


#: RGBA of a shape that converged, and of one that did not.
_SOLVED, _KEPT = (0.95, 0.55, 0.15, 1.0), (0.6, 0.6, 0.6, 0.7)


def marker_message(stamp: Time, shown: Shown, frame_prefix: str) -> Marker:
    """Return the surface of a shape as triangles; grey when it is the last converged one."""
    quads = shown.faces.astype(np.int64)
    corners = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).ravel()
    nodes = [Point(x=x, y=y, z=z) for x, y, z in shown.shape.vertices.tolist()]
    r, g, b, a = _SOLVED if shown.shape.converged else _KEPT
    marker = Marker(
        header=_finger_frame(stamp, shown.finger, frame_prefix),
        ns=shown.finger,
        id=0,
        type=Marker.TRIANGLE_LIST,
        action=Marker.ADD,
        color=ColorRGBA(r=r, g=g, b=b, a=a),
        points=[nodes[i] for i in corners.tolist()],
    )
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker
