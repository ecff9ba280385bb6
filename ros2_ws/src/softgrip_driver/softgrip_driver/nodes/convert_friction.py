# SPDX-License-Identifier: Apache-2.0
"""Between the friction rig's values and messages; its one home."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from softgrip_driver.rig.journal import Request
from softgrip_driver.rig.procedure import JudgedPoint, ProcedureStep
from softgrip_driver.rig.pull import RigSample
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import FrictionModel, FrictionSample
from softgrip_model.friction.acceptance import model_digest
from softgrip_model.friction.record import FrictionModel as Model
from softgrip_model.friction.record import ModelVerdict

_VERDICTS = {
    ModelVerdict.USABLE: FrictionModel.USABLE,
    ModelVerdict.REPEAT_POINTS: FrictionModel.REPEAT_POINTS,
    ModelVerdict.DO_NOT_USE: FrictionModel.DO_NOT_USE,
}


def model_message(model: Model) -> FrictionModel:
    """Return a model as a message."""
    message = FrictionModel()
    message.header.stamp = Time(sec=int(model.fitted_at.timestamp()), nanosec=0)
    message.id = model.id
    message.law = str(model.law.law)
    message.k_reading = str(model.law.k_reading)
    message.coefficient_names = list(model.law.names)
    message.coefficients = [float(c) for c in model.law.coefficients]
    message.covariance = [] if model.covariance is None else [float(c) for c in model.covariance.ravel()]
    message.cable_radius = float(model.cable_radius_m)
    message.surface_radius = float(model.surface_radius_m)
    message.angle_range = [float(a) for a in model.law.angle_range]
    message.tension_range = [float(t) for t in model.law.tension_range]
    message.average_error = float(model.average_error)
    message.maximum_error = float(model.maximum_error)
    message.r_squared = float(model.r_squared)
    message.residual_stddev = float(model.residual_stddev)
    message.degrees_of_freedom = int(model.degrees_of_freedom)
    message.points = int(model.points)
    message.cable = model.cable
    message.surface = model.surface
    message.source = f"{model.source}, sha256 {model.source_sha256}" if model.source_sha256 else model.source
    message.verdict = _VERDICTS[model.verdict]
    message.reason = model.reason
    message.digest = model_digest(model.law, model.covariance, model.cable_radius_m, model.surface_radius_m)
    return message


def sample_message(judged: JudgedPoint, stamp: Time) -> FrictionSample:
    """Return one attempt at one point as a message."""
    slide = judged.slide
    message = FrictionSample()
    message.header.stamp = stamp
    message.plan = judged.plan_id
    message.index = int(judged.index)
    message.angle = float(judged.point.angle)
    message.load = float(judged.point.load)
    message.tension_low = float(slide.tension_low)
    message.tension_high = float(slide.tension_high)
    message.tension_high_stddev = float(slide.stddev)
    message.stick_slip_amplitude = float(slide.stick_slip)
    message.drift = float(slide.drift)
    message.speed = float(judged.speed)
    message.window_start = float(slide.window_start)
    message.window_end = float(slide.window_end)
    message.verdict = int(slide.verdict)
    message.reason = slide.reason
    return message


def feedback_message(step: ProcedureStep) -> CalibrateFriction.Feedback:
    """Return a step as the action's feedback."""
    feedback = CalibrateFriction.Feedback()
    feedback.phase = int(step.phase)
    feedback.index = int(step.index)
    feedback.total = int(step.total)
    feedback.angle = float(step.point.angle)
    feedback.load = float(step.point.load)
    feedback.instruction = step.instruction
    return feedback


def request_of(goal: CalibrateFriction.Goal) -> Request:
    """Return what an action goal asks for."""
    return Request(
        plan=goal.plan,
        law=goal.law or "matte",
        cable=goal.cable,
        surface=goal.surface,
        cable_radius=float(goal.cable_radius),
        surface_radius=float(goal.surface_radius),
        angles=tuple(float(a) for a in goal.angles),
        loads=tuple(float(load) for load in goal.loads),
        activate=bool(goal.activate),
    )


def wrench_message(sample: RigSample, stamp: Time, frame: str) -> WrenchStamped:
    """Return a reading of the gauge: tension along z of its frame, pulling positive."""
    message = WrenchStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame
    message.wrench.force.z = float(sample.tension)
    return message


def stage_message(sample: RigSample, stamp: Time, frame: str) -> JointState:
    """Return a raw trace's sample: travel [m] with the tension [N] felt there."""
    message = JointState()
    message.header.stamp = stamp
    message.header.frame_id = frame
    message.name = ["rig_stage"]
    message.position = [float(sample.travel)]
    message.velocity = [math.nan]
    message.effort = [float(sample.tension)]
    return message
