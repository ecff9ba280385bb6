# SPDX-License-Identifier: Apache-2.0
"""Readings as a table and as a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from softgrip_vision.errors import VisionError
from softgrip_vision.readings import FingerReading

Rows = Sequence[tuple[float, FingerReading]]


def write_csv(rows: Rows, path: Path) -> None:
    """Write one line per frame and finger; empty fields where nothing is known.

    Args:
        rows: (time [s], reading), of fingers with one number of joints.
        path: of the file.

    Raises:
        VisionError: when there is no row.
    """
    if not rows:
        raise VisionError(f"{path}: expected at least one frame, found none")
    markers = rows[0][1].markers
    joints = len(markers) - 2
    header = ["time_s", "finger", "profile"]
    header += [f"joint_{j}_rad" for j in range(joints)] + [f"joint_{j}_stddev_rad" for j in range(joints)]
    header += ["tip_x_m", "tip_y_m", "tip_x_stddev_m", "tip_y_stddev_m", "threshold_quality", "problem"]
    for marker in markers:
        header += [f"{marker.name}_{what}" for what in ("u_px", "v_px", "stddev_px", "confidence", "occluded")]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(_line(time, reading, joints) for time, reading in rows)


def _line(time: float, reading: FingerReading, joints: int) -> list[str]:
    pose = reading.pose
    unknown = [math.nan] * joints, [math.nan] * joints, [math.nan] * 2, [math.nan] * 2
    groups = (pose.angles, pose.angles_stddev, pose.tip, pose.tip_stddev) if pose else unknown
    line = [f"{time:.6f}", reading.finger, reading.profile]
    line += [_number(value) for group in groups for value in group]
    line += [_number(reading.threshold_quality), reading.problem]
    for marker in reading.markers:
        line += [_number(v) for v in (*marker.pixel, marker.stddev_px, marker.confidence)]
        line.append(str(int(marker.occluded)))
    return line


def _number(value: float) -> str:
    return f"{float(value):.6g}" if math.isfinite(value) else ""


def plot(rows: Rows, path: Path) -> None:
    """Draw joint angles and tip over time, with bands of two standard deviations, one column per finger."""
    fingers = sorted({reading.finger for _, reading in rows})
    figure = Figure(figsize=(6.0 * len(fingers), 7.0), layout="constrained")
    axes = figure.subplots(2, len(fingers), squeeze=False, sharex="col")
    for column, finger in enumerate(fingers):
        known = [(time, r.pose) for time, r in rows if r.finger == finger and r.pose is not None]
        upper, lower = axes[0, column], axes[1, column]
        upper.set(title=finger, ylabel="joint angle [deg]")
        lower.set(xlabel="time [s]", ylabel="tip [mm]")
        for axis in (upper, lower):
            axis.grid(visible=True, alpha=0.3)
        if not known:
            upper.text(0.5, 0.5, "never measured", transform=upper.transAxes, ha="center")
            continue
        times = np.array([time for time, _ in known])
        angles = np.degrees([pose.angles for _, pose in known])
        spread = np.degrees([pose.angles_stddev for _, pose in known])
        tips = np.array([pose.tip for _, pose in known]) * 1e3
        for joint in range(angles.shape[1]):
            (line,) = upper.plot(times, angles[:, joint], ".-", markersize=3, linewidth=1, label=f"joint {joint}")
            low, high = angles[:, joint] - 2 * spread[:, joint], angles[:, joint] + 2 * spread[:, joint]
            upper.fill_between(times, low, high, color=line.get_color(), alpha=0.25, linewidth=0)
        lower.plot(times, tips[:, 0], ".-", markersize=3, linewidth=1, label="x")
        lower.plot(times, tips[:, 1], ".-", markersize=3, linewidth=1, label="y")
        upper.legend()
        lower.legend()
    FigureCanvasAgg(figure).print_png(str(path))
