# SPDX-License-Identifier: Apache-2.0
"""Joint-angle trajectories of a hand, as values and as CSV files.

The file has lines `# key: value` about its origin, then a header and one row a frame: `time_s`, and `<finger>_j<k>_rad`
for every joint, base to tip.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError

Array = NDArray[np.float64]

#: Demonstrations that ship with the package.
SHIPPED = Path(__file__).parent / "data"
#: [s] frames further apart than this, and than five usual steps, are a gap.
LONGEST_STEP_S = 0.25


def shipped() -> tuple[str, ...]:
    """Return the names of the demonstrations that ship with the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.csv")))


@dataclass(frozen=True)
class FingerTrajectory:
    """How the joints of a hand's fingers moved.

    Attributes:
        times: (frames,) [s], growing.
        angles: finger -> (frames, joints) [rad], base to tip.
        origin: where it comes from, as written at the head of the file.
    """

    times: Array
    angles: Mapping[str, Array]
    origin: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or len(self.times) < 2 or not np.all(np.diff(self.times) > 0.0):
            raise DesignError("expected at least two frames with growing times, found others")
        steps = np.diff(self.times)
        widest = int(steps.argmax())
        if steps[widest] > max(LONGEST_STEP_S, 5.0 * float(np.median(steps))):
            raise DesignError(
                f"expected frames without a gap, found {steps[widest]:.3f} s between {self.times[widest]:.3f} s and "
                f"{self.times[widest + 1]:.3f} s; capture it again or use one side of the gap"
            )
        for finger, angles in self.angles.items():
            if angles.ndim != 2 or len(angles) != len(self.times):
                raise DesignError(f"{finger}: expected ({len(self.times)}, joints) angles, found {angles.shape}")
            bad = ~np.isfinite(angles).all(axis=1)
            if bad.any():
                raise DesignError(
                    f"{finger}: expected finite angles, found a gap at {self.times[bad][0]:.3f} s; capture it again"
                )

    def save(self, path: Path) -> None:
        """Write as CSV, angles to a tenth of a milliradian."""
        lines = [f"# {key}: {value}" for key, value in self.origin.items()]
        columns = [f"{finger}_j{k}_rad" for finger, a in self.angles.items() for k in range(a.shape[1])]
        lines.append(",".join(["time_s", *columns]))
        table = np.hstack([self.angles[finger] for finger in self.angles])
        lines += [
            ",".join([f"{time:.4f}", *(f"{angle:.4f}" for angle in row)])
            for time, row in zip(self.times, table, strict=True)
        ]
        path.write_text("\n".join(lines) + "\n")

    def closing(self, finger: str) -> Array:
        """Return how far each joint of a finger flexed beyond its first frame, ordered by the joints' sum.

        A groove only closes, so a joint that stretches counts as not flexed. Only frames that set a new greatest sum
        are kept, so the sum grows from row to row: what a tendon can follow.

        Returns:
            (rows, joints) [rad].

        Raises:
            DesignError: the finger is not in the trajectory.
        """
        if finger not in self.angles:
            raise DesignError(f"expected one of {', '.join(self.angles)}, found {finger!r}")
        flexed = np.maximum(self.angles[finger] - self.angles[finger][0], 0.0)
        total = flexed.sum(axis=1)
        grows = np.r_[True, total[1:] > np.maximum.accumulate(total)[:-1]]
        return np.asarray(flexed[grows])


def load(path: Path) -> FingerTrajectory:
    """Read a trajectory.

    Raises:
        DesignError: a missing file, column or number, with the line it is in.
    """
    try:
        text = path.read_text()
    except OSError as error:
        raise DesignError(f"expected a trajectory at {path}, found none ({error.strerror})") from error
    lines = text.splitlines()
    head = [line for line in lines if line.startswith("#")]
    origin = {key.strip(): value.strip() for key, _, value in (line[1:].partition(":") for line in head)}
    rows = list(csv.reader(io.StringIO("\n".join(lines[len(head) :]))))
    if not rows or "time_s" not in rows[0]:
        raise DesignError(f"{path}: expected a header with time_s, found {rows[0] if rows else 'nothing'}")
    header = rows[0]
    table = np.array([_numbers(path, len(head) + 2 + i, row, len(header)) for i, row in enumerate(rows[1:])])
    if table.size == 0:
        raise DesignError(f"{path}: expected rows after the header, found none")
    fingers: dict[str, list[int]] = {}
    for column, name in enumerate(header):
        if name.endswith("_rad"):
            fingers.setdefault(name.rsplit("_j", 1)[0], []).append(column)
    if not fingers:
        raise DesignError(f"{path}: expected columns like index_j0_rad, found {header}")
    angles = {finger: table[:, columns] for finger, columns in fingers.items()}
    return FingerTrajectory(table[:, header.index("time_s")], angles, origin)


def _numbers(path: Path, line: int, row: list[str], count: int) -> list[float]:
    if len(row) != count:
        raise DesignError(f"{path}:{line}: expected {count} columns, found {len(row)}")
    try:
        return [float(cell) for cell in row]
    except ValueError as error:
        raise DesignError(f"{path}:{line}: expected numbers, found {error}") from error
