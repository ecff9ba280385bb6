# SPDX-License-Identifier: Apache-2.0
"""The numbers behind a verdict, as plain data and in words."""

from __future__ import annotations

from collections.abc import Sequence

from softgrip_cell.grasp.reading import Reading
from softgrip_cell.grasp.values import GraspPhase


def evidence(
    slots: Sequence[str], readings: Sequence[Reading], peak_n: Sequence[float], phase: GraspPhase, decided_ns: int
) -> dict[str, object]:
    """Return what a result carries as YAML of the tendons: per slot in N, empty before the first reading."""
    named = list(zip(slots, readings, strict=False))
    return {
        "phase": phase.value,
        "excess_n": {name: round(reading.contact_tension_n, 3) for name, reading in named},
        "contact_from_n": {name: round(reading.threshold_n, 3) for name, reading in named},
        "force_at_most_n": {name: round(reading.force_n, 3) for name, reading in named},
        "peak_excess_n": {name: round(peak, 3) for name, peak in zip(slots, peak_n, strict=True)},
        "decided_stamp_ns": decided_ns,
    }


def contact_text(slots: Sequence[str], readings: Sequence[Reading]) -> str:
    """Return the excess tension of every finger in words."""
    parts = [
        f"{name} {reading.contact_tension_n:+.1f} (contact from {reading.threshold_n:.1f})"
        for name, reading in zip(slots, readings, strict=True)
    ]
    return "excess tension [N] " + ", ".join(parts)


def pulled_text(slots: Sequence[str], readings: Sequence[Reading]) -> str:
    """Return the pulled length of every finger in words."""
    parts = [f"{name} {reading.pulled_m * 1e3:.1f}" for name, reading in zip(slots, readings, strict=False)]
    return "pulled length [mm] " + ", ".join(parts)
