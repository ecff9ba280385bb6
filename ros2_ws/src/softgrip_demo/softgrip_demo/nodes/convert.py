# SPDX-License-Identifier: Apache-2.0
"""From messages to the values of the shift's record."""

from __future__ import annotations

import math

from softgrip_demo.record import FrictionPoint, FrictionResult, ShapeView
from softgrip_interfaces.action import CalibrateFriction, Grasp
from softgrip_interfaces.msg import FrictionModel, PredictedShape
from softgrip_nodekit import nanoseconds, seconds
from softgrip_time.units import to_s

VERDICTS = {
    FrictionModel.USABLE: "usable",
    FrictionModel.REPEAT_POINTS: "repeat points",
    FrictionModel.DO_NOT_USE: "do not use",
}


def friction_result(result: CalibrateFriction.Result) -> FrictionResult:
    """Return a CalibrateFriction result as the record holds it."""
    model = result.model
    return FrictionResult(
        id=model.id,
        law=model.law,
        k_reading=model.k_reading,
        coefficients=dict(zip(model.coefficient_names, (float(c) for c in model.coefficients), strict=True)),
        radius_mm=1000.0 * (model.cable_radius + model.surface_radius),
        average_error=model.average_error,
        maximum_error=model.maximum_error,
        r_squared=model.r_squared,
        verdict=VERDICTS.get(model.verdict, f"unknown verdict {model.verdict}"),
        points=tuple(
            FrictionPoint(sample.angle, sample.tension_high, sample.tension_low)
            for sample in result.samples
            if sample.verdict == sample.ACCEPTED
        ),
    )


def outcome_latency(result: Grasp.Result, received_ns: int) -> float:
    """Return how long after the deciding event a Grasp result has come to its client [s].

    Args:
        result: Grasp.Result.
        received_ns: when it came, on the clock of the driver's stamps [ns].

    Returns:
        The event to the sample that decided, and that sample's stamp to the client; NaN where nothing was decided on a
        sample (a refusal). Simulated time comes to the client by /clock, so its time may be that of before the sample.
    """
    decided_ns = nanoseconds(result.decision.stamp)
    return math.nan if not decided_ns else result.latency + max(0.0, to_s(received_ns - decided_ns))


def shape_view(shapes: list[PredictedShape]) -> ShapeView | None:
    """Return the last shape of a closing and the rate at which they came; None when there were fewer than two."""
    if len(shapes) < 2:
        return None
    stamps = [seconds(shape.header.stamp) for shape in shapes]
    last = shapes[-1]
    vertices = [float(value) for value in last.vertices]
    faces = [int(value) for value in last.faces]
    return ShapeView(
        hexahedra=int(last.hexahedra),
        rate=(len(shapes) - 1) / (stamps[-1] - stamps[0]),
        converged=bool(last.converged),
        pulled_length_m=float(last.pulled_length),
        vertices=tuple(zip(vertices[0::3], vertices[1::3], vertices[2::3], strict=True)),
        faces=tuple(zip(faces[0::4], faces[1::4], faces[2::4], faces[3::4], strict=True)),
    )
