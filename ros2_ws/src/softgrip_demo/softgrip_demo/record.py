# SPDX-License-Identifier: Apache-2.0
"""What one shift measured, as frozen values that go to disk as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = 1


class RecordError(Exception):
    """A shift record cannot be read; the message says what was expected and found."""


@dataclass(frozen=True)
class FrictionPoint:
    """One accepted point of the rig: wrap angle [rad], T1 and T2 [N]."""

    angle: float
    tension_high: float
    tension_low: float


@dataclass(frozen=True)
class FrictionResult:
    """The model fitted at the start of the shift, with the points behind it."""

    id: str
    law: str
    k_reading: str
    coefficients: dict[str, float]
    radius_mm: float
    average_error: float
    maximum_error: float
    r_squared: float
    verdict: str
    points: tuple[FrictionPoint, ...]


@dataclass(frozen=True)
class PairedSample:
    """One camera frame of a closing beside the prediction at the same instant.

    Attributes:
        pulled_length_m: [m].
        predicted_angles, measured_angles: [rad] base to tip.
        predicted_tip, measured_tip: [m] x, y in the finger's base frame.
        tension: [N] at the actuator, measured.
        predicted_tension: [N].
        predicted_tip_stddev: [m] along x and y; NaN where the prediction does not say.
        measured_tip_stddev: likewise, of the camera.
    """

    pulled_length_m: float
    predicted_angles: tuple[float, ...]
    measured_angles: tuple[float, ...]
    predicted_tip: tuple[float, float]
    measured_tip: tuple[float, float]
    tension: float
    predicted_tension: float
    predicted_tip_stddev: tuple[float, float] = (math.nan, math.nan)
    measured_tip_stddev: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True)
class ShapeView:
    """The simulated shape at the end of a closing: surface quads in the plane of the finger."""

    hexahedra: int
    rate: float  # [Hz] shapes received per second of the closing
    converged: bool
    pulled_length_m: float  # [m]
    vertices: tuple[tuple[float, float, float], ...]  # [m]
    faces: tuple[tuple[int, int, int, int], ...]


@dataclass(frozen=True)
class ShiftClosing:
    """An empty closing of the watched finger with one finger set."""

    grasp: str
    finger_length: float  # [m]
    samples: tuple[PairedSample, ...]
    shape: ShapeView | None


@dataclass(frozen=True)
class GraspResult:
    """One product, grasped once."""

    product: str
    grasp: str
    outcome: str
    expected: str  # Table 4.2: "success", "partial", "failure"
    reason: str
    latency: float  # [s] from the deciding event to the result at the client; NaN where nothing was decided


@dataclass(frozen=True)
class ShiftFrame:
    """One camera frame of the filmed grasp beside the predicted free motion.

    Attributes:
        image: file name of the JPEG beside the record.
        time: [s] since the first frame.
        predicted_joints: [px] u, v of base, joints and tip as the free-motion model predicts them.
        tension, predicted_tension: [N].
    """

    image: str
    time: float
    predicted_joints: tuple[tuple[float, float], ...]
    tension: float
    predicted_tension: float


@dataclass(frozen=True)
class ShiftStage:
    """A named part of the shift and its wall time [s]."""

    name: str
    wall_clock_s: float


@dataclass(frozen=True)
class ShiftRecord:
    """Everything that the report needs and the bag does not say at a glance."""

    seed: int
    friction: FrictionResult
    closings: tuple[ShiftClosing, ...]
    grasps: tuple[GraspResult, ...]
    swaps: int
    film_product: str
    film: tuple[ShiftFrame, ...]
    bag_path: str
    bag_messages: int
    bag_topics: int
    bag_dropped: int
    stages: tuple[ShiftStage, ...]
    schema: int = field(default=SCHEMA)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(dataclasses.asdict(self), indent=1))

    @staticmethod
    def load(path: Path) -> ShiftRecord:
        """Read a record written by ``save``.

        Raises:
            RecordError: when the file is missing, is not JSON, or is of another schema.
        """
        try:
            raw = json.loads(path.read_text())
        except FileNotFoundError:
            raise RecordError(f"expected a shift record at {path}, found none: did the shift run to its end?") from None
        except json.JSONDecodeError as error:
            raise RecordError(f"{path}: expected JSON, found {error}") from error
        if raw.get("schema") != SCHEMA:
            raise RecordError(f"{path}: expected schema {SCHEMA}, found {raw.get('schema')!r}; run the demo again")
        return _from_raw(raw)


def _pairs(raw: Any) -> tuple[Any, ...]:
    return tuple(tuple(item) for item in raw)


def _sample(raw: dict[str, Any]) -> PairedSample:
    values: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in raw.items()}
    return PairedSample(**values)


def _from_raw(raw: dict[str, Any]) -> ShiftRecord:
    friction = dict(raw["friction"])
    friction["points"] = tuple(FrictionPoint(**point) for point in friction["points"])
    closings = []
    for closing in raw["closings"]:
        samples = tuple(_sample(sample) for sample in closing["samples"])
        shape = closing["shape"]
        if shape is not None:
            shape = ShapeView(**{**shape, "vertices": _pairs(shape["vertices"]), "faces": _pairs(shape["faces"])})
        closings.append(ShiftClosing(closing["grasp"], closing["finger_length"], samples, shape))
    film = tuple(
        ShiftFrame(**{**frame, "predicted_joints": _pairs(frame["predicted_joints"])}) for frame in raw["film"]
    )
    return ShiftRecord(
        **{
            **raw,
            "friction": FrictionResult(**friction),
            "closings": tuple(closings),
            "grasps": tuple(GraspResult(**grasp) for grasp in raw["grasps"]),
            "film": film,
            "stages": tuple(ShiftStage(**stage) for stage in raw["stages"]),
        }
    )
