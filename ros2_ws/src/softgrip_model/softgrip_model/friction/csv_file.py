# SPDX-License-Identifier: Apache-2.0
"""Friction measurements from a CSV file: columns found by name and unit, bad rows named."""

from __future__ import annotations

import csv
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softgrip_model.friction.errors import DataError
from softgrip_model.friction.laws import GRAVITY
from softgrip_model.friction.measurements import Measurements, measurements

_QUANTITIES = {
    "angle": ("angle", "theta", "wrap angle", "wrap_angle"),
    "load": ("load", "mass", "weight"),
    "tension_low": ("t2", "tension_low", "tension low", "holding"),
    "tension_high": ("t1", "tension_high", "tension high", "pulling"),
    "ratio": ("ratio", "rf", "t1/t2"),
}
#: Unit -> factor to SI, per quantity.
_UNITS = {
    "angle": {"deg": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0},
    "load": {"g": 1e-3, "kg": 1.0},
    "tension_low": {"n": 1.0, "mn": 1e-3, "kn": 1e3},
    "tension_high": {"n": 1.0, "mn": 1e-3, "kn": 1e3},
    "ratio": {"": 1.0, "1": 1.0, "-": 1.0},
}
_EXPECTED = "angle [deg], load [g] or T2 [N], and T1 [N] or ratio"


@dataclass(frozen=True)
class _Column:
    quantity: str
    index: int
    header: str
    to_si: float


def read_csv(path: Path) -> Measurements:
    """Read points from a CSV file.

    Columns are found by name in any order: angle [deg or rad], load [g or kg] or T2 [N], T1 [N] or ratio. The unit
    stands in the header, as ``angle [deg]``, ``angle (deg)`` or ``angle_deg``. Lines that start with ``#`` are
    comments; other columns are ignored. Separators: comma, semicolon (then a decimal comma is read too) or tab.

    Raises:
        DataError: a missing or doubled column, an unknown unit, a cell that is no number, or a row that no rig can
            give; names the row (its line in the file) and the reason.
    """
    try:
        content = path.read_bytes()
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: expected a text file in UTF-8, found byte {error.start} that is not") from error
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise DataError(f"{path}: expected a header and points, found an empty file")
    separator = max(",;\t", key=lines[0][1].count)
    header = next(csv.reader([lines[0][1]], delimiter=separator))
    columns = _columns(path, header)
    values: dict[str, list[float]] = {quantity: [] for quantity in columns}
    for number, line in lines[1:]:
        cells = next(csv.reader([line], delimiter=separator))
        for quantity, column in columns.items():
            values[quantity].append(_cell(path, number, cells, column, separator))
    low = np.array(values["tension_low"]) if "tension_low" in values else GRAVITY * np.array(values["load"])
    high = np.array(values["tension_high"]) if "tension_high" in values else low * np.array(values["ratio"])
    angle = np.array(values["angle"])
    _check_angle_unit(path, angle, columns["angle"])
    try:
        return measurements(
            angle,
            low,
            high,
            labels=[f"row {number}" for number, _ in lines[1:]],
            source=path.name,
            source_sha256=hashlib.sha256(content).hexdigest(),
        )
    except DataError as error:
        raise DataError(f"{path.name}, {error}") from error


def _columns(path: Path, header: list[str]) -> dict[str, _Column]:
    found: dict[str, _Column] = {}
    for index, title in enumerate(header):
        column = _column(path, index, title)
        if column is None:
            continue
        if column.quantity in found:
            raise DataError(
                f"{path}: expected one column for {column.quantity.replace('_', ' ')}, "
                f"found '{found[column.quantity].header}' and '{column.header}'; remove one"
            )
        found[column.quantity] = column
    missing = []
    if "angle" not in found:
        missing.append("angle")
    if "load" not in found and "tension_low" not in found:
        missing.append("load or T2")
    if "tension_high" not in found and "ratio" not in found:
        missing.append("T1 or ratio")
    if missing:
        raise DataError(f"{path}: expected {_EXPECTED}; missing: {', '.join(missing)}; found: {', '.join(header)}")
    for quantity, other in (("tension_low", "load"), ("tension_high", "ratio")):
        if quantity in found and other in found:
            raise DataError(
                f"{path}: expected either '{found[quantity].header}' or '{found[other].header}', found both; remove one"
            )
    return found


def _column(path: Path, index: int, title: str) -> _Column | None:
    text = title.strip()
    match = re.fullmatch(r"(.+?)\s*[\[(]\s*(.*?)\s*[\])]", text)
    name, unit = (match[1], match[2]) if match else (text, None)
    if unit is None:
        parts = re.fullmatch(r"(.+)_(deg|rad|g|kg|n|mn|kn)", text, flags=re.IGNORECASE)
        name, unit = (parts[1], parts[2]) if parts else (text, "")
    quantity = next((q for q, aliases in _QUANTITIES.items() if name.strip().lower() in aliases), None)
    if quantity is None:
        return None
    factor = _UNITS[quantity].get(unit.lower())
    if factor is None:
        expected = ", ".join(u for u in _UNITS[quantity] if u) or "none"
        raise DataError(f"{path}: column '{title}': expected one of the units {expected}, found '{unit}'")
    return _Column(quantity, index, text, factor)


def _cell(path: Path, number: int, cells: list[str], column: _Column, separator: str) -> float:
    if column.index >= len(cells):
        raise DataError(
            f"{path.name}, row {number}: expected a value for '{column.header}', found only {len(cells)} cells"
        )
    text = cells[column.index].strip()
    if separator == ";":
        text = text.replace(",", ".")
    try:
        return float(text) * column.to_si
    except ValueError as error:
        raise DataError(
            f"{path.name}, row {number}: expected a number for '{column.header}', found '{text}'; "
            "units stand in the header"
        ) from error


def _check_angle_unit(path: Path, angle: np.ndarray, column: _Column) -> None:
    if len(angle) and column.to_si != 1.0 and 0.0 < np.nanmax(angle) < np.radians(2.0):
        raise DataError(
            f"{path.name}: column '{column.header}': the largest angle is {np.degrees(np.nanmax(angle)):g} deg, "
            "which looks like radians; correct the header's unit"
        )
