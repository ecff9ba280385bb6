# SPDX-License-Identifier: Apache-2.0
"""The shift in figures: what `summary.json` holds and what the terminal shows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from softgrip_demo.table42 import agrees

if TYPE_CHECKING:
    from softgrip_demo.record import ShiftClosing, ShiftRecord

#: 95 % of a normal distribution are within as many standard deviations.
NORMAL_95 = 1.96


@dataclass(frozen=True)
class ReplayCheck:
    """Result of feeding the bag back through a node."""

    node: str
    compared: int
    identical: bool
    detail: str
    wall_clock_s: float  # [s]


def tip_errors_percent(closing: ShiftClosing) -> np.ndarray:
    """Return the distance of measured and predicted tip per sample, in percent of the finger's length, shape (n,)."""
    measured = np.array([sample.measured_tip for sample in closing.samples]).reshape(-1, 2)
    predicted = np.array([sample.predicted_tip for sample in closing.samples]).reshape(-1, 2)
    return np.asarray(100.0 * np.hypot(*(measured - predicted).T) / closing.finger_length)


def tip_half_widths(closing: ShiftClosing) -> np.ndarray:
    """Return half of the predicted tip's 95 % interval along x and y per sample [m], shape (n, 2)."""
    stddev = np.array([sample.predicted_tip_stddev for sample in closing.samples]).reshape(-1, 2)
    return np.asarray(NORMAL_95 * stddev)


def interval_held_percent(closing: ShiftClosing) -> float:
    """Return the share of measured tip coordinates within their predicted 95 % interval [%]; NaN where none is stated.

    An interval is one of the true tip. What the camera says of its own deviation widens it, where it says something.
    """
    measured = np.array([sample.measured_tip for sample in closing.samples]).reshape(-1, 2)
    predicted = np.array([sample.predicted_tip for sample in closing.samples]).reshape(-1, 2)
    seen = np.nan_to_num(np.array([sample.measured_tip_stddev for sample in closing.samples]).reshape(-1, 2))
    widths = np.hypot(tip_half_widths(closing), NORMAL_95 * seen)
    known = np.isfinite(widths)
    return float(100.0 * np.mean((np.abs(measured - predicted) <= widths)[known])) if known.any() else math.nan


def summarise(record: ShiftRecord, replay: ReplayCheck, report_wall_clock_s: float) -> dict[str, Any]:
    """Return the content of summary.json."""
    closings = []
    for closing in record.closings:
        errors = tip_errors_percent(closing)
        closings.append(
            {
                "grasp": closing.grasp,
                "tip_error_pct_mean": _number(errors.mean()) if errors.size else None,
                "tip_error_pct_max": _number(errors.max()) if errors.size else None,
                "tip_interval_held_pct": _number(interval_held_percent(closing)),
                "samples": len(closing.samples),
            }
        )
    shapes = [closing.shape for closing in record.closings if closing.shape is not None]
    coefficients = record.friction.coefficients
    return {
        "seed": record.seed,
        "friction": {
            **{name: coefficients.get(name) for name in ("alpha", "n", "epsilon", "lambda")},
            "avg_error_pct": _number(100.0 * record.friction.average_error),
            "max_error_pct": _number(100.0 * record.friction.maximum_error),
            "r2": _number(record.friction.r_squared),
            "n_points": len(record.friction.points),
            "verdict": record.friction.verdict,
        },
        "closings": closings,
        "grasps": [
            {
                "product": grasp.product,
                "grasp": grasp.grasp,
                "outcome": grasp.outcome,
                "expected": grasp.expected,
                "agrees": agrees(grasp.outcome, grasp.expected),
                "latency_ms": _number(round(1000.0 * grasp.latency, 1) + 0.0),  # finer is the stamps' rounding; no -0
                "reason": grasp.reason,
            }
            for grasp in record.grasps
        ],
        "swaps": record.swaps,
        "shape": {
            "hexes": max((shape.hexahedra for shape in shapes), default=0),
            "rate_hz": _number(min((shape.rate for shape in shapes), default=math.nan)),
        },
        "bag": {
            "path": record.bag_path,
            "messages": record.bag_messages,
            "topics": record.bag_topics,
            "dropped": record.bag_dropped,
        },
        "replay": {
            "node": replay.node,
            "compared": replay.compared,
            "identical": replay.identical,
            "detail": replay.detail,
        },
        "wall_s": {
            **{stage.name: _number(stage.wall_clock_s) for stage in record.stages},
            "replay": _number(replay.wall_clock_s),
            "report": _number(report_wall_clock_s),
        },
    }


def _number(value: float, digits: int = 4) -> float | None:
    """Return a figure rounded to significant digits, None where there is none (JSON has no NaN)."""
    if not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")
