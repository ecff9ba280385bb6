# SPDX-License-Identifier: Apache-2.0
"""The YAML file of a friction model (schema 1): written whole or not at all, read with every key checked."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from softgrip_model.durable import write_durably
from softgrip_model.friction.errors import LawError, ModelFileError
from softgrip_model.friction.laws import COEFFICIENT_NAMES, FrictionLaw, KReading, Law
from softgrip_model.friction.record import ID_PATTERN, FrictionModel, ModelVerdict

SCHEMA = 1
Choice = TypeVar("Choice", bound=StrEnum)


def to_mapping(model: FrictionModel) -> dict[str, object]:
    """Return a model as the mapping that its YAML file holds."""
    return {
        "schema": SCHEMA,
        "id": model.id,
        "law": str(model.law.law),
        "k_reading": str(model.law.k_reading),
        "coefficients": dict(model.law.by_name),
        "covariance": None if model.covariance is None else [[float(c) for c in row] for row in model.covariance],
        "cable": model.cable,
        "surface": model.surface,
        "cable_radius_m": model.cable_radius_m,
        "surface_radius_m": model.surface_radius_m,
        "angle_range_rad": [float(a) for a in model.law.angle_range],
        "tension_range_n": [float(t) for t in model.law.tension_range],
        "points": model.points,
        "degrees_of_freedom": model.degrees_of_freedom,
        "average_error": _none_if_nan(model.average_error),
        "maximum_error": _none_if_nan(model.maximum_error),
        "r_squared": _none_if_nan(model.r_squared),
        "residual_stddev": _none_if_nan(model.residual_stddev),
        "verdict": str(model.verdict),
        "reason": model.reason,
        "source": model.source,
        "source_sha256": model.source_sha256,
        "fitted_at": model.fitted_at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "notes": list(model.notes),
    }


def write_model(model: FrictionModel, path: Path) -> None:
    """Write a model's YAML file: whole or not at all, also when the power dies.

    Raises:
        ModelFileError: the id is not one.
        OSError: the disk refused.
    """
    if not ID_PATTERN.fullmatch(model.id):
        raise ModelFileError(f"expected an id of letters, digits, '.', '_' and '-', found {model.id!r}")
    write_durably(path, yaml.safe_dump(to_mapping(model), sort_keys=False, allow_unicode=True).encode())


def read_model(path: Path) -> FrictionModel:
    """Read and check a model's YAML file.

    Raises:
        ModelFileError: missing, not YAML, another schema, or a key that is missing or wrong; names file and key.
    """
    try:
        mapping = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        available = ", ".join(sorted(p.stem for p in path.parent.glob("*.yaml"))) or "none"
        raise ModelFileError(f"no friction model '{path.stem}' in {path.parent}; available: {available}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ModelFileError(f"{path}: expected a YAML file, found {error}") from error
    if not isinstance(mapping, dict):
        raise ModelFileError(f"{path}: expected a mapping, found {type(mapping).__name__}")
    try:
        return from_mapping(mapping)
    except ModelFileError as error:
        raise ModelFileError(f"{path}: {error}") from error


def from_mapping(mapping: dict[str, Any]) -> FrictionModel:
    """Return the model that a mapping describes (the inverse of `to_mapping`).

    Raises:
        ModelFileError: a key is missing or wrong.
    """
    reader = _Reader(mapping)
    if mapping.get("schema") != SCHEMA:
        raise ModelFileError(f"expected schema {SCHEMA}, found {mapping.get('schema')!r}")
    kind = reader.choice("law", Law)
    names = COEFFICIENT_NAMES[kind]
    coefficients = reader.mapping("coefficients")
    if set(coefficients) != set(names):
        raise ModelFileError(f"coefficients: expected {', '.join(names)}, found {', '.join(map(str, coefficients))}")
    cable_radius_m, surface_radius_m = reader.number("cable_radius_m"), reader.number("surface_radius_m")
    try:
        law = FrictionLaw(
            law=kind,
            coefficients=tuple(_number(f"coefficients.{name}", coefficients[name]) for name in names),
            radius_mm=1e3 * (cable_radius_m + surface_radius_m),
            k_reading=reader.choice("k_reading", KReading),
            angle_range=reader.interval("angle_range_rad"),
            tension_range=reader.interval("tension_range_n"),
        )
    except LawError as error:
        raise ModelFileError(str(error)) from error
    model = FrictionModel(
        id=reader.text("id"),
        law=law,
        covariance=_covariance(mapping.get("covariance"), len(names)),
        residual_stddev=reader.optional_number("residual_stddev"),
        average_error=reader.optional_number("average_error"),
        maximum_error=reader.optional_number("maximum_error"),
        r_squared=reader.optional_number("r_squared"),
        points=int(reader.number("points")),
        cable=reader.text("cable"),
        surface=reader.text("surface"),
        cable_radius_m=cable_radius_m,
        surface_radius_m=surface_radius_m,
        source=reader.text("source"),
        source_sha256=str(mapping.get("source_sha256") or ""),
        fitted_at=_time(mapping.get("fitted_at")),
        verdict=reader.choice("verdict", ModelVerdict),
        reason=reader.text("reason"),
        degrees_of_freedom=int(mapping.get("degrees_of_freedom") or 0),
        notes=tuple(str(note) for note in mapping.get("notes") or ()),
    )
    if not ID_PATTERN.fullmatch(model.id):
        raise ModelFileError(f"id: expected letters, digits, '.', '_' and '-', found {model.id!r}")
    return model


@dataclass(frozen=True)
class _Reader:
    """Typed access to a mapping, with errors that name the key."""

    content: dict[str, object]

    def _get(self, key: str) -> Any:
        if key not in self.content:
            raise ModelFileError(f"expected the key '{key}', found {', '.join(map(str, self.content))}")
        return self.content[key]

    def text(self, key: str) -> str:
        value = self._get(key)
        if not isinstance(value, str):
            raise ModelFileError(f"{key}: expected text, found {value!r}")
        return value

    def number(self, key: str) -> float:
        return _number(key, self._get(key))

    def optional_number(self, key: str) -> float:
        value = self._get(key)
        return math.nan if value is None else _number(key, value)

    def mapping(self, key: str) -> dict[str, object]:
        value = self._get(key)
        if not isinstance(value, dict):
            raise ModelFileError(f"{key}: expected a mapping, found {value!r}")
        return value

    def choice(self, key: str, kind: type[Choice]) -> Choice:
        value = self._get(key)
        try:
            return kind(value)
        except ValueError as error:
            raise ModelFileError(f"{key}: expected one of {', '.join(kind)}, found {value!r}") from error

    def interval(self, key: str) -> tuple[float, float]:
        value = self._get(key)
        if not isinstance(value, list) or len(value) != 2:
            raise ModelFileError(f"{key}: expected two numbers, found {value!r}")
        low, high = (_number(key, end) for end in value)
        if not low < high:
            raise ModelFileError(f"{key}: expected low < high, found {value!r}")
        return low, high


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise ModelFileError(f"{key}: expected a finite number, found {value!r}")
    return float(value)


def _covariance(value: object, count: int) -> NDArray[np.float64] | None:
    if value is None:
        return None
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelFileError(f"covariance: expected {count} x {count} numbers, found {value!r}") from error
    if matrix.shape != (count, count) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6):
        raise ModelFileError(f"covariance: expected a symmetric {count} x {count} matrix of finite numbers")
    return matrix


def _time(value: object) -> datetime:
    if isinstance(value, datetime):  # an unquoted YAML time stamp
        return value if value.tzinfo else value.replace(tzinfo=UTC)
    try:
        return datetime.strptime(str(value), "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    except ValueError as error:
        raise ModelFileError(f"fitted_at: expected a time like 2026-11-21T10:15:00Z, found {value!r}") from error


def _none_if_nan(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
