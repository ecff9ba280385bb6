# SPDX-License-Identifier: Apache-2.0
"""Finger designs: shipped profiles and samples of the design space x friction models x demonstrated motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product as combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softgrip_design.design import Task
from softgrip_design.objective import FollowTrajectory
from softgrip_design.optimiser import starting_points
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_sweep.task import SweepTask

Array = NDArray[np.float64]

MOTIONS: Final = ("power", "pinch")
FINGER: Final = "index"
FRICTION: Final = ("braid-tpu-chapter4",)
PROFILES: Final = ("power", "pinch", "hook")
#: Designs that one task tries: seconds of work.
BLOCK: Final = 500


@dataclass(frozen=True)
class DesignSpace:
    """What is combined.

    Attributes:
        motions: shipped demonstrations.
        friction: ids of published friction models.
        profiles: shipped profiles, each tried as it is.
        samples: designs of a Latin hypercube over the thesis' bounds, for each motion and friction model.
        seed: of the samples.
    """

    motions: Sequence[str] = MOTIONS
    friction: Sequence[str] = FRICTION
    profiles: Sequence[str] = PROFILES
    samples: int = 1000
    seed: int = 1


def tasks(space: DesignSpace) -> list[SweepTask]:
    """Return tasks of some hundred designs each."""
    made = []
    for motion, friction in combinations(space.motions, space.friction):
        common = {"motion": motion, "friction": friction}
        made += [SweepTask(f"{__name__}:try_profile", {**common, "profile": name}) for name in space.profiles]
        for first in range(0, space.samples, BLOCK):
            count = min(BLOCK, space.samples - first)
            sample = {"samples": space.samples, "seed": space.seed, "first": first, "count": count}
            made.append(SweepTask(f"{__name__}:try_samples", common | sample))
    return made


def try_profile(motion: str, friction: str, profile: str) -> list[dict[str, Any]]:
    """Return what a shipped profile's index finger makes of a motion; called by a worker."""
    design = load_directory(shipped_directory())[profile].finger(FINGER)
    vector = 1e3 * np.array([*design.thicknesses_m, *design.routing_radii_m])
    return _scored(_objective(motion, friction), vector[None], profile)


def try_samples(motion: str, friction: str, samples: int, seed: int, first: int, count: int) -> list[dict[str, Any]]:
    """Return what some designs of a Latin hypercube make of a motion; called by a worker."""
    objective = _objective(motion, friction)
    points = starting_points(objective.lower, objective.upper, samples, seed)[first : first + count]
    return _scored(objective, points, "sample")


def best(found: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the designs with an equilibrium, best first by Eq 4.5: an error of 1 degree weighs as much as 2 N."""
    closed = [one for one in found if one["error_deg"] is not None]
    return sorted(closed, key=lambda one: (2.0 * one["error_deg"] + one["force_n"], one["design_mm"]))


def _objective(motion: str, friction: str) -> FollowTrajectory:
    return Task(published(friction).law).objective(load(SHIPPED / f"hand_{motion}.csv"), FINGER)


def _scored(objective: FollowTrajectory, designs: Array, source: str) -> list[dict[str, Any]]:
    errors_deg, forces_n = objective.scores(designs)
    return [
        {
            "source": source,
            "design_mm": [round(float(value), 6) for value in design],
            "error_deg": float(error) if np.isfinite(error) else None,
            "force_n": float(force) if np.isfinite(error) else None,
        }
        for design, error, force in zip(designs, errors_deg, forces_n, strict=True)
    ]
