# SPDX-License-Identifier: Apache-2.0
"""Designs as files: parameters for CAD and the report."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softgrip_design.design import Followed, HandDesign, Uniform
from softgrip_model.finger import Finger, reason
from softgrip_model.finger.published import CHAPTER_4_ERROR_DEG

#: What `importUserParameters` of Fusion's API (and its parameter add-ins) reads.
CAD_COLUMNS = ("Name", "Unit", "Expression", "Value", "Comments", "Favourite")


def write_cad_csv(fingers: Mapping[str, Finger], path: Path) -> None:
    """Write every dimension of the fingers as user parameters of a CAD programme: `index_h0`, `index_r0`, ... [mm]."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(CAD_COLUMNS)
        for name, finger in fingers.items():
            for key, value, unit, comment in _parameters(finger):
                writer.writerow([f"{name}_{key}", unit, f"{value:.3f} {unit}", f"{value:.3f}", comment, "FALSE"])


def _parameters(finger: Finger) -> list[tuple[str, float, str, str]]:
    found = [("width", finger.width_mm, "mm", "of the finger"), ("base", finger.base_mm, "mm", "rigid, before joint 0")]
    found += [(f"link{j}", v, "mm", f"joint {j} to the next, or to the tip") for j, v in enumerate(finger.link_mm)]
    found += [(f"l{j}", v, "mm", f"length of strip {j}") for j, v in enumerate(finger.length_mm)]
    found += [(f"h{j}", v, "mm", f"thickness of strip {j}") for j, v in enumerate(finger.thickness_mm)]
    found += [
        (f"r{i}", v, "mm", f"joint {i // 2}, {'exit' if i % 2 else 'entry'} of the cable along the groove's flank")
        for i, v in enumerate(finger.routing_mm)
    ]
    return found + [(f"opening{j}", math.degrees(v), "deg", f"groove {j}") for j, v in enumerate(finger.opening_rad)]


def follow_report(design: HandDesign, published: Mapping[str, Mapping[str, tuple[float, float]]]) -> dict[str, Any]:
    """Return error and force of every finger as plain values, lengths in mm, angles in deg.

    Args:
        design: what was designed.
        published: finger -> grasp -> error and force of the designs of Fig 4.4 on the same target.
    """
    return {
        "seconds": design.seconds,
        "fingers": {one.name: _followed(one) for one in design.followed},
        "shared": {
            one.name: {"taken_from": one.taken_from, "why": one.why, **_dimensions(one.finger)} for one in design.shared
        },
        "published_designs_on_the_same_target": {
            name: {grasp: {"error_deg": _number(e), "force_n": _number(f)} for grasp, (e, f) in designs.items()}
            for name, designs in published.items()
        },
        "error_deg_of_the_thesis_on_its_own_demonstrations": CHAPTER_4_ERROR_DEG,
    }


def uniform_report(uniform: Uniform) -> dict[str, Any]:
    """Return the result of section 3.4's objective as plain values."""
    return {
        "seconds": uniform.seconds,
        "spread_deg": uniform.spread_deg,
        "published_routing_spread_deg": uniform.published_spread_deg,
        "angles_deg_at_the_end": np.degrees(uniform.closing.angle_rad[0, -1]).tolist(),
        "force_n": float(uniform.closing.tension_n[0, -1, 0]),
        **_dimensions(uniform.finger),
    }


def _followed(one: Followed) -> dict[str, Any]:
    remarks = sorted({text for status in one.closing.status[0] for text in reason(int(status)).split("; ") if text})
    return {
        **_dimensions(one.finger),
        "error_deg": one.error_deg,
        "error_per_joint_deg": list(one.error_per_joint_deg),
        "mesh_error_deg": list(one.mesh_error_deg) if one.mesh_error_deg else None,
        "force_n": one.force_n,
        "objective": one.optimum.value,
        "starts": [_number(value) for value in one.optimum.start_values],
        "evaluations": one.optimum.evaluations,
        "pulled_mm": float(one.closing.pulled_mm[0, -1]),
        "target_deg": np.degrees(one.target.angle_rad[-1]).tolist(),
        "reached_deg": np.degrees(one.closing.angle_rad[0, -1]).tolist(),
        "remarks": remarks,
    }


def _dimensions(finger: Finger) -> dict[str, Any]:
    return {
        "thickness_mm": [round(value, 4) for value in finger.thickness_mm],
        "routing_mm": [round(value, 4) for value in finger.routing_mm],
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None  # JSON has neither NaN nor infinity
